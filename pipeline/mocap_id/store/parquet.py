"""Tables as Parquet files: types from the schema, units in field metadata, provenance in schema metadata."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mocap_id.arrays import chunks
from mocap_id.errors import first_line
from mocap_id.store.artefacts import KINDS, LongTable, Table, Values
from mocap_id.store.atomic import HashedStream
from mocap_id.store.provenance import PREFIX, Column, Origin, Provenance, TableSchema

_ROWS = 1 << 18  # number of rows that are written together
_MOST_COLUMNS = 5000
_BYTES_PER_BYTE, _LEAST_BYTES = 64, 1 << 28
"""The limit of the size in memory is 64 bytes per byte of the file (columns of NaN compress well) plus 256 MiB."""
_CELL = 8  # largest number of bytes of a cell: a number, or an index into a list of texts
_TYPES = {
    "float64": pa.float64(),
    "int64": pa.int64(),
    "Int64": pa.int64(),
    "bool": pa.bool_(),
    "category": pa.dictionary(pa.int32(), pa.string()),
    "str": pa.string(),
}
_STORED = {
    "float64": np.float64,
    "int64": np.int64,
    "Int64": np.int64,
    "bool": np.bool_,
    "category": object,
    "str": object,
}


def write(table: Table | LongTable, origin: Origin, stream: BinaryIO | HashedStream) -> None:
    """Write a table as a Parquet file, a block of rows at a time; ValueError if it does not match its schema.

    Every page has a checksum, so that any Parquet library detects damage.
    """
    columns = _find_columns(table)
    provenance = Provenance(table.schema.file, table.schema.version, origin, table.facts, table.reasons)
    schema = pa.schema([_make_field(column) for column in columns], metadata=provenance.encode())
    # Floating-point values hardly repeat: byte streams compress them better than a dictionary.
    numbers = [column.name for column in columns if column.dtype == "float64"]
    coded = [column.name for column in columns if column.dtype != "float64"]
    options = {"compression": "zstd", "use_dictionary": coded, "use_byte_stream_split": numbers}
    with pq.ParquetWriter(stream, schema, **options, write_page_checksum=True) as writer:
        for rows in chunks(table.length, _ROWS):
            writer.write_table(_rows_to_arrow(table, columns, schema, rows))


def encode_table(table: Table | LongTable, origin: Origin) -> bytes:
    """Return the bytes of a table's Parquet file; ValueError as for :func:`write`."""
    stream = io.BytesIO()
    write(table, origin, stream)
    return stream.getvalue()


def to_arrow(table: Table | LongTable) -> pa.Table:
    """Return an Arrow table with the schema's columns, types and order; ValueError as for :func:`conform_table`."""
    columns = _find_columns(table)
    return _rows_to_arrow(table, columns, pa.schema([_make_field(column) for column in columns]), slice(None))


def conform_table(table: Table | LongTable) -> Table | LongTable:
    """Return a table with exactly the columns, types and order of its schema, as from its file; else ValueError."""
    columns, file = _find_columns(table), table.schema.file
    if isinstance(table, LongTable) != table.schema.long:
        raise ValueError(f"{file}: expected a {'LongTable' if table.schema.long else 'Table'}")
    if isinstance(table, LongTable):
        values = {c.name: _convert(table.values[c.name], c, file) for c in columns if c.name in table.values}
        frames, time = np.ascontiguousarray(table.frames), np.ascontiguousarray(table.time)
        return replace(table, frames=frames, time=time, labels=tuple(map(str, table.labels)), values=values)
    return replace(table, columns={c.name: _convert(table.columns[c.name], c, file) for c in columns})


def decode_table(content: bytes | BinaryIO, schema: TableSchema) -> tuple[Table | LongTable, Provenance]:
    """Read a table from a Parquet file, given as bytes or as a stream, and check its schema and checksums.

    Columns are read one by one, so that the table is never in memory twice. Raises ValueError without a subject,
    because the caller writes the file name before it.
    """
    stream = io.BytesIO(content) if isinstance(content, bytes) else content
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    try:
        file = pq.ParquetFile(stream, page_checksum_verification=True)
        found = file.schema_arrow
        metadata = {key.decode(): value.decode() for key, value in (found.metadata or {}).items()}
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"is damaged ({first_line(error)})") from error
    _check_size(file.metadata, found, _BYTES_PER_BYTE * size + _LEAST_BYTES)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_find_mismatches(found, schema))
    if problem:
        raise ValueError(f"does not have its columns: {problem}")
    try:
        return _read_table(file, schema, provenance), provenance
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"is damaged ({first_line(error)})") from error


