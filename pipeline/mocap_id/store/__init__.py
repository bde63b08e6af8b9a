"""Artefacts in memory and on disk: schemas, views, Parquet and HDF5, provenance, atomic writes."""

from mocap_id.store.artefacts import (
    Artefact,
    ArtefactSet,
    Column,
    Document,
    Facts,
    LongTable,
    Node,
    Table,
    TableSchema,
    Tree,
    TreeSchema,
)
from mocap_id.store.folder import Folder
from mocap_id.store.hashing import hash_bytes, hash_file
from mocap_id.store.provenance import Origin, Provenance, dumps

__all__ = [
    "Artefact",
    "ArtefactSet",
    "Column",
    "Document",
    "Facts",
    "Folder",
    "LongTable",
    "Node",
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
