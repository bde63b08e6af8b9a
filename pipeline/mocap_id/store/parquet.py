"""Tables as Parquet: typed by their schema, units in the field metadata, provenance in the schema metadata."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from mocap_id.store.artefacts import Column, Table, TableSchema
from mocap_id.store.content import canonical_strings, hash_table
from mocap_id.store.provenance import PREFIX, Origin, Provenance

_TYPES = {
    "float64": pa.float64(),
    "int64": pa.int64(),
    "Int64": pa.int64(),
    "bool": pa.bool_(),
    "category": pa.dictionary(pa.int32(), pa.string()),
    "str": pa.string(),
}


def encode(table: Table, origin: Origin) -> bytes:
    """The table as the bytes of a Parquet file.

    Raises
    ------
    ValueError
        The frame does not have the columns or types that its schema promises.
    """
    data = conform(table)
    content = hash_table(data, table.facts, table.reasons)
    provenance = Provenance(table.schema.file, table.schema.version, origin, content, table.facts, table.reasons)
    pandas = pa.Schema.from_pandas(table.frame.head(0), preserve_index=False).metadata or {}
    sink = pa.BufferOutputStream()
    pq.write_table(data.replace_schema_metadata(pandas | provenance.encode()), sink, compression="zstd")
    return bytes(sink.getvalue())


def decode(content: bytes, schema: TableSchema) -> tuple[Table, Provenance]:
    """The table of a Parquet file's bytes, checked against its schema and its own content hash.

    Raises
    ------
    ValueError
        The file is damaged, not ours, or not of this schema; the message completes "FILE …".
    """
    try:
        data = pq.ParquetFile(pa.BufferReader(content)).read()
        metadata = {key.decode(): value.decode() for key, value in (data.schema.metadata or {}).items()}
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"is damaged ({_first_line(error)})") from error
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_mismatches(data.schema, schema))
    if problem:
        raise ValueError(f"does not have its columns: {problem}")
    if hash_table(data, provenance.facts, provenance.reasons) != provenance.content:
        raise ValueError("is damaged or was edited: its content does not match its own hash")
    return Table(schema, _frame(data, schema), provenance.facts, provenance.reasons), provenance


def read_provenance(metadata: dict[str, str], schema: Any) -> Provenance:
    """Provenance out of a file's metadata, for this schema.

    Raises
    ------
    ValueError
        There is none, or it is another schema's; the message completes "FILE …".
    """
    if PREFIX + "schema" not in metadata:
        raise ValueError("was not written by mocap-id: it has no provenance")
    try:
        provenance = Provenance.decode(metadata)
    except (KeyError, ValueError, TypeError) as error:
        raise ValueError(f"has a damaged provenance ({_first_line(error)})") from error
    found, expected = (provenance.schema, provenance.schema_version), (schema.file, schema.version)
    if found != expected:
        raise ValueError(f"has schema {found[0]} version {found[1]}, expected {expected[0]} version {expected[1]}")
    return provenance


def conform(table: Table) -> pa.Table:
    """The frame as an Arrow table with exactly its schema's columns, types and order; NaN stays NaN.

    Raises
    ------
    ValueError
        A column is missing, unknown or cannot be converted without loss.
    """
    frame, schema = table.frame, table.schema
    columns = list(columns_of(schema, list(frame.columns)))
    missing = [column.name for column in columns if column.name not in frame]
    unknown = sorted(set(map(str, frame.columns)) - {column.name for column in columns})
    if missing or unknown:
        raise ValueError(f"{schema.file}: missing columns {missing}, columns that its schema does not name {unknown}")
    arrays = [_arrow(frame[column.name], column, schema.file) for column in columns]
    return pa.Table.from_arrays(arrays, schema=pa.schema([_field(column) for column in columns]))


def columns_of(schema: TableSchema, names: Sequence[str]) -> Iterator[Column]:
    """The schema's columns, the repeated ones for every k of which ``names`` holds at least one."""
    yield from schema.columns
    found = {
        int(match[1])
        for name in names
        for column in schema.repeated
        if (match := re.fullmatch(re.escape(column.name).replace(r"\{k\}", "([1-9][0-9]*)"), str(name)))
    }
    for k in sorted(found):
        for column in schema.repeated:
            yield Column(column.name.format(k=k), column.dtype, column.unit, column.meaning)


def _field(column: Column) -> pa.Field:
    return pa.field(column.name, _TYPES[column.dtype], metadata={"unit": column.unit, "meaning": column.meaning})


def _arrow(series: pd.Series[Any], column: Column, file: str) -> pa.Array:
    """One column, nulls only where the type has no NaN."""
    try:
        if column.dtype == "float64":
            return pa.array(series.to_numpy(dtype=np.float64), from_pandas=False)
        if column.dtype == "category":
            categories = series.astype("category").cat
            codes = pa.array(categories.codes.astype("int32"), mask=categories.codes.to_numpy() < 0)
            return pa.DictionaryArray.from_arrays(codes, pa.array(map(str, categories.categories), type=pa.string()))
        return pa.array(series, type=_TYPES[column.dtype])
    except (pa.ArrowException, TypeError, ValueError) as error:
        message = f"{file}: column {column.name} holds {series.dtype}, expected {column.dtype} ({_first_line(error)})"
        raise ValueError(message) from error


def _mismatches(found: pa.Schema, schema: TableSchema) -> Iterator[str]:
    for column in columns_of(schema, found.names):
        if column.name not in found.names:
            yield f"`{column.name}` is missing"
        elif found.field(column.name).type != _TYPES[column.dtype]:
            yield f"`{column.name}` is {found.field(column.name).type}, expected {column.dtype}"


def _frame(data: pa.Table, schema: TableSchema) -> pd.DataFrame:
    kinds = {column.name: column.dtype for column in columns_of(schema, data.column_names)}
    return pd.DataFrame({name: _series(data.column(name), kinds.get(name)) for name in data.column_names})


def _series(column: pa.ChunkedArray, kind: str | None) -> Any:
    """One column as pandas has it; categories are sorted, whatever the order in the file."""
    if kind == "category":
        values, codes = canonical_strings(column)
        return pd.Categorical.from_codes(codes, categories=pd.Index(values, dtype="str"))
    if kind == "Int64":
        mask = column.is_null().to_numpy()
        return pd.arrays.IntegerArray(column.fill_null(0).to_numpy().astype(np.int64), mask)
    if kind == "str":
        return pd.array(column.to_pylist(), dtype="str")
    return column.to_numpy()


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