def _read_table(file: pq.ParquetFile, schema: TableSchema, provenance: Provenance) -> Table | LongTable:
    """Read all columns as a table; ValueError if a long table does not have the same markers in every frame."""
    names = file.schema_arrow.names
    kinds = {column.name: column.dtype for column in expand_columns(schema, names)}
    if not schema.long:
        columns = {name: _to_array(_read_column(file, name), kinds.get(name)) for name in names}
        return Table(schema, columns, provenance.facts, provenance.reasons)
    frame = _to_array(_read_column(file, "frame"), "int64")
    codes, texts = _read_categories(_read_column(file, "marker"))
    markers = int(np.argmax(frame != frame[0])) if len(frame) and frame[-1] != frame[0] else len(frame)
    count, rest = divmod(len(frame), max(markers, 1))
    first = slice(None, None, max(markers, 1))  # first row of every frame
    if (
        rest
        or (frame.reshape(count, markers) != frame[first, None]).any()
        or (codes.reshape(count, markers) != codes[:markers]).any()
    ):
        raise ValueError("does not have the same markers in every frame")
    frames, labels = frame[first].copy(), tuple(texts[codes[:markers]])
    del frame, codes  # as large as a column
    values = {
        name: _to_array(_read_column(file, name), kinds.get(name)).reshape(count, markers)
        for name in names
        if name not in ("frame", "time", "marker")
    }
    time = _to_array(_read_column(file, "time"), "float64")[first].copy()
    return LongTable(schema, frames, time, labels, values, provenance.facts, provenance.reasons)


def _check_size(found: pq.FileMetaData, schema: pa.Schema, limit: int) -> None:
    """Raise ValueError, before any column is read, for a file that would need more than ``limit`` bytes of memory."""
    names = schema.names
    if len(names) > _MOST_COLUMNS:
        raise ValueError(f"has {len(names)} columns, more than any table of mocap-id")
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise ValueError(f"does not have its columns: `{twice}` occurs twice")
    groups = [found.row_group(index) for index in range(found.num_row_groups)]
    packed = sum(group.total_byte_size for group in groups)
    if found.num_rows < 0 or max(packed, found.num_rows * _CELL * len(names)) > limit:
        raise ValueError(f"declares {found.num_rows} rows, which need too much memory for a file of its size")


def read_provenance(metadata: dict[str, str], schema: Any) -> Provenance:
    """Read the provenance from a file's metadata and check its schema; ValueError without a subject."""
    if PREFIX + "schema" not in metadata:
        raise ValueError("was not written by mocap-id: it has no provenance")
    try:
        provenance = Provenance.decode(metadata)
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"has a damaged provenance ({first_line(error)})") from error
    found, expected = (provenance.schema, provenance.schema_version), (schema.file, schema.version)
    if found != expected:
        raise ValueError(f"has schema {found[0]} version {found[1]}, expected {expected[0]} version {expected[1]}")
    return provenance


def _find_columns(table: Table | LongTable) -> list[Column]:
    """Return the schema's columns for a table; ValueError if a column is missing or unknown."""
    names, schema = table.names, table.schema
    columns = list(expand_columns(schema, names))
    missing = [column.name for column in columns if column.name not in names]
    unknown = sorted(set(names) - {column.name for column in columns})
    if missing or unknown:
        raise ValueError(f"{schema.file}: missing columns {missing}, columns that are not in its schema {unknown}")
    return columns


def _rows_to_arrow(table: Table | LongTable, columns: Sequence[Column], schema: pa.Schema, rows: slice) -> pa.Table:
    """Return some rows as an Arrow table."""
    arrays = []
    for column in columns:
        if isinstance(table, LongTable) and column.name == "marker":
            labels = _texts_to_arrow(np.array(table.labels, dtype=object))
            arrays.append(pa.DictionaryArray.from_arrays(_from_buffers(pa.int32(), table.codes(rows)), labels))
        else:
            arrays.append(_to_arrow(_convert(table.column(column.name, rows), column, table.schema.file), column))
    return pa.Table.from_arrays(arrays, schema=schema)


def expand_columns(schema: TableSchema, names: Sequence[str]) -> Iterator[Column]:
    """Yield the schema's columns for a table with these column names.

    A group with ``{k}`` occurs for every k for which ``names`` contains at least one of its columns. A group with
    ``{name}`` occurs for every name with which ``names`` contains its first column. Every other optional group occurs
    if ``names`` contains one of its columns.
    """
    yield from schema.columns
    for group in (schema.repeated, *schema.optional):
        if group and "{name}" in group[0].name:
            pattern = re.escape(group[0].name).replace(r"\{name\}", "(.+)")
            matches = (re.fullmatch(pattern, str(name)) for name in names)
            fields: list[dict[str, Any]] = [{"name": match[1]} for match in matches if match]
        else:
            found = (_compile_pattern(column.name).fullmatch(str(name)) for name in names for column in group)
            fields = [{"k": k} for k in sorted({int(match[1]) if match.groups() else 0 for match in found if match})]
        for values in fields:
            for column in group:
                yield replace(column, name=column.name.format(**values))


