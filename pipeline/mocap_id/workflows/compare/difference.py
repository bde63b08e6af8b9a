"""The values of a quantity in two runs, and their difference."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

_ROUNDING = 1e-12  # SI: smaller differences are rounding errors of coordinates that are zero by definition
Value: TypeAlias = float | int | str | bool | None


@dataclass(frozen=True)
class Difference:
    """The values of a quantity or of a setting in two runs, and their difference."""

    section: str
    name: str
    a: Value  # value in the first run; None if missing
    b: Value  # value in the second run; None if missing
    unit: str = ""
    difference: float | None = None  # second minus first; for time series, the rms difference over common times
    percent: float | None = None  # the difference relative to the first value, %
    # The difference divided by sqrt(sd_a² + sd_b²), which assumes independent errors. Two runs on one recording share
    # errors, and the value is then too small.
    in_sd: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the two runs differ."""
        return self.difference != 0.0 if self.difference is not None else self.a != self.b


def compare_numbers(
    section: str,
    name: str,
    a: float | None,
    b: float | None,
    unit: str = "",
    *,
    sds: tuple[float | None, float | None] = (None, None),
) -> Difference:
    """Return the difference of two numbers; ``sds`` are their standard deviations, None if unknown."""
    if a is None or b is None:
        return Difference(section, name, a, b, unit)
    difference = b - a if abs(b - a) > _ROUNDING else 0.0
    spread = math.hypot(*(sd for sd in sds if sd is not None)) if None not in sds else 0.0
    percent = 100 * difference / abs(a) if a else None
    return Difference(section, name, a, b, unit, difference, percent, difference / spread if spread > 0 else None)


def compare_entries(section: str, a: dict[str, Value], b: dict[str, Value]) -> Iterator[Difference]:
    """Yield a difference for each key of two mappings: first the keys of ``a``, then the keys that only ``b`` has."""
    for key in dict.fromkeys((*a, *b)):
        yield Difference(section, key, a.get(key), b.get(key))


def flatten(value: object, prefix: str = "") -> Iterator[tuple[str, Value]]:
    """Yield each of the nested settings as a dotted key and a plain value; a list becomes one text."""
    match value:
        case dict():
            for key, item in value.items():
                yield from flatten(item, f"{prefix}.{key}" if prefix else str(key))
        case list() | tuple():
            yield prefix, ", ".join(_format(item) for item in value)
        case None | bool() | int() | float() | str():
            yield prefix, value
        case _:
            yield prefix, str(value)


def _format(item: object) -> str:
    return ", ".join(f"{key}: {value}" for key, value in flatten(item)) if isinstance(item, dict | list) else str(item)
