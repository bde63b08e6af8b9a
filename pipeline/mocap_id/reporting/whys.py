"""Why a quantity of the summary is null."""

from __future__ import annotations

from collections.abc import Iterable


def because(why: str, *values: object) -> str | None:
    """``why`` where any of the values is unknown."""
    return why if any(value is None for value in values) else None


def joined(sentences: Iterable[str | None]) -> str | None:
    """The sentences as one, none twice; None where there are none."""
    return "; ".join(dict.fromkeys(sentence for sentence in sentences if sentence)) or None
