"""Options of `advise`: the objective and the limits of the movement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mocap_id.design.movement_limits import MovementLimits
from mocap_id.design.proposal import OBJECTIVES, Objective
from mocap_id.errors import ConfigError

Support = tuple[float, float] | Literal["bolted"] | None


@dataclass(frozen=True)
class AdviceOptions:
    """The objective and the limits of the movement; a limit that is None is derived from the trial."""

    objective: Objective = "intervals"
    seconds: float | None = None  # length of the recording, s; None for the length of the trial
    # how far every joint may go beyond its observed range, degrees; None for 20 with a robot and 5 with a person
    widen: float | None = None
    # ranges of joints by name, degrees; they replace the observed ranges
    angles: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    speed: float | None = None  # limit of every joint, degrees/s
    acceleration: float | None = None  # limit of every joint, degrees/s²
    # range of the centre of pressure along the plane's x, m; None for 3 cm beyond its observed range, or for no limit
    # in a trial of a robot, which is bolted down
    support: Support = None
    seed: int = 0  # seed of the search

    def __post_init__(self) -> None:
        checks = (
            ("objective", self.objective, self.objective in OBJECTIVES, "one of " + ", ".join(OBJECTIVES)),
            ("seconds", self.seconds, _is_within(self.seconds, 8, 600), "8 … 600 s"),
            ("widen", self.widen, _is_within(self.widen, 0, 180), "0 … 180 degrees"),
            ("speed", self.speed, _is_within(self.speed, 1, 2000), "1 … 2000 degrees/s"),
            ("acceleration", self.acceleration, _is_within(self.acceleration, 1, 1e5), "1 … 100000 degrees/s²"),
            ("seed", self.seed, self.seed >= 0, "a whole number, 0 or more"),
        )
        for name, value, valid, expected in checks:
            if not valid:
                raise ConfigError(f"advise: {name} is {value!r}; expected {expected}")

    def replace_limits(self, limits: MovementLimits, joints: Sequence[str]) -> MovementLimits:
        """Return ``limits`` with the limits that the options contain in place of the observed ones.

        Raises
        ------
        ConfigError
            An option names a joint that is not in ``joints``.
        """
        low, high, one = limits.low.copy(), limits.high.copy(), np.ones(len(joints))
        for name, ends in self.angles.items():
            if name not in joints:
                raise ConfigError(f"advise: there is no joint {name!r}; expected one of {', '.join(joints)}")
            low[joints.index(name)], high[joints.index(name)] = np.radians(ends)
        return MovementLimits(
            low=low,
            high=high,
            speed=limits.speed if self.speed is None else one * np.radians(self.speed),
            acceleration=limits.acceleration if self.acceleration is None else one * np.radians(self.acceleration),
            support=self.support if isinstance(self.support, tuple) else limits.support,
        )


def _is_within(value: float | None, low: float, high: float) -> bool:
    return value is None or low <= value <= high


def parse_angle_range(text: str) -> tuple[str, tuple[float, float]]:
    """Return a joint and its range in degrees from a text such as ``hip=-10:60``.

    Raises
    ------
    ConfigError
        The text does not have this form.
    """
    name, _, rest = text.partition("=")
    expected = "JOINT=LOW:HIGH in degrees, such as hip=-10:60"
    return name.strip(), _parse_range(rest if name else "", f"--angle {text!r}", expected)


def parse_support(text: str) -> Support:
    """Return ``bolted``, or the range of the centre of pressure in m, from a text such as ``-8:3`` in cm.

    Raises
    ------
    ConfigError
        The text does not have this form.
    """
    if text == "bolted":
        return "bolted"
    low, high = _parse_range(
        text, f"--support {text!r}", "LOW:HIGH in cm along the plane's x, such as -12:4, or `bolted`"
    )
    return low / 100, high / 100


def _parse_range(text: str, given: str, expected: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = (math.nan, math.nan)
    if not colon or not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        raise ConfigError(f"advise: {given}; expected {expected}")
    return ends
