"""What stands beside a stage's outputs: where they come from, and the hash of each file as it was written.

Documents cannot carry their provenance. Artefacts do, but the record alone says that a file still holds the bytes that
were written, so that nothing has to be decoded to find that there is nothing to compute.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from mocap_id.store.provenance import Origin, Provenance

UNREADABLE = (AttributeError, KeyError, OSError, RecursionError, TypeError, ValueError)
"""Exceptions for an invalid record."""


@dataclass(frozen=True)
class Seal:
    """An artefact as it was written: version of its schema, and hash of the file's bytes."""

    schema_version: int
    digest: str


@dataclass(frozen=True)
class Record:
    """A stage's outputs as they were written.

    Parameters
    ----------
    origin : Origin
    documents : mapping of str to str
        Hash of the bytes of every document, by file name.
    artefacts : mapping of str to Seal
    """

    origin: Origin
    documents: Mapping[str, str] = field(default_factory=dict)
    artefacts: Mapping[str, Seal] = field(default_factory=dict)

    def encode(self) -> bytes:
        """The bytes of the record's file."""
        strings: dict[str, Any] = dict(Provenance("record", 2, self.origin, {}, ()).encode())
        seals = {file: asdict(seal) for file, seal in self.artefacts.items()}
        return json.dumps(strings | {"documents": self.documents, "artefacts": seals}, indent=1).encode()

    @classmethod
    def decode(cls, content: bytes) -> Record:
        """The inverse of :meth:`encode`; one of :data:`UNREADABLE` for an invalid record."""
        strings = json.loads(content)
        documents = {str(file): str(digest) for file, digest in strings["documents"].items()}
        artefacts = {str(file): Seal(**seal) for file, seal in strings["artefacts"].items()}
        return cls(Provenance.decode(strings).origin, documents, artefacts)