@cache
def _compile_pattern(name: str) -> re.Pattern[str]:
    return re.compile(re.escape(name).replace(r"\{k\}", "([1-9][0-9]*)"))


def _make_field(column: Column) -> pa.Field:
    return pa.field(column.name, _TYPES[column.dtype], metadata={"unit": column.unit, "meaning": column.meaning})


def _convert(values: Values, column: Column, file: str) -> Values:
    """Return a contiguous column with its schema's type; ValueError if its own type does not match."""
    found = np.asarray(values)
    if found.size and found.dtype.kind not in KINDS[column.dtype]:
        raise ValueError(f"{file}: column {column.name} has the type {found.dtype}, expected {column.dtype}")
    return np.ascontiguousarray(found, dtype=_STORED[column.dtype])


def _to_arrow(values: Values, column: Column) -> pa.Array:
    """Return a column as an Arrow array, made from its buffer because `pa.array` would import pandas."""
    if column.dtype == "category":
        texts, codes = np.unique(values.astype(str), return_inverse=True)
        return pa.DictionaryArray.from_arrays(_from_buffers(pa.int32(), codes.astype(np.int32)), _texts_to_arrow(texts))
    if column.dtype == "str":
        return _texts_to_arrow(values)
    if column.dtype == "bool":
        return _from_buffers(pa.bool_(), np.packbits(values, bitorder="little"), len(values))
    known = values >= 0 if column.dtype == "Int64" else None
    return _from_buffers(_TYPES[column.dtype], values, known=known)


def _from_buffers(
    kind: pa.DataType, values: Values, length: int | None = None, known: Values | None = None, *more: bytes
) -> pa.Array:
    """Return an Arrow array made of these buffers; ``known`` (n,) is false for values that become null."""
    null = None if known is None or known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
    buffers = [null, pa.py_buffer(values), *map(pa.py_buffer, more)]
    return pa.Array.from_buffers(kind, len(values) if length is None else length, buffers)


def _texts_to_arrow(values: Values) -> pa.Array:
    """Return texts as an Arrow array, with null for None."""
    known = np.array([text is not None for text in values], dtype=np.bool_)
    encoded = [b"" if text is None else str(text).encode() for text in values]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return _from_buffers(pa.string(), ends, len(encoded), known, b"".join(encoded))


def _find_mismatches(found: pa.Schema, schema: TableSchema) -> Iterator[str]:
    types = dict(zip(found.names, found.types, strict=True))
    for column in expand_columns(schema, found.names):
        if column.name not in types:
            yield f"`{column.name}` is missing"
        elif types[column.name] != _TYPES[column.dtype]:
            yield f"`{column.name}` is {types[column.name]}, expected {column.dtype}"


def _read_column(file: pq.ParquetFile, name: str) -> pa.ChunkedArray:
    """Read a column in this thread, because another thread of Arrow could abort the process when it ends."""
    return file.reader.read_column(file.schema_arrow.names.index(name))


def _read_categories(column: pa.ChunkedArray) -> tuple[Values, Values]:
    """Return for each row of a column the index of its text, and the array of distinct texts."""
    parts = column.unify_dictionaries().chunks
    codes = np.concatenate([np.empty(0, np.int32), *(np.from_dlpack(part.indices) for part in parts)])
    return codes, np.array(parts[0].dictionary.to_pylist() if parts else [], dtype=object)


def _to_array(column: pa.ChunkedArray, kind: str | None) -> Values:
    """Return a column as a numpy array, without `to_numpy`, which would import pandas; -1 for a missing integer."""
    match kind:
        case "category":
            codes, texts = _read_categories(column)
            return np.asarray(texts[codes])
        case "Int64":
            return np.array([-1 if value is None else value for value in column.to_pylist()], dtype=np.int64)
        case "bool":
            return _join_parts(column.cast(pa.uint8()), np.uint8).view(np.bool_)
        case "float64" | "int64":
            return _join_parts(column, _STORED[kind])
    return np.array(column.to_pylist(), dtype=object)


def _join_parts(column: pa.ChunkedArray, kind: Any) -> Values:
    parts = [np.from_dlpack(part) for part in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, kind), *parts])
