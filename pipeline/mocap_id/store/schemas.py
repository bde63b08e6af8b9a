"""Columns, nodes and schemas of all artefacts, which are read from ``schemas.toml``.

The schemas are a public interface: columns may be added freely, but renamed only with a new schema version.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any


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


def _read_schemas() -> Iterator[TableSchema | TreeSchema]:
    """Yield the schemas in the order of the file; an entry with nodes is a tree."""
    for file, entry in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items():
        optional = tuple(_build_columns(group) for group in entry.get("optional", {}).values())
        if "nodes" in entry:
            yield TreeSchema(file, entry["version"], _build_columns(entry["nodes"]), optional)
        else:
            columns, repeated = _build_columns(entry["columns"]), _build_columns(entry.get("repeated", ()))
            yield TableSchema(file, entry["version"], columns, repeated, optional, entry.get("long", False))


def _build_columns(rows: Iterable[Any]) -> tuple[Column, ...]:
    return tuple(Column(*row) for row in rows)


SCHEMAS: dict[str, TableSchema | TreeSchema] = {schema.file: schema for schema in _read_schemas()}
"""Schemas of all artefacts by file name."""

TABLES = {file: schema for file, schema in SCHEMAS.items() if isinstance(schema, TableSchema)}
TREES = {file: schema for file, schema in SCHEMAS.items() if isinstance(schema, TreeSchema)}

PLANAR = TABLES["planar.parquet"]
WRENCH = TABLES["wrench.parquet"]
SEGMENTS = TABLES["segments.parquet"]
CHAIN = TREES["chain.h5"]
STATES = TABLES["states.parquet"]
MARKERS = TABLES["markers.parquet"]
SKIN = TREES["skin.h5"]
ENCODER = TABLES["encoder.parquet"]
POSES = TABLES["poses.parquet"]
ANGLES = TABLES["angles.parquet"]
EVENTS = TABLES["events.parquet"]
DYNAMICS_TABLE = TABLES["dynamics.parquet"]
DYNAMICS_TREE = TREES["dynamics.h5"]
PHASES = TABLES["phases.parquet"]

RISE = EVENTS.optional[0]
"""Additional columns of events.parquet for a sit-to-stand."""
