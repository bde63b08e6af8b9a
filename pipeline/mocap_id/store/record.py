"""Documents of a stage, and the record of its outputs: origin, and hash of each file at the time of writing.

Artefacts store their origin themselves, documents cannot. The record also shows without decoding any file that the
files still hold the bytes that were written, so that a run finds quickly that there is nothing to compute.
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
class Document:
    """A file of a run that is no artefact, such as the report; it is written unchanged."""

    file: str
    content: bytes


@dataclass(frozen=True)
class Checksum:
    """Schema version of an artefact and hash of its file, at the time of writing."""

    schema_version: int
    digest: str


@dataclass(frozen=True)
class Record:
    """The outputs of a stage at the time of writing.

    Parameters
    ----------
    origin : Origin
    documents : mapping of str to str
        Hash of the bytes of every document, by file name.
    artefacts : mapping of str to Checksum
        By file name.
    """

    origin: Origin
    documents: Mapping[str, str] = field(default_factory=dict)
    artefacts: Mapping[str, Checksum] = field(default_factory=dict)

    def encode(self) -> bytes:
        """Return the bytes of the record's file."""
        strings: dict[str, Any] = dict(Provenance("record", 2, self.origin, {}, ()).encode())
        checksums = {file: asdict(checksum) for file, checksum in self.artefacts.items()}
        return json.dumps(strings | {"documents": self.documents, "artefacts": checksums}, indent=1).encode()

    @classmethod
    def decode(cls, content: bytes) -> Record:
        """Read a record from its bytes; raises one of :data:`UNREADABLE` where it is invalid."""
        strings = json.loads(content)
        documents = {str(file): str(digest) for file, digest in strings["documents"].items()}
        artefacts = {str(file): Checksum(**checksum) for file, checksum in strings["artefacts"].items()}
        return cls(Provenance.decode(strings).origin, documents, artefacts)
