"""Results of a trial: every quantity is declared once, with its name, words and unit.

A subclass of :class:`Result` is what a computation returns, a fact of an artefact, and an object in ``summary.json``
at the same time. :class:`Quantity` adds to a field how the report and the tables of a study show it. To add a number,
declare its field and compute its value; summary, report and study follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, model_validator


class Result(BaseModel):
    """Numbers that belong together: immutable and strictly typed, without unknown keys; NaN and infinity become None.

    If a quantity is None, ``why`` says why, in results that have this field.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _replace_unknown(cls, values: Any) -> Any:
        return _remove_nan(values) if isinstance(values, dict) else values

    @classmethod
    def explain(cls, why: str, facts: Mapping[str, Any] | None = None, /, **values: Any) -> Self:
        """Return a result with these values, and with ``why`` if one of them is None; its ``why`` is None otherwise.

        With the ``facts`` of an artefact, they give the fields without a value; a field that they lack is None.
        """
        if facts is not None:
            values = {name: facts.get(name) for name in cls.model_fields if name != "why"} | values
        values = _remove_nan(values)
        return cls(**values | {"why": why_unknown(why, *values.values())})

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """Return the result with the facts of an artefact; facts that are no fields are left out."""
        return cls(**{key: value for key, value in facts.items() if key in cls.model_fields})


@dataclass(frozen=True)
class Quantity:
    """How report and study show a field of a result, which is ``Annotated[float | None, Quantity(...)]``."""

    label: str  # heading in the report
    unit: str = ""  # of the number that is shown, as in mm and % for a field in m and a fraction; empty for a count
    sd: str = ""  # name of the field with the standard deviation
    column: str = ""  # of a study's table of trials; empty if it has none. `<column>_sd` has the standard deviation
    meaning: str = ""  # meaning of this column
    decimals: int | None = None  # in a table of the report; by default 1 for mm, ms and %, else significant digits
    column_sd: bool = True  # whether the table also has the standard deviation, if there is one
    digits: int = 3  # significant digits of a number without decimals

    @property
    def head(self) -> str:
        """Label and unit, the heading of a column or row."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


def list_quantities(kind: type[Result]) -> Iterator[tuple[str, Quantity]]:
    """Yield name and description of every described field of a result, in the order of their declaration."""
    for name, field in kind.model_fields.items():
        for described in field.metadata:
            if isinstance(described, Quantity):
                yield name, described


def _remove_nan(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in values.items()}


def why_unknown(why: str, *values: object) -> str | None:
    """Return ``why`` if any of the values is None; else return None."""
    return why if any(value is None for value in values) else None


def join_sentences(sentences: Iterable[str | None]) -> str | None:
    """Return sentences joined by semicolons, without a sentence that is part of another one; None without sentences."""
    distinct = dict.fromkeys(sentence for sentence in sentences if sentence)
    whole = (one for one in distinct if not any(one != other and one in other for other in distinct))
    return "; ".join(whole) or None
