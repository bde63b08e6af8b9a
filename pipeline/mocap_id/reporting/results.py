"""Results of commands: tables with declared columns, and a JSON document that is written with all other files or not.

A column is declared once: its name, unit and meaning for the files, the source of its values, and, if a page shows it,
its heading and the form of its cells.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from mocap_id import __version__
from mocap_id.errors import StoreError
from mocap_id.reporting import grids
from mocap_id.reporting.grids import Grid, GridColumn
from mocap_id.store import Column, Table, TableSchema, hash_bytes
from mocap_id.store.atomic import write_files
from mocap_id.store.folder import describe_conflict
from mocap_id.store.parquet import expand_columns, to_arrow
from mocap_id.store.provenance import PREFIX

_MISSING = {"str": "", "float64": math.nan, "Int64": pd.NA}

Value: TypeAlias = Callable[[Any], Any] | None
"""Source of a column's values: a function of the row's object. None if a row is a mapping of names to values."""


@dataclass(frozen=True)
class ResultColumn(Column):
    """A column of a result table: its name, type, unit and meaning, the source of its values, and its look."""

    value: Value = None
    shown: GridColumn | None = None  # heading and cells on a page; None if no page shows the column


def text(
    name: str, meaning: str, value: Value = None, head: str | None = None, *, cell: Value = None, missing: str = ""
) -> ResultColumn:
    """Return a column of texts; on a page, with the heading ``head``, and cells by a function of the row."""
    shown = None if head is None else grids.texts(head, cell or name, missing)
    return ResultColumn(name, "str", "", meaning, value, shown)


def number(
    name: str,
    unit: str,
    meaning: str,
    value: Value = None,
    head: str | None = None,
    *,
    decimals: int | None = None,
    factor: float = 1.0,
    optional: bool = False,
) -> ResultColumn:
    """Return a column of numbers, NaN where unknown; on a page as by :func:`mocap_id.reporting.grids.numbers`."""
    shown = None if head is None else grids.numbers(head, name, decimals, factor, optional=optional)
    return ResultColumn(name, "float64", unit, meaning, value, shown)


def whole(name: str, meaning: str, value: Value = None, head: str | None = None) -> ResultColumn:
    """Return a column of whole numbers in which no value may be missing."""
    return ResultColumn(name, "int64", "1", meaning, value, None if head is None else grids.numbers(head, name, 0))


def count(name: str, meaning: str, value: Value = None, head: str | None = None) -> ResultColumn:
    """Return a column of whole numbers in which values may be missing."""
    return ResultColumn(name, "Int64", "1", meaning, value, None if head is None else grids.numbers(head, name, 0))


def shown_as(
    column: ResultColumn, head: str, cell: Callable[[Any], str], *, optional: bool = False, text: bool = False
) -> ResultColumn:
    """Return a column that a page shows by a function of the row, which may read other columns too."""
    return replace(column, shown=GridColumn(head, cell, text, optional))


_INTERVAL_ENDS = {"": "", "low": ", lower end of the 95 % interval", "high": ", upper end of the 95 % interval"}


def estimate_columns(
    name: str, unit: str, meaning: str, estimate: Callable[[Any], Any] | None = None, head: str | None = None
) -> list[ResultColumn]:
    """Return the columns of an estimate: its value, and both ends of its 95 % interval; a page shows them in one cell.

    ``estimate`` returns the estimate of a trial; by default, the rows contain the values by column name.
    """

    def read_part(part: str) -> Value:
        return None if estimate is None else lambda trial: getattr(estimate(trial), part)

    value, *ends = (
        number(f"{name}_{end}" if end else name, unit, f"{meaning}{words}", read_part(end or "value"))
        for end, words in _INTERVAL_ENDS.items()
    )
    return [
        value if head is None else shown_as(value, head, lambda row: grids.show_estimate(row, name), optional=True),
        *ends,
    ]


_PARTS = {"mean": "mean", "sd": "standard deviation", "rms": "root mean square"}


def error_columns(
    name: str,
    unit: str,
    meaning: str,
    parts: str = "mean sd rms",
    *,
    head: str | None = None,
    factor: float = 1.0,
    decimals: int = 1,
) -> list[ResultColumn]:
    """Return the columns of a mean with the other ``parts``; a page shows mean ± sd, times a factor, in one cell."""
    mean, *others = (number(f"{name}_{part}", unit, f"{meaning}: {_PARTS[part]}") for part in parts.split())
    return [mean if head is None else replace(mean, shown=grids.means_with_sd(head, name, factor, decimals)), *others]


def declare_tables(**columns: Iterable[ResultColumn]) -> dict[str, TableSchema]:
    """Return the schemas of tables by name; a column with ``{k}`` in its name occurs once for each joint."""
    return {
        name: TableSchema(
            f"{name}.parquet",
            1,
            tuple(one for one in own if "{k}" not in one.name),
            tuple(one for one in own if "{k}" in one.name),
        )
        for name, own in ((name, list(own)) for name, own in columns.items())
    }


@dataclass(frozen=True)
class ResultTable:
    """The rows of a result table with their schema."""

    schema: TableSchema
    frame: pd.DataFrame

    @classmethod
    def of(cls, schema: TableSchema, rows: Iterable[Any]) -> ResultTable:
        """Return the table of these rows; where a row has no value for a column, the value is missing.

        ``rows`` are mappings of column names to values, or objects from which the columns take their values.

        Raises
        ------
        ValueError
            A row has a value for a column that the schema does not have.
        """
        sources = {one.name: one.value for one in schema.columns if isinstance(one, ResultColumn) and one.value}
        named = [
            row if isinstance(row, Mapping) else {name: read(row) for name, read in sources.items()} for row in rows
        ]
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
    def heads(self) -> dict[str, str]:
        """Headings of the columns that pages show, by name."""
        return {one.name: one.shown.head for one in self.schema.columns if isinstance(one, ResultColumn) and one.shown}

    def grid(self, caption: str, *columns: str | GridColumn, rows: pd.DataFrame | None = None) -> Grid:
        """Return a table of a page.

        ``columns`` are names of columns as they are declared, separated by blanks, or columns of this page alone.
        ``rows`` are rows of the table's frame; all rows by default.
        """
        shown = {one.name: one.shown for one in self.schema.columns if isinstance(one, ResultColumn) and one.shown}
        listed: list[GridColumn] = []
        for one in columns:
            listed += [shown[name] for name in one.split()] if isinstance(one, str) else [one]
        return grids.to_grid(caption, self.frame if rows is None else rows, listed)

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
        stream, columns = io.BytesIO(), {}
        for name in self._arrow.column_names:
            column = self._arrow.column(name)
            if pa.types.is_floating(column.type):
                column = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
            columns[name] = column
        pyarrow.csv.write_csv(pa.table(columns), stream)
        return stream.getvalue()

    def parquet(self, kind: str) -> bytes:
        """Return the content of a Parquet file with the table; units and meanings are in the field metadata.

        ``kind`` of the result, such as ``study``, is the first part of the schema's name in the metadata.
        """
        about = {"schema": f"{kind}/{self.schema.file}", "schema_version": str(self.schema.version)}
        metadata = {f"{PREFIX}{key}": text for key, text in {**about, "product": __version__}.items()}
        stream = io.BytesIO()
        pyarrow.parquet.write_table(self._arrow.replace_schema_metadata(metadata), stream)
        return stream.getvalue()


def to_finite(value: float) -> float | None:
    """Return a number for a JSON document; None if it is not finite."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class CommandResult:
    """The output of a command: a JSON document (``file``), tables and other files."""

    kind: str  # kind of the result, such as ``study``; the schema of the document is ``mocap-id/<kind>``
    file: str  # name of the JSON document
    content: Mapping[str, Any]  # content of the document after the keys for schema and version; without NaN
    # Tables by name; each is written as CSV and Parquet.
    tables: Mapping[str, ResultTable] = field(default_factory=dict)
    # Function that returns the other files, such as page and figures, by name. It is called once.
    other_files: Callable[[], Mapping[str, bytes]] = dict
    hashed: bool = False  # whether the document ends with the hash of every other file
    # Names of what the result is made from, and hashes that identify it; the document contains them.
    made_from: Mapping[str, Sequence[str]] | None = None
    indent: int = 1  # indentation of the document
    end: str = "\n"  # last characters of the document

    @cached_property
    def files(self) -> dict[str, bytes]:
        """All files except the document, by name."""
        files = {}
        for name, table in self.tables.items():
            files[f"{name}.csv"] = table.csv()
            files[f"{name}.parquet"] = table.parquet(self.kind)
        return {**files, **self.other_files()}

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """Content of the JSON document, including schema, version and, if requested, the hashes of all other files."""
        head = {"schema": f"mocap-id/{self.kind}", "version": 1, **self.content}
        head |= {} if self.made_from is None else {"made_from": self.made_from}
        return head | {"files": {name: hash_bytes(file) for name, file in self.files.items()}} if self.hashed else head

    def write(self, folder: Path) -> tuple[str, ...]:
        """Write all files, or none if one cannot be written; return their names, the document first.

        Raises
        ------
        StoreError
            The folder cannot be written, or contains this document, made from something else.
        """
        before = None if self.made_from is None else _read_made_from(folder / self.file)
        if before is not None and self.made_from is not None and not {*before["hashes"]} & {*self.made_from["hashes"]}:
            names = (", ".join(each["names"]) for each in (before, self.made_from))
            raise StoreError(describe_conflict(folder / self.file, *names))
        text = json.dumps(self.document, indent=self.indent, ensure_ascii=False, allow_nan=False) + self.end
        write_files(folder, {**self.files, self.file: text.encode()})
        return (self.file, *self.files)


def _read_made_from(file: Path) -> Mapping[str, Sequence[str]] | None:
    """Return from what an existing document was made; None if it does not say so."""
    try:
        found = json.loads(file.read_text("utf-8"))["made_from"]
        return {key: [str(text) for text in found[key]] for key in ("names", "hashes")}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def make_text_file(lines: Iterable[str]) -> bytes:
    """Return lines as the content of a text file."""
    return "".join(f"{line}\n" for line in lines).encode()
