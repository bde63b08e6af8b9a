"""Tables as Parquet: typed by their schema, units in the field metadata, provenance in the schema metadata."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, BinaryIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from mocap_id.arrays import chunks
from mocap_id.store.artefacts import Column, LongTable, Table, TableSchema
from mocap_id.store.content import TableHash, ranked_strings
from mocap_id.store.digest import HashedStream
from mocap_id.store.provenance import PREFIX, Origin, Provenance

_ROWS = 1 << 18  # that are written together
_MOST_COLUMNS = 5000
_ROOM, _LEAST_ROOM = 64, 1 << 28
"""Bytes in memory for each byte of the file: what is never seen packs well. At least so many."""
_CELL = 8
"""Bytes of a cell at most: numbers, or places in a list of texts."""

_TYPES = {
    "float64": pa.float64(),
    "int64": pa.int64(),
    "Int64": pa.int64(),
    "bool": pa.bool_(),
    "category": pa.dictionary(pa.int32(), pa.string()),
    "str": pa.string(),
}


def write(table: Table | LongTable, origin: Origin, stream: BinaryIO | HashedStream) -> str:
    """Write the table as a Parquet file, a stretch of rows at a time; its content hash.

    Raises
    ------
    ValueError
        The table does not have the columns or types that its schema promises.
    """
    columns, content = _columns(table), TableHash()
    for column in columns:
        content.add(column.name, _TYPES[column.dtype], table.length, partial(_parts, table, column))
    provenance = Provenance(
        table.schema.file,
        table.schema.version,
        origin,
        content.result(table.facts, table.reasons),
        table.facts,
        table.reasons,
    )
    empty = pd.DataFrame({name: table.column(name, slice(0)) for name in table.names})
    pandas = pa.Schema.from_pandas(empty, preserve_index=False).metadata or {}
    schema = pa.schema([_field(column) for column in columns], metadata=pandas | provenance.encode())
    coded = [column.name for column in columns if column.dtype != "float64"]  # measurements hardly repeat
    with pq.ParquetWriter(stream, schema, compression="zstd", use_dictionary=coded) as writer:
        for rows in chunks(table.length, _ROWS):
            arrays = [_arrow(table.column(column.name, rows), column, table.schema.file) for column in columns]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    return provenance.content


def encode(table: Table | LongTable, origin: Origin) -> bytes:
    """The table as the bytes of a Parquet file; ValueError as for :func:`write`."""
    stream = io.BytesIO()
    write(table, origin, stream)
    return stream.getvalue()


def decode(content: bytes | BinaryIO, schema: TableSchema) -> tuple[Table, Provenance]:
    """The table of a Parquet file, given as its bytes or open, checked against its schema and its own content hash.

    Columns are taken up one by one, so that the whole table stands in memory once and not twice.

    Raises
    ------
    ValueError
        The file is damaged, not ours, or not of this schema; the message completes "FILE …".
    """
    stream = io.BytesIO(content) if isinstance(content, bytes) else content
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    try:
        file = pq.ParquetFile(stream)
        found = file.schema_arrow
        metadata = {key.decode(): value.decode() for key, value in (found.metadata or {}).items()}
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"is damaged ({_first_line(error)})") from error
    _check_size(file.metadata, found, _ROOM * size + _LEAST_ROOM)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_mismatches(found, schema))
    if problem:
        raise ValueError(f"does not have its columns: {problem}")
    kinds = {column.name: column.dtype for column in columns_of(schema, found.names)}
    series, digest = {}, TableHash()
    for name in found.names:
        try:
            column = file.read(columns=[name]).column(name)
        except (pa.ArrowException, OSError) as error:
            raise ValueError(f"is damaged ({_first_line(error)})") from error
        digest.add(name, column.type, len(column), column.iterchunks)
        series[name] = _series(column, kinds.get(name))
    if digest.result(provenance.facts, provenance.reasons) != provenance.content:
        raise ValueError("is damaged or was edited: its content does not match its own hash")
    frame = pd.DataFrame(series, copy=False)
    return Table(schema, frame, provenance.facts, provenance.reasons), provenance


def _check_size(found: pq.FileMetaData, schema: pa.Schema, room: int) -> None:
    """Refuse, before any column is read, what would take far more memory than files of ours do."""
    names = schema.names
    if len(names) > _MOST_COLUMNS:
        raise ValueError(f"has {len(names)} columns, more than any table of ours")
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise ValueError(f"does not have its columns: `{twice}` stands twice")
    groups = [found.row_group(index) for index in range(found.num_row_groups)]
    packed = sum(group.total_byte_size for group in groups)
    if found.num_rows < 0 or max(packed, found.num_rows * _CELL * len(names)) > room:
        raise ValueError(f"declares {found.num_rows} rows, which take more memory than a file of its size may ask for")


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
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"has a damaged provenance ({_first_line(error)})") from error
    found, expected = (provenance.schema, provenance.schema_version), (schema.file, schema.version)
    if found != expected:
        raise ValueError(f"has schema {found[0]} version {found[1]}, expected {expected[0]} version {expected[1]}")
    return provenance


def conform(table: Table | LongTable) -> pa.Table:
    """The whole as an Arrow table with exactly its schema's columns, types and order; NaN stays NaN.

    Raises
    ------
    ValueError
        A column is missing, unknown or cannot be converted without loss.
    """
    columns = _columns(table)
    schema = pa.schema([_field(column) for column in columns])
    return pa.Table.from_arrays([pa.chunked_array(_parts(table, column)) for column in columns], schema=schema)


def _columns(table: Table | LongTable) -> list[Column]:
    """The columns that the schema asks of this table; ValueError where one is missing or unknown."""
    names, schema = table.names, table.schema
    columns = list(columns_of(schema, names))
    missing = [column.name for column in columns if column.name not in names]
    unknown = sorted(set(names) - {column.name for column in columns})
    if missing or unknown:
        raise ValueError(f"{schema.file}: missing columns {missing}, columns that its schema does not name {unknown}")
    return columns


def _parts(table: Table | LongTable, column: Column) -> Iterator[pa.Array]:
    """The column's values, a stretch of rows at a time."""
    for rows in chunks(table.length, _ROWS):
        yield _arrow(table.column(column.name, rows), column, table.schema.file)


