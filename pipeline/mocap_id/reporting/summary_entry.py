"""Base class of the objects in ``summary.json``, and helpers for their key ``why``."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict


class Entry(BaseModel):
    """Object of ``summary.json``: frozen and strict, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


def why_unknown(why: str, *values: object) -> str | None:
    """Return ``why`` if any of the values is None, else None."""
    return why if any(value is None for value in values) else None


def join_sentences(sentences: Iterable[str | None]) -> str | None:
    """Join sentences with semicolons and drop a sentence that is part of another one; None without sentences."""
    found = dict.fromkeys(sentence for sentence in sentences if sentence)
    whole = (one for one in found if not any(one != other and one in other for other in found))
    return "; ".join(whole) or None
