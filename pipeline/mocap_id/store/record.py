"""What stands beside a stage's outputs: where they come from, and the hash of each as it was written.

Documents cannot carry their provenance. Artefacts can, and do; of them the record tells that they are still the bytes
that were written, so that nothing has to be decoded to find that there is nothing to compute.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from mocap_id.store.digest import hash_bytes
from mocap_id.store.provenance import Origin, Provenance

UNREADABLE = (AttributeError, KeyError, OSError, RecursionError, TypeError, ValueError)
"""What reading a record raises that is none."""


@dataclass(frozen=True)
class Seal:
    """An artefact as it was written.

    Parameters
    ----------
    schema_version : int
    digest : str
        Hash of the file's bytes.
    content : str
        Content hash, which stands in the file's own provenance too.
    """

    schema_version: int
    digest: str
    content: str


@dataclass(frozen=True)
class Record:
    """A stage's outputs as they were written.

    Parameters
    ----------
    origin : Origin
    documents : mapping of str to str
        Hash of every document, by file name.
    artefacts : mapping of str to Seal
    """

    origin: Origin
    documents: Mapping[str, str] = field(default_factory=dict)
    artefacts: Mapping[str, Seal] = field(default_factory=dict)

    def encode(self) -> bytes:
        """As it stands in the file."""
        content = hash_bytes(json.dumps(self.documents, sort_keys=True).encode())
        strings: dict[str, Any] = dict(Provenance("documents", 1, self.origin, content, {}, ()).encode())
        strings["documents"] = json.dumps(self.documents)
        strings["artefacts"] = {file: asdict(seal) for file, seal in self.artefacts.items()}
        return json.dumps(strings, indent=1).encode()

    @classmethod
    def decode(cls, content: bytes) -> Record:
        """The inverse of :meth:`encode`; one of :data:`UNREADABLE` where it is none."""
        strings = json.loads(content)
        documents: dict[str, str] = dict(json.loads(strings["documents"]))
        artefacts = {str(file): Seal(**seal) for file, seal in strings.get("artefacts", {}).items()}
        return cls(Provenance.decode(strings).origin, documents, artefacts)
