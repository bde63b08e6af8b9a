"""Selection of markers by the labels or patterns in a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase

from mocap_id.errors import ConfigError


def find_markers(labels: Sequence[str], patterns: Sequence[str], key: str) -> tuple[int, ...]:
    """Return the indices, in ascending order, of the markers that match labels or patterns such as ``L*WR*``.

    A pattern that is also the label of a marker selects only this marker, because camera software gives unlabelled
    markers names such as ``*12``. If no marker matches a pattern, the message of the ConfigError begins with ``key``,
    the key in the configuration.
    """
    matches = {
        pattern: {
            i
            for i, label in enumerate(labels)
            if (label == pattern if pattern in labels else fnmatchcase(label, pattern))
        }
        for pattern in patterns
    }
    unmatched = [pattern for pattern, indices in matches.items() if not indices]
    if unmatched:
        near = get_close_matches(unmatched[0], labels, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; the markers are {', '.join(labels)}"
        raise ConfigError(f"{key}: no marker is called {', '.join(unmatched)}{hint}")
    return tuple(sorted(set().union(*matches.values())))
