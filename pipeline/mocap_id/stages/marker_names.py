"""Selection of markers by labels or patterns of a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase

from mocap_id.errors import ConfigError


def marker_columns(labels: Sequence[str], patterns: Sequence[str], key: str) -> tuple[int, ...]:
    """Return the columns, ascending, of the markers that match some labels or patterns such as ``L*WR*``.

    A text that is the label of a marker selects only that marker, even if it is a pattern: cameras name unlabelled
    markers ``*12``.

    Raises
    ------
    ConfigError
        No marker matches; the message begins with ``key``, the place in the configuration.
    """
    matches = {pattern: _matching(labels, pattern) for pattern in patterns}
    unmatched = [pattern for pattern, found in matches.items() if not found]
    if unmatched:
        near = get_close_matches(unmatched[0], labels, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(labels)}"
        raise ConfigError(f"{key}: no marker is called {', '.join(unmatched)}{hint}")
    return tuple(sorted(set().union(*matches.values())))


def _matching(labels: Sequence[str], pattern: str) -> set[int]:
    return {
        i
        for i, label in enumerate(labels)
        if label == pattern or (pattern not in labels and fnmatchcase(label, pattern))
    }