def columns_of(schema: TableSchema, names: Sequence[str]) -> Iterator[Column]:
    """The schema's columns; those of a group for every k of which ``names`` holds at least one, or once without k."""
    yield from schema.columns
    for group in (schema.repeated, *schema.optional):
        found = {match for name in names for column in group if (match := _place(column, str(name))) is not None}
        for k in sorted(found):
            for column in group:
                yield Column(column.name.format(k=k), column.dtype, column.unit, column.meaning)


def _place(column: Column, name: str) -> int | None:
    """The k of a column's name, 0 for one without a k; None where the name is another column's."""
    match = re.fullmatch(re.escape(column.name).replace(r"\{k\}", "([1-9][0-9]*)"), name)
    return None if match is None else int(match[1]) if match.groups() else 0


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
    types = dict(zip(found.names, found.types, strict=True))
    for column in columns_of(schema, found.names):
        if column.name not in types:
            yield f"`{column.name}` is missing"
        elif types[column.name] != _TYPES[column.dtype]:
            yield f"`{column.name}` is {types[column.name]}, expected {column.dtype}"


def _series(column: pa.ChunkedArray, kind: str | None) -> Any:
    """One column as pandas has it; categories are sorted, whatever the order in the file."""
    if kind == "category":
        values, parts = ranked_strings(column.iterchunks)
        codes = np.concatenate([np.empty(0, np.int32), *(part.astype(np.int32) for part in parts)])
        return pd.Categorical.from_codes(codes, categories=pd.Index(values, dtype="str"))
    if kind == "Int64":
        mask = column.is_null().to_numpy()
        return pd.arrays.IntegerArray(column.fill_null(0).to_numpy().astype(np.int64), mask)
    if kind == "str":
        return pd.array(column.to_pylist(), dtype="str")
    values = column.to_numpy()
    return values if values.flags.writeable else values.copy()


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
