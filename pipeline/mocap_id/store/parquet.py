"""Tables as Parquet: typed by their schema, units in the field metadata, provenance in the schema metadata."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mocap_id.arrays import chunks
from mocap_id.store.artefacts import Column, LongTable, Table, TableSchema, Values
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
_KINDS = {"float64": "fiu", "int64": "iu", "Int64": "iu", "bool": "b", "category": "OU", "str": "OU"}
_STORED = {
    "float64": np.float64,
    "int64": np.int64,
    "Int64": np.int64,
    "bool": np.bool_,
    "category": object,
    "str": object,
}


def write(table: Table | LongTable, origin: Origin, stream: BinaryIO | HashedStream) -> None:
    """Write the table as a Parquet file, a stretch of rows at a time.

    Every page has a checksum, so that every Parquet library finds damage.

    Raises
    ------
    ValueError
        The table does not have the columns or types that its schema promises.
    """
    columns = _columns(table)
    provenance = Provenance(table.schema.file, table.schema.version, origin, table.facts, table.reasons)
    schema = pa.schema([_field(column) for column in columns], metadata=provenance.encode())
    numbers = [column.name for column in columns if column.dtype == "float64"]  # they hardly repeat: split into bytes
    coded = [column.name for column in columns if column.dtype != "float64"]
    how = {"compression": "zstd", "use_dictionary": coded, "use_byte_stream_split": numbers}
    with pq.ParquetWriter(stream, schema, **how, write_page_checksum=True) as writer:
        for rows in chunks(table.length, _ROWS):
            writer.write_table(_stretch(table, columns, schema, rows))


def encode(table: Table | LongTable, origin: Origin) -> bytes:
    """The table as the bytes of a Parquet file; ValueError as for :func:`write`."""
    stream = io.BytesIO()
    write(table, origin, stream)
    return stream.getvalue()


def arrow(table: Table | LongTable) -> pa.Table:
    """The whole as an Arrow table with its schema's columns, types and order; ValueError as for :func:`conform`."""
    columns = _columns(table)
    return _stretch(table, columns, pa.schema([_field(column) for column in columns]), slice(None))


def conform(table: Table | LongTable) -> Table | LongTable:
    """The same in exactly its schema's columns, types and order, as :func:`decode` gives it.

    Raises
    ------
    ValueError
        A column is missing, unknown or cannot be converted without loss.
    """
    columns = _columns(table)
    if isinstance(table, LongTable) != table.schema.long:
        raise ValueError(f"{table.schema.file}: expected a {'LongTable' if table.schema.long else 'Table'}")
    if isinstance(table, LongTable):
        values = {c.name: _typed(table.values[c.name], c, table.schema.file) for c in columns if c.name in table.values}
        frames, time = np.ascontiguousarray(table.frames), np.ascontiguousarray(table.time)
        return replace(table, frames=frames, time=time, labels=tuple(map(str, table.labels)), values=values)
    return replace(table, columns={c.name: _typed(table.columns[c.name], c, table.schema.file) for c in columns})


def decode(content: bytes | BinaryIO, schema: TableSchema) -> tuple[Table | LongTable, Provenance]:
    """The table of a Parquet file, given as its bytes or open, checked against its schema and its pages' checksums.

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
        file = pq.ParquetFile(stream, page_checksum_verification=True)
        found = file.schema_arrow
        metadata = {key.decode(): value.decode() for key, value in (found.metadata or {}).items()}
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"is damaged ({_first_line(error)})") from error
    _check_size(file.metadata, found, _ROOM * size + _LEAST_ROOM)
    provenance = read_provenance(metadata, schema)
    problem = "; ".join(_mismatches(found, schema))
    if problem:
        raise ValueError(f"does not have its columns: {problem}")
    try:
        return _table(file, schema, provenance), provenance
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"is damaged ({_first_line(error)})") from error


def _table(file: pq.ParquetFile, schema: TableSchema, told: Provenance) -> Table | LongTable:
    """The columns of an open file, one by one."""
    names = file.schema_arrow.names
    kinds = {column.name: column.dtype for column in columns_of(schema, names)}
    if not schema.long:
        columns = {name: _array(_column(file, name), kinds.get(name)) for name in names}
        return Table(schema, columns, told.facts, told.reasons)
    frame, (codes, texts) = _array(_column(file, "frame"), "int64"), _coded(_column(file, "marker"))
    markers = int(np.argmax(frame != frame[0])) if len(frame) and frame[-1] != frame[0] else len(frame)
    count, rest = divmod(len(frame), max(markers, 1))
    first = slice(None, None, max(markers, 1))  # row of every frame
    if (
        rest
        or (frame.reshape(count, markers) != frame[first, None]).any()
        or (codes.reshape(count, markers) != codes[:markers]).any()
    ):
        raise ValueError("does not have the same markers in every frame")
    values = {
        name: _array(_column(file, name), kinds.get(name)).reshape(count, markers)
        for name in names
        if name not in ("frame", "time", "marker")
    }
    time, labels = _array(_column(file, "time"), "float64")[first].copy(), tuple(texts[codes[:markers]])
    return LongTable(schema, frame[first].copy(), time, labels, values, told.facts, told.reasons)


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


def _columns(table: Table | LongTable) -> list[Column]:
    """The columns that the schema asks of this table; ValueError where one is missing or unknown."""
    names, schema = table.names, table.schema
    columns = list(columns_of(schema, names))
    missing = [column.name for column in columns if column.name not in names]
    unknown = sorted(set(names) - {column.name for column in columns})
    if missing or unknown:
        raise ValueError(f"{schema.file}: missing columns {missing}, columns that its schema does not name {unknown}")
    return columns


def _stretch(table: Table | LongTable, columns: Sequence[Column], schema: pa.Schema, rows: slice) -> pa.Table:
    """Some rows as an Arrow table."""
    arrays = []
    for column in columns:
        if isinstance(table, LongTable) and column.name == "marker":
            labels = _texts(np.array(table.labels, dtype=object))
            arrays.append(pa.DictionaryArray.from_arrays(_plain(pa.int32(), table.codes(rows)), labels))
        else:
            arrays.append(_arrow(_typed(table.column(column.name, rows), column, table.schema.file), column))
    return pa.Table.from_arrays(arrays, schema=schema)


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


def _typed(values: Values, column: Column, file: str) -> Values:
    """A column in its schema's type, in one piece; ValueError where it is another kind of thing."""
    found = np.asarray(values)
    if found.size and found.dtype.kind not in _KINDS[column.dtype]:
        raise ValueError(f"{file}: column {column.name} holds {found.dtype}, expected {column.dtype}")
    return np.ascontiguousarray(found, dtype=_STORED[column.dtype])


