"""What one format makes of a run: files in memory, and what to know about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Parts:
    """Files by name, and sentences on what they lack or rest on."""

    files: Mapping[str, bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __add__(self, other: Parts) -> Parts:
        return Parts({**self.files, **other.files}, tuple(dict.fromkeys((*self.notes, *other.notes))))
