"""Reasons of a trial's verdict: each has a code, a message and the measured numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

Level = Literal["ok", "caution", "refused"]


@dataclass(frozen=True)
class Reason:
    """A finding about a trial that the user should know.

    ``code`` is a short permanent name, such as ``segments-unsure``. ``message`` says what was found, what was expected
    and what to do. ``value`` and ``limit`` are the measured number and its limit. A reason of the level ``ok`` is
    information only and does not change the verdict.
    """

    code: str
    message: str
    value: float | None = None
    limit: float | None = None
    level: Level = "caution"

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Reason:
        """Return the reason with the fields in ``data``, as from :meth:`as_dict`."""
        return cls(**data)


def overall(reasons: Iterable[Reason]) -> Level:
    """Return the level of the verdict: the most severe level of its reasons, or ``ok`` if there are none."""
    order: tuple[Level, ...] = ("ok", "caution", "refused")
    return max((reason.level for reason in reasons), key=order.index, default="ok")
