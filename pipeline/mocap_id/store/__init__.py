"""Artefacts on disk: schemas, Parquet and HDF5, provenance, atomic writes."""

from mocap_id.store.artefacts import (
    Artefact,
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
from mocap_id.store.digest import hash_bytes, hash_file
from mocap_id.store.folder import Folder
from mocap_id.store.held import Held
from mocap_id.store.provenance import Origin, Provenance, dumps

__all__ = [
    "Artefact",
    "Column",
    "Document",
    "Facts",
    "Folder",
    "Held",
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
