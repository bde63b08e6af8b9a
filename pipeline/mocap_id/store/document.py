"""Files of a run that are no artefacts, such as the report."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Document:
    """A file for people or other programs, written unchanged."""

    file: str
    content: bytes
