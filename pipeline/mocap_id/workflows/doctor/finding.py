"""The result of one check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Parameters
    ----------
    name : str
    level : {"ok", "warn", "fail"}
        ``warn``: mocap-id works, but more slowly or with fewer functions; ``fail``: it does not work.
    found : str
        What was found.
    advice : str
        What to do; empty if nothing.
    """

    name: str
    level: Level
    found: str
    advice: str = ""


def release(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, for comparison.

    Examples
    --------
    >>> release("1.10.2rc1") >= release("1.9")
    True
    """
    numbers = []
    for part in version.split("."):
        digits = part[: len(part) - len(part.lstrip("0123456789"))]
        if not digits:
            break
        numbers.append(int(digits))
    return tuple(numbers)
