"""The form of one finding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Parameters
    ----------
    name : str
    level : {"ok", "warn", "fail"}
        ``warn``: mocap-id works, slower or with less; ``fail``: it does not.
    found : str
        What is there.
    advice : str
        What to do; empty where nothing is.
    """

    name: str
    level: Level
    found: str
    advice: str = ""


def release(version: str) -> tuple[int, ...]:
    """The numbers at the start of a version, to compare with another's.

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
