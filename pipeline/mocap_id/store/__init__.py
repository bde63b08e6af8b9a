"""Artefacts in memory and on disk: schemas, views, Parquet and HDF5, provenance, atomic writing.

The classes of artefacts need numpy and are imported when they are first used. A run with nothing to do does not use
them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mocap_id.store.atomic import hash_bytes, hash_file
from mocap_id.store.folder import ArtefactSet, Folder
from mocap_id.store.provenance import Column, Document, Origin, Provenance, TableSchema, TreeSchema, dumps

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Artefact, Facts, LongTable, Table, Tree

__all__ = [
    "Artefact",
    "ArtefactSet",
    "Column",
    "Document",
    "Facts",
    "Folder",
    "LongTable",
    "Origin",
    "Provenance",
    "Table",
    "TableSchema",
    "Tree",
    "TreeSchema",
    "dumps",
    "hash_bytes",
    "hash_file",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.artefacts"), name)
    globals()[name] = value
    return value
