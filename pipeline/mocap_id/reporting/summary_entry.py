"""Base class of the objects in ``summary.json``, and helpers for their key ``why``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class Entry(BaseModel):
    """Object of ``summary.json``: immutable and strictly typed, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def explain(cls, why: str, **values: Any) -> Self:
        """Return an entry with these values, and with ``why`` if one of them is None; its ``why`` is None otherwise."""
        return cls(**values | {"why": why_unknown(why, *values.values())})


NOT_FINITE = "the joint fit gave no finite value"
"""Explanation (``why``) of an unknown quantity of the joint fit."""


def why_unknown(why: str, *values: object) -> str | None:
    """Return ``why`` if any of the values is None; else return None."""
    return why if any(value is None for value in values) else None


def join_sentences(sentences: Iterable[str | None]) -> str | None:
    """Return sentences joined by semicolons, without a sentence that is part of another one; None without sentences."""
    distinct = dict.fromkeys(sentence for sentence in sentences if sentence)
    whole = (one for one in distinct if not any(one != other and one in other for other in distinct))
    return "; ".join(whole) or None
