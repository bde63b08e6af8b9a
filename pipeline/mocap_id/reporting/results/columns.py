"""Result tables: declared columns, and rows as data frame, CSV and Parquet."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from mocap_id import __version__
from mocap_id.store import Column, Table, TableSchema
from mocap_id.store.parquet import expand_columns, to_arrow
from mocap_id.store.provenance import PREFIX

_MISSING = {"str": "", "float64": math.nan, "Int64": pd.NA}


Value: TypeAlias = Callable[[Any], Any] | None


@dataclass(frozen=True)
class ResultColumn(Column):
    """A column of a result table: its name, type, unit and meaning, and the source of its values."""

    # Function of the row's object that returns the value. None if each row is a mapping of column names to values.
    value: Value = None


def text(name: str, meaning: str, value: Value = None) -> ResultColumn:
    """Return a column of texts."""
    return ResultColumn(name, "str", "", meaning, value)


def number(name: str, unit: str, meaning: str, value: Value = None) -> ResultColumn:
    """Return a column of numbers, NaN where unknown."""
    return ResultColumn(name, "float64", unit, meaning, value)


def whole(name: str, meaning: str, value: Value = None) -> ResultColumn:
    """Return a column of whole numbers in which no value may be missing."""
    return ResultColumn(name, "int64", "1", meaning, value)


def count(name: str, meaning: str, value: Value = None) -> ResultColumn:
    """Return a column of whole numbers in which values may be missing."""
    return ResultColumn(name, "Int64", "1", meaning, value)


@dataclass(frozen=True)
class ResultTable:
    """The rows of a result table with their schema."""

    schema: TableSchema
    frame: pd.DataFrame

    @classmethod
    def of(cls, schema: TableSchema, rows: Iterable[Any]) -> ResultTable:
        """Return the table of these rows; where a row has no value for a column, the value is missing.

        Parameters
        ----------
        schema : TableSchema
        rows : iterable
            Mappings of column names to values, or objects from which the columns take their values.

        Raises
        ------
        ValueError
            A row has a value for a column that the schema does not have.
        """
        named = [row if isinstance(row, Mapping) else dict(_read_values(schema, row)) for row in rows]
        given = [name for row in named for name in row]
        columns = list(expand_columns(schema, [*given, *(column.name for column in schema.columns)]))
        unknown = set(given) - {column.name for column in columns}
        if unknown:
            raise ValueError(f"{schema.file} has no columns {sorted(unknown)}")
        data = {}
        for column in columns:
            values = [row.get(column.name) for row in named]
            filled = [_MISSING.get(column.dtype) if value is None else value for value in values]
            data[column.name] = pd.Series(filled, dtype=column.dtype)
        return cls(schema, pd.DataFrame(data))

    @property
    def columns(self) -> list[dict[str, str]]:
        """Name, unit and meaning of every column, for a JSON document."""
        columns = expand_columns(self.schema, list(self.frame.columns))
        return [{"name": column.name, "unit": column.unit, "meaning": column.meaning} for column in columns]

    @property
    def description(self) -> dict[str, Any]:
        """Number of rows, and name, unit and meaning of every column, for a JSON document."""
        return {"rows": len(self.frame), "columns": self.columns}

    @property
    def records(self) -> list[dict[str, Any]]:
        """The rows as mappings for a JSON document; None where a number is not finite."""
        rows = self.frame.to_dict(orient="records")
        return [{str(k): to_finite(v) if isinstance(v, float) else v for k, v in row.items()} for row in rows]

    @cached_property
    def _arrow(self) -> pa.Table:
        return to_arrow(Table.from_frame(self.schema, self.frame))

    def csv(self) -> bytes:
        """Return the content of a CSV file with the table; a missing value is empty."""
        stream = io.BytesIO()
        pyarrow.csv.write_csv(pa.table(dict(_replace_nan(self._arrow))), stream)
        return stream.getvalue()

    def parquet(self, kind: str) -> bytes:
        """Return the content of a Parquet file with the table; units and meanings are in the field metadata.

        Parameters
        ----------
        kind : str
            Kind of the result, such as ``study``. It is the first part of the schema's name in the metadata.
        """
        about = {"schema": f"{kind}/{self.schema.file}", "schema_version": str(self.schema.version)}
        metadata = {f"{PREFIX}{key}": text for key, text in {**about, "product": __version__}.items()}
        stream = io.BytesIO()
        pyarrow.parquet.write_table(self._arrow.replace_schema_metadata(metadata), stream)
        return stream.getvalue()


def to_finite(value: float) -> float | None:
    """Return a number for a JSON document; None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def _read_values(schema: TableSchema, source: Any) -> Iterator[tuple[str, Any]]:
    for column in schema.columns:
        if isinstance(column, ResultColumn) and column.value is not None:
            yield column.name, column.value(source)


def _replace_nan(table: pa.Table) -> Iterator[tuple[str, Any]]:
    for name in table.column_names:
        column = table.column(name)
        if pa.types.is_floating(column.type):
            column = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
        yield name, column
