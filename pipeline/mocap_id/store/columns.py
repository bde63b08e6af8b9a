"""Classes that describe the columns and nodes of artefacts, and the schemas made of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """Name, numpy type, unit and meaning of one column.

    The unit is ``"1"`` for a dimensionless quantity and ``""`` if the column is not a quantity.
    """

    name: str
    dtype: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class TableSchema:
    """The columns of a Parquet artefact.

    The names of ``repeated`` columns contain ``{k}``. They occur once per joint (``theta_{k}``) or plate (``Fx_p{k}``),
    ordered by k = 1, 2, … An ``optional`` group is present completely or not at all. A group with ``{k}`` occurs once
    for every k; a group with ``{name}`` occurs once for every segment or angle that its first column names. A ``long``
    table has a row for every frame and marker, and is a ``LongTable`` in memory.
    """

    file: str
    version: int
    columns: tuple[Column, ...]
    repeated: tuple[Column, ...] = ()
    optional: tuple[tuple[Column, ...], ...] = ()
    long: bool = False


@dataclass(frozen=True)
class TreeSchema:
    """The nodes of an HDF5 artefact. Each is described like a column; its name is its path in the file.

    A group of ``optional`` nodes is present completely or not at all.
    """

    file: str
    version: int
    nodes: tuple[Column, ...]
    optional: tuple[tuple[Column, ...], ...] = ()

    def expand_nodes(self, names: Collection[str]) -> tuple[Column, ...]:
        """Return all nodes of the schema that a tree with nodes of these names must have."""
        groups = [group for group in self.optional if any(node.name in names for node in group)]
        return self.nodes + tuple(node for group in groups for node in group)
