"""Conversion between artefacts in memory and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from mocap_id.store import hdf5, parquet
from mocap_id.store.artefacts import Artefact, LongTable, Table, Tree
from mocap_id.store.atomic import Content, HashedStream
from mocap_id.store.provenance import Origin, Provenance, TableSchema, TreeSchema, convert_as_stored


def conform(output: Artefact) -> Artefact:
    """Return an artefact as it would be read from its file."""
    typed = hdf5.conform_tree(output) if isinstance(output, Tree) else parquet.conform_table(output)
    facts, reasons = convert_as_stored(output.facts, output.reasons)
    return _freeze(replace(typed, facts=facts, reasons=reasons))


def _freeze(artefact: Artefact) -> Artefact:
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


def make_writer(artefact: Artefact, origin: Origin, checksums: dict[str, tuple[int, str]]) -> Content:
    """Return a function that writes an artefact to a stream and adds its schema version and hash to ``checksums``."""
    version, file = artefact.schema.version, artefact.schema.file

    def write(stream: BinaryIO) -> None:
        hashed = HashedStream(stream)
        if isinstance(artefact, Tree):
            hashed.write(hdf5.encode_tree(artefact, origin))
        else:
            parquet.write(artefact, origin, hashed)
        checksums[file] = version, hashed.hash()

    return write


def decode(stream: BinaryIO, schema: TableSchema | TreeSchema) -> tuple[Artefact, Provenance]:
    """Read an artefact and its provenance from an open file; ValueError if the file is damaged."""
    if isinstance(schema, TreeSchema):
        tree, provenance = hdf5.decode_tree(stream.read(), schema)
        return _freeze(tree), provenance
    table, provenance = parquet.decode_table(stream, schema)
    return _freeze(table), provenance
