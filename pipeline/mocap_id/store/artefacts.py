"""What a stage takes and gives: tables, trees and documents, each with its schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    import pandas as pd

Facts: TypeAlias = Mapping[str, Any]
"""Numbers and choices beside the data, JSON values only; None where a quantity could not be determined."""

Node: TypeAlias = "np.ndarray[Any, Any] | str | float | int | Mapping[str, Node]"


@dataclass(frozen=True)
class Column:
    """One column of a table: its name, numpy kind and unit (``"1"`` = dimensionless, ``""`` = not a quantity)."""

    name: str
    dtype: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class TableSchema:
    """The columns of a Parquet artefact.

    ``repeated`` columns carry ``{k}`` in their name and come once per joint (``theta_{k}``) or plate (``Fx_p{k}``),
    in the order of ``k`` first, k = 1, 2, … ``optional`` groups are there as a whole or not at all; with ``{k}``, once
    for every k.
    """

    file: str
    version: int
    columns: tuple[Column, ...]
    repeated: tuple[Column, ...] = ()
    optional: tuple[tuple[Column, ...], ...] = ()


@dataclass(frozen=True)
class TreeSchema:
    """The nodes of an HDF5 artefact: path in the file → column-like description."""

    file: str
    version: int
    nodes: tuple[Column, ...]


@dataclass(frozen=True)
class Table:
    """A Parquet artefact in memory."""

    schema: TableSchema
    frame: pd.DataFrame
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(self.frame)

    @property
    def names(self) -> list[str]:
        """The columns'."""
        return [str(name) for name in self.frame.columns]

    def column(self, name: str, rows: slice = slice(None)) -> pd.Series[Any]:
        """A column, or some rows of it."""
        return self.frame[name].iloc[rows]


@dataclass(frozen=True)
class LongTable:
    """A Parquet artefact in memory with a row for every frame and marker, in this order, whose labels take no room.

    Parameters
    ----------
    schema : TableSchema
        With the columns ``frame``, ``time`` and ``marker``.
    frames : (F,) int array
    time : (F,) array
        s.
    labels : (M,) sequence of str
    values : mapping of str to (F, M) array
        The other columns.
    """

    schema: TableSchema
    frames: IntArray
    time: FloatArray
    labels: Sequence[str]
    values: Mapping[str, FloatArray | BoolArray]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()

    @property
    def length(self) -> int:
        """Number of rows."""
        return len(self.frames) * len(self.labels)

    @property
    def names(self) -> list[str]:
        """The columns'."""
        return ["frame", "time", "marker", *self.values]

    def column(self, name: str, rows: slice = slice(None)) -> pd.Series[Any]:
        """A column, or some rows of it."""
        import pandas as pd  # noqa: PLC0415  most who know what an artefact is make none

        if name in self.values:
            return pd.Series(self.values[name].reshape(-1)[rows], name=name, copy=False)
        start, stop, _ = rows.indices(self.length)
        markers = max(len(self.labels), 1)
        first, last = start // markers, -(-stop // markers)  # frames
        own = slice(start - first * markers, stop - first * markers)
        if name == "marker":
            codes = np.tile(np.arange(markers, dtype=np.int32), last - first)[own]
            return pd.Series(pd.Categorical.from_codes(codes, categories=pd.Index(self.labels)), name=name)
        each = {"frame": self.frames, "time": self.time}[name]
        return pd.Series(np.repeat(each[first:last], markers)[own], name=name, copy=False)

    @property
    def frame(self) -> pd.DataFrame:
        """All of it, with all its labels."""
        import pandas as pd  # noqa: PLC0415

        return pd.DataFrame({name: self.column(name) for name in self.names})


@dataclass(frozen=True)
class Tree:
    """An HDF5 artefact in memory: nested names → arrays, strings, numbers."""

    schema: TreeSchema
    data: Mapping[str, Node]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class Document:
    """A file for people or other programs, written as it is."""

    file: str
    content: bytes


Artefact: TypeAlias = Table | Tree
