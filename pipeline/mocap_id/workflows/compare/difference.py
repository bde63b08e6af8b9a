"""One thing that two runs say, and how it differs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

_ROUNDING = 1e-12  # SI: coordinates that a segment's frame makes zero
Value: TypeAlias = float | int | str | bool | None


@dataclass(frozen=True)
class Difference:
    """A quantity or a choice in both runs.

    Parameters
    ----------
    section, name : str
        What it is.
    a, b : number, text or None
        In the first and the second run; None where it has none.
    unit : str
    difference : float or None
        Second less first; of series the rms of that over common times.
    percent : float or None
        The difference, of the first's size.
    in_sd : float or None
        The difference over sqrt(sd_a² + sd_b²), as if the two runs' errors were independent; those of one recording
        are not, and then it is too small.
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
        """Whether the runs differ in this."""
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
    """Two numbers, with the standard deviations of both where they have some."""
    if a is None or b is None:
        return Difference(section, name, a, b, unit)
    apart = b - a if abs(b - a) > _ROUNDING else 0.0
    spread = math.hypot(*(sd for sd in sds if sd is not None)) if None not in sds else 0.0
    return Difference(
        section,
        name,
        a,
        b,
        unit,
        difference=apart,
        percent=100 * apart / abs(a) if a else None,
        in_sd=apart / spread if spread > 0 else None,
    )


def choices(section: str, a: dict[str, Value], b: dict[str, Value]) -> Iterator[Difference]:
    """Settings, names and the like, by their keys: those of the first, then what the second has beside."""
    for key in dict.fromkeys((*a, *b)):
        yield Difference(section, key, a.get(key), b.get(key))


def flat(value: object, prefix: str = "") -> Iterator[tuple[str, Value]]:
    """Nested settings as dotted keys with plain values."""
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
    """Those that differ."""
    return tuple(row for row in rows if row.differs)
