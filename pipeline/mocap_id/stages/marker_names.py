"""Markers that a configuration names, by their label or by a pattern."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase

from mocap_id.errors import ConfigError


def columns(labels: Sequence[str], patterns: Sequence[str], key: str) -> tuple[int, ...]:
    """Columns of the markers that some names or patterns (``L*WR*``) mean, ascending.

    What is a marker's name means that marker, also where it could be a pattern: ``*12`` is what cameras call a marker
    that nobody has labelled.

    Raises
    ------
    ConfigError
        A name means no marker; ``key`` says where it stands.
    """
    meant = {pattern: _meant(labels, pattern) for pattern in patterns}
    unmatched = [pattern for pattern, found in meant.items() if not found]
    if unmatched:
        near = get_close_matches(unmatched[0], labels, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(labels)}"
        raise ConfigError(f"{key}: no marker is called {', '.join(unmatched)}{hint}")
    return tuple(sorted(set().union(*meant.values())))


def _meant(labels: Sequence[str], pattern: str) -> set[int]:
    return {
        i
        for i, label in enumerate(labels)
        if label == pattern or (pattern not in labels and fnmatchcase(label, pattern))
    }
