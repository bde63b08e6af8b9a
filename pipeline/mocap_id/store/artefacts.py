"""Artefacts in memory: tables, long tables and trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.store.provenance import TableSchema, TreeSchema
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    import pandas as pd

Facts: TypeAlias = Mapping[str, Any]
"""Numbers and choices stored beside the data, as JSON values; None if a quantity could not be determined."""

Values: TypeAlias = "np.ndarray[Any, Any]"
"""A column of a table."""

KINDS = {"float64": "fiu", "int64": "iu", "Int64": "iu", "bool": "b", "category": "OU", "str": "OU"}
"""Kinds of numpy types that an array may have in memory, by the type in the schema."""

Node: TypeAlias = "np.ndarray[Any, Any] | str | float | int | Mapping[str, Node]"


@dataclass(frozen=True)
class Table:
    """A Parquet artefact in memory, with its columns as arrays.

    ``columns`` contains arrays (n,) by name. Numbers and truth values have their numpy types; texts are object arrays
    of str. A nullable integer is int64 with -1 where the file has null.
    """

    schema: TableSchema
    columns: Mapping[str, Values]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @classmethod
    def from_frame(
        cls, schema: TableSchema, frame: pd.DataFrame, facts: Facts | None = None, reasons: tuple[Reason, ...] = ()
    ) -> Table:
        """Return a table made of a data frame; missing integers become -1, and missing texts become None."""
        return cls(schema, {str(name): _to_array(frame[name]) for name in frame.columns}, facts or {}, reasons)

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def nbytes(self) -> int:
        """Size of the arrays, bytes."""
        return sum(values.nbytes for values in self.columns.values())

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.columns)

    def __getitem__(self, name: str) -> Values:
        return self.columns[name]

    def stack(self, names: Sequence[str]) -> FloatArray:
        """Return some columns of numbers side by side, (n, len(names))."""
        return np.stack([self.columns[name] for name in names], axis=1).astype(np.float64, copy=False)

    def column(self, name: str, rows: slice = slice(None)) -> Values:
        """Return a column (n,), or the given rows of it."""
        return self.columns[name][rows]

    def with_columns(self, **columns: Values) -> Table:
        """Return a copy of the table in which these columns are replaced or added."""
        return replace(self, columns={**self.columns, **columns})

    @property
    def frame(self) -> pd.DataFrame:
        """The table as a data frame."""
        return _to_frame(self)


@dataclass(frozen=True)
class LongTable:
    """A Parquet artefact in memory with a row for every frame and marker; the rows of a frame are consecutive.

    The schema is ``long``, with the columns ``frame``, ``time`` and ``marker``.
    """

    schema: TableSchema
    frames: IntArray  # (F,) frame numbers
    time: FloatArray  # (F,) s
    labels: Sequence[str]  # M names of markers
    values: Mapping[str, FloatArray | BoolArray]  # all other columns, (F, M)
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(self.frames) * len(self.labels)

    @property
    def nbytes(self) -> int:
        """Size of the arrays in ``values``, bytes."""
        return sum(values.nbytes for values in self.values.values())

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return ["frame", "time", "marker", *self.values]

    def column(self, name: str, rows: slice = slice(None)) -> Values:
        """Return a column with a value for every row of the table, or for the given rows."""
        if name == "marker":
            return np.array(self.labels, dtype=object)[self.codes(rows)]
        if name in self.values:
            return self.values[name].reshape(-1)[rows]
        first, last, inside = self._find_frames(rows)
        return np.repeat({"frame": self.frames, "time": self.time}[name][first:last], len(self.labels))[inside]

    def codes(self, rows: slice = slice(None)) -> Values:
        """Return for each of the given rows the index of its marker in ``labels`` (int32)."""
        first, last, inside = self._find_frames(rows)
        return np.tile(np.arange(len(self.labels), dtype=np.int32), last - first)[inside]

    def _find_frames(self, rows: slice) -> tuple[int, int, slice]:
        """Return the index of the first frame of ``rows``, that after the last, and the rows within these frames."""
        start, stop, _ = rows.indices(self.length)
        markers = max(len(self.labels), 1)
        first, last = start // markers, -(-stop // markers)
        return first, last, slice(start - first * markers, stop - first * markers)

    @property
    def frame(self) -> pd.DataFrame:
        """The table as a data frame, with a label in every row."""
        return _to_frame(self)


def _to_array(series: pd.Series[Any]) -> Values:
    """Return a data frame's column as an array, with None for a missing text and -1 for a missing integer."""
    kind = str(series.dtype)
    if kind in ("category", "str", "object", "string"):
        texts = series.astype(object)
        return np.asarray(texts.where(texts.notna(), None), dtype=object)
    if kind == "Int64":
        return np.asarray(series.fillna(-1), dtype=np.int64)
    return np.asarray(series)


