"""Markers that a configuration names, by their label or by a pattern."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase

from mocap_id.errors import ConfigError


def columns(labels: Sequence[str], patterns: Sequence[str], key: str) -> tuple[int, ...]:
    """Columns of the markers that some names or patterns (``L*WR*``) mean, ascending.

    Raises
    ------
    ConfigError
        A name means no marker; ``key`` says where it stands.
    """
    unmatched = [pattern for pattern in patterns if not any(fnmatchcase(label, pattern) for label in labels)]
    if unmatched:
        near = get_close_matches(unmatched[0], labels, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(labels)}"
        raise ConfigError(f"{key}: no marker is called {', '.join(unmatched)}{hint}")
    return tuple(i for i, label in enumerate(labels) if any(fnmatchcase(label, each) for each in patterns))
