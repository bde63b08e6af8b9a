"""A quantity of two runs, and its difference."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

_ROUNDING = 1e-12  # SI: smaller differences are rounding errors of coordinates that are zero by definition
Value: TypeAlias = float | int | str | bool | None


@dataclass(frozen=True)
class Difference:
    """A quantity or a choice in two runs.

    Parameters
    ----------
    section, name : str
        Section and name of the quantity.
    a, b : number, text or None
        Value in the first and in the second run; None if missing.
    unit : str
    difference : float or None
        Second minus first; for time series, the rms difference over common times.
    percent : float or None
        The difference relative to the first value.
    in_sd : float or None
        The difference divided by sqrt(sd_a² + sd_b²), which assumes independent errors. Two runs on one recording share
        errors, and the value is then too small.
    """

    section: str
    name: str
    a: Value
    b: Value
    unit: str = ""
    difference: float | None = None
    percent: float | None = None
    in_sd: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the two runs differ."""
        return self.difference != 0.0 if self.difference is not None else self.a != self.b


def quantity(
    section: str,
    name: str,
    a: float | None,
    b: float | None,
    unit: str = "",
    *,
    sds: tuple[float | None, float | None] = (None, None),
) -> Difference:
    """Return the difference of two numbers, given their standard deviations if known."""
    if a is None or b is None:
        return Difference(section, name, a, b, unit)
    difference = b - a if abs(b - a) > _ROUNDING else 0.0
    spread = math.hypot(*(sd for sd in sds if sd is not None)) if None not in sds else 0.0
    return Difference(
        section,
        name,
        a,
        b,
        unit,
        difference=difference,
        percent=100 * difference / abs(a) if a else None,
        in_sd=difference / spread if spread > 0 else None,
    )


def choices(section: str, a: dict[str, Value], b: dict[str, Value]) -> Iterator[Difference]:
    """Yield the differences of settings or names by key: first the keys of ``a``, then those only in ``b``."""
    for key in dict.fromkeys((*a, *b)):
        yield Difference(section, key, a.get(key), b.get(key))


def flat(value: object, prefix: str = "") -> Iterator[tuple[str, Value]]:
    """Yield nested settings as dotted keys with plain values."""
    match value:
        case dict():
            for key, item in value.items():
                yield from flat(item, f"{prefix}.{key}" if prefix else str(key))
        case list() | tuple():
            yield prefix, ", ".join(_plain(item) for item in value)
        case None | bool() | int() | float() | str():
            yield prefix, value
        case _:
            yield prefix, str(value)


def _plain(item: object) -> str:
    return ", ".join(f"{key}: {value}" for key, value in flat(item)) if isinstance(item, dict | list) else str(item)


def changed(rows: Iterable[Difference]) -> tuple[Difference, ...]:
    """Return the rows that differ."""
    return tuple(row for row in rows if row.differs)
