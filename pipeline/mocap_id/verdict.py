"""What a trial's verdict is made of: reasons, each with a code, a sentence and the numbers behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

Level = Literal["ok", "caution", "refused"]


@dataclass(frozen=True)
class Reason:
    """One thing a reader of the trial must know.

    Parameters
    ----------
    code : str
        Short, stable, kebab-case (``segments-unsure``).
    message : str
        What was found, what was expected, what to do.
    value, limit : float, optional
        The measured number and the limit it was held against.
    level : {"ok", "caution", "refused"}
        ``ok`` is information: it does not colour the verdict.
    """

    code: str
    message: str
    value: float | None = None
    limit: float | None = None
    level: Level = "caution"

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reason:
        return cls(**data)


def overall(reasons: Iterable[Reason]) -> Level:
    """The verdict's level: the gravest of its reasons."""
    order: tuple[Level, ...] = ("ok", "caution", "refused")
    return max((reason.level for reason in reasons), key=order.index, default="ok")
