"""The reasons of a trial's verdict: each has a code, a message and the measured numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

Level = Literal["ok", "caution", "refused"]


@dataclass(frozen=True)
class Reason:
    """One finding that the reader of a trial must know.

    Parameters
    ----------
    code : str
        Short, stable, kebab-case (``segments-unsure``).
    message : str
        What was found, what was expected, what to do.
    value, limit : float, optional
        The measured number and its limit.
    level : {"ok", "caution", "refused"}
        ``ok`` is information only and does not change the verdict.
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
    """Return the level of the verdict: the most severe level of its reasons."""
    order: tuple[Level, ...] = ("ok", "caution", "refused")
    return max((reason.level for reason in reasons), key=order.index, default="ok")
