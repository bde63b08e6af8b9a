"""Schemas of all artefacts, read from ``schemas.toml``.

The schemas are a public interface: columns may be added freely, but renamed only with a new schema version.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mocap_id.store.columns import Column, TableSchema, TreeSchema


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
