"""A workflow's tables, and their files: CSV for spreadsheets, Parquet with units."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from mocap_id import __version__
from mocap_id.store import Table, TableSchema
from mocap_id.store.parquet import columns_of, conform
from mocap_id.store.provenance import PREFIX


def frame(schema: TableSchema, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows as a table with exactly the schema's columns and types; what a row does not name is missing."""
    rows = list(rows)
    given = [name for row in rows for name in row]
    columns = list(columns_of(schema, [*given, *(column.name for column in schema.columns)]))
    unknown = set(given) - {column.name for column in columns}
    if unknown:
        raise ValueError(f"{schema.file} has no columns {sorted(unknown)}")
    missing = {"str": "", "float64": float("nan"), "Int64": pd.NA}
    data = {}
    for column in columns:
        values = [row.get(column.name) for row in rows]
        filled = [missing.get(column.dtype) if value is None else value for value in values]
        data[column.name] = pd.Series(filled, dtype=column.dtype)
    return pd.DataFrame(data)


def table_files(frames: Mapping[str, pd.DataFrame], schemas: Mapping[str, TableSchema], room: str) -> dict[str, bytes]:
    """CSV and Parquet of each table, by file name; in CSV what is missing is empty, in Parquet NaN.

    Parameters
    ----------
    frames, schemas : mapping of str to DataFrame and TableSchema
        By the tables' names.
    room : str
        Stands before the schemas' names in the Parquet files' metadata.
    """
    files = {}
    for name, frame in frames.items():
        whole = conform(Table(schemas[name], frame))
        files[f"{name}.csv"] = _csv(whole)
        files[f"{name}.parquet"] = _parquet(whole, schemas[name], room)
    return files


def _csv(whole: pa.Table) -> bytes:
    stream = io.BytesIO()
    pyarrow.csv.write_csv(pa.table(dict(_without_nan(whole))), stream)
    return stream.getvalue()


def _without_nan(whole: pa.Table) -> Iterator[tuple[str, Any]]:
    for name in whole.column_names:
        column = whole.column(name)
        if pa.types.is_floating(column.type):
            column = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
        yield name, column


def _parquet(whole: pa.Table, schema: TableSchema, room: str) -> bytes:
    told = {"schema": f"{room}/{schema.file}", "schema_version": str(schema.version), "product": __version__}
    stream = io.BytesIO()
    named = whole.replace_schema_metadata({f"{PREFIX}{key}": text for key, text in told.items()})
    pyarrow.parquet.write_table(named, stream)
    return stream.getvalue()
