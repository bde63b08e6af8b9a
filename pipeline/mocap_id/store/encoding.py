"""Artefacts in memory as their files would give them, and what writes and reads these files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from mocap_id.store.artefacts import Artefact, LongTable, Table, TableSchema, Tree, TreeSchema
from mocap_id.store.atomic import Content
from mocap_id.store.digest import HashedStream
from mocap_id.store.provenance import Origin, Provenance, settled
from mocap_id.store.record import Seal


def conformed(output: Artefact) -> Artefact:
    """An artefact as it would be read from its file."""
    from mocap_id.store import hdf5, parquet  # noqa: PLC0415  who finds all up to date needs neither

    typed = hdf5.conform(output) if isinstance(output, Tree) else parquet.conform(output)
    facts, reasons = settled(output.facts, output.reasons)
    return _frozen(replace(typed, facts=facts, reasons=reasons))


def _frozen(artefact: Artefact) -> Artefact:
    """An artefact with read-only views of its arrays."""
    match artefact:
        case Table():
            return replace(artefact, columns=_read_only(artefact.columns))
        case LongTable():
            frames, time = _read_only(artefact.frames), _read_only(artefact.time)
            return replace(artefact, frames=frames, time=time, values=_read_only(artefact.values))
        case Tree():
            return replace(artefact, data=_read_only(artefact.data))


def _read_only(data: Any) -> Any:
    """Arrays, and mappings of them, that cannot be written to."""
    if isinstance(data, np.ndarray):
        view = data.view()
        view.flags.writeable = False
        return view
    return {name: _read_only(item) for name, item in data.items()} if isinstance(data, Mapping) else data


def sealed_writer(artefact: Artefact, origin: Origin, seals: dict[str, Seal]) -> Content:
    """What writes an artefact, and notes what it wrote."""
    from mocap_id.store import hdf5, parquet  # noqa: PLC0415

    version, file = artefact.schema.version, artefact.schema.file

    def write(stream: BinaryIO) -> None:
        hashed = HashedStream(stream)
        if isinstance(artefact, Tree):
            hashed.write(hdf5.encode(artefact, origin))
        else:
            parquet.write(artefact, origin, hashed)
        seals[file] = Seal(version, hashed.hash())

    return write


def decoded(stream: BinaryIO, schema: TableSchema | TreeSchema) -> tuple[Artefact, Provenance]:
    """An artefact out of an open file; ValueError where it is damaged."""
    from mocap_id.store import hdf5, parquet  # noqa: PLC0415

    found: tuple[Artefact, Provenance]
    found = hdf5.decode(stream.read(), schema) if isinstance(schema, TreeSchema) else parquet.decode(stream, schema)
    return _frozen(found[0]), found[1]