def _to_frame(table: Table | LongTable) -> pd.DataFrame:
    """Return a data frame with the schema's types: repeated texts as categories, -1 of a nullable integer as NA."""
    import pandas as pd  # noqa: PLC0415  a run needs no data frames

    kinds = {column.name: column.dtype for column in table.schema.columns}
    series: dict[str, Any] = {}
    for name in table.names:
        if name == "marker" and isinstance(table, LongTable):
            labels, ranks = np.unique(np.array(table.labels, dtype=str), return_inverse=True)
            series[name] = pd.Categorical.from_codes(ranks[table.codes()], pd.Index(labels, dtype="str"))
            continue
        values, kind = table.column(name), kinds.get(name)
        if kind == "category":
            series[name] = pd.Categorical(values)
        elif kind == "str":
            series[name] = pd.array(values, dtype="str")
        elif kind == "Int64":
            series[name] = pd.arrays.IntegerArray(np.asarray(values), np.asarray(values) < 0)
        else:
            series[name] = values
    return pd.DataFrame(series)


@dataclass(frozen=True)
class Tree:
    """An HDF5 artefact in memory: nested mappings of names to arrays, strings and numbers."""

    schema: TreeSchema
    data: Mapping[str, Node]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def nbytes(self) -> int:
        """Always 0, because trees are small."""
        return 0

    def array(self, path: str) -> Values:
        """Return the node at ``group/name`` as an array; KeyError if it does not exist."""
        node: Any = self.data
        for name in path.split("/"):
            node = node[name]
        return np.asarray(node)

    def numbers(self, path: str, shape: tuple[int, ...] = (-1,)) -> FloatArray:
        """Return a node as float64 of this shape; an array without rows if the node does not exist."""
        return np.asarray(self.array(path), np.float64).reshape(shape) if self.has(path) else np.zeros((0, *shape[1:]))

    def integers(self, path: str) -> IntArray:
        """Return a node as a vector of int64; empty if the node does not exist."""
        return np.asarray(self.array(path), np.int64).reshape(-1) if self.has(path) else np.zeros(0, dtype=np.int64)

    def texts(self, path: str) -> tuple[str, ...]:
        """Return a node as texts; empty if the node does not exist."""
        return tuple(map(str, self.array(path).reshape(-1))) if self.has(path) else ()

    def has(self, path: str) -> bool:
        """Return whether the node at ``group/name`` exists."""
        node: Any = self.data
        for name in path.split("/"):
            if not isinstance(node, Mapping) or name not in node:
                return False
            node = node[name]
        return True


Artefact: TypeAlias = Table | LongTable | Tree


def freeze(artefact: Artefact) -> Artefact:
    """Return an artefact with read-only arrays."""
    arrays = {Table: ("columns",), LongTable: ("frames", "time", "values"), Tree: ("data",)}[type(artefact)]
    return replace(artefact, **{name: _make_read_only(getattr(artefact, name)) for name in arrays})


def _make_read_only(data: Any) -> Any:
    """Return read-only views of an array, or of all arrays in a mapping."""
    if isinstance(data, np.ndarray):
        view = data.view()
        view.flags.writeable = False
        return view
    return {name: _make_read_only(item) for name, item in data.items()} if isinstance(data, Mapping) else data