def _arrow(values: Values, column: Column) -> pa.Array:
    """One column for Arrow, from its bytes: `pa.array` would import pandas."""
    if column.dtype == "category":
        texts, codes = np.unique(values.astype(str), return_inverse=True)
        return pa.DictionaryArray.from_arrays(_plain(pa.int32(), codes.astype(np.int32)), _texts(texts))
    if column.dtype == "str":
        return _texts(values)
    if column.dtype == "bool":
        return _plain(pa.bool_(), np.packbits(values, bitorder="little"), len(values))
    known = values >= 0 if column.dtype == "Int64" else None
    return _plain(_TYPES[column.dtype], values, known=known)


def _plain(
    kind: pa.DataType, values: Values, length: int | None = None, known: Values | None = None, *more: bytes
) -> pa.Array:
    """An Arrow array of a buffer; ``known`` (n,) is false where it holds null."""
    null = None if known is None or known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
    buffers = [null, pa.py_buffer(values), *map(pa.py_buffer, more)]
    return pa.Array.from_buffers(kind, len(values) if length is None else length, buffers)


def _texts(values: Values) -> pa.Array:
    """Texts, None as null."""
    known = np.array([text is not None for text in values], dtype=np.bool_)
    encoded = [b"" if text is None else str(text).encode() for text in values]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return _plain(pa.string(), ends, len(encoded), known, b"".join(encoded))


def _mismatches(found: pa.Schema, schema: TableSchema) -> Iterator[str]:
    types = dict(zip(found.names, found.types, strict=True))
    for column in columns_of(schema, found.names):
        if column.name not in types:
            yield f"`{column.name}` is missing"
        elif types[column.name] != _TYPES[column.dtype]:
            yield f"`{column.name}` is {types[column.name]}, expected {column.dtype}"


def _column(file: pq.ParquetFile, name: str) -> pa.ChunkedArray:
    return file.read(columns=[name]).column(name)


def _coded(column: pa.ChunkedArray) -> tuple[Values, Values]:
    """Indices of a column's texts, and the texts."""
    parts = column.unify_dictionaries().chunks
    codes = np.concatenate([np.empty(0, np.int32), *(np.from_dlpack(part.indices) for part in parts)])
    return codes, np.array(parts[0].dictionary.to_pylist() if parts else [], dtype=object)


def _array(column: pa.ChunkedArray, kind: str | None) -> Values:
    """One column as an array; `to_numpy` would import pandas."""
    match kind:
        case "category":
            codes, texts = _coded(column)
            return np.asarray(texts[codes])
        case "Int64":
            return np.array([-1 if value is None else value for value in column.to_pylist()], dtype=np.int64)
        case "bool":
            return _joined(column.cast(pa.uint8()), np.uint8).view(np.bool_)
        case "float64" | "int64":
            return _joined(column, _STORED[kind])
    return np.array(column.to_pylist(), dtype=object)


def _joined(column: pa.ChunkedArray, kind: Any) -> Values:
    parts = [np.from_dlpack(part) for part in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, kind), *parts])


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
