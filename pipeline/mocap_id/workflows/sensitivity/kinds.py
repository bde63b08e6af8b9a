"""The kinds of perturbation: those of thesis 5.5.2, and others that occur in a laboratory."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

Entry: TypeAlias = Literal["fit-joints", "ukf-smooth", "identify-dim"]
Worse: TypeAlias = Literal["more", "less", "either"]

COMPONENTS = ("Fx", "Fy", "tauz")
ALL = "all"
"""Every joint at once."""
_THESIS_SD = ("0.0001", "0.001", "0.1")


@dataclass(frozen=True)
class Kind:
    """One kind of perturbation."""

    name: str  # name in the settings file and the tables
    title: str  # name in texts
    entry: Entry  # the first stage that uses the perturbed quantity; it and all later stages are run again
    unit: str  # unit of the levels; empty for counts
    levels: tuple[float, ...]  # default levels
    allowed: Callable[[float], bool]  # returns whether a level is valid
    expected: str  # description of a valid level
    # what it can act on; :data:`JOINTS` stands for each of the trial's joints and all of them. Empty: everything
    targets: tuple[str, ...] = ()
    usual: tuple[str, ...] = ()  # default targets; all if empty
    free: bool = False  # targets are any numbers; ``targets`` are the defaults
    worse: Worse = "more"  # direction in which the levels get worse
    random: bool = False  # the perturbation is drawn at random, from the seed
    needs_imus: bool = False  # the perturbation changes the logs of inertial sensors

    @property
    def changes_lengths(self) -> bool:
        """Whether it can change lengths of segments, and not only states and dynamics."""
        return self.entry == "fit-joints"

    @property
    def counted(self) -> bool:
        """Whether the levels are counts."""
        return not self.unit


JOINTS = ("joints",)


def _whole(least: int) -> Callable[[float], bool]:
    return lambda level: level >= least and level == int(level)


def _both_ways(*levels: float) -> tuple[float, ...]:
    return tuple(sign * level for level in levels for sign in (1, -1))


_ANGLE = (lambda level: abs(level) <= math.pi, "an angle up to ± pi, rad")
_CLOCK = (lambda level: abs(level) <= 1, "a time up to ± 1 s")
_DIVISOR = (_whole(1), "a whole number by which the frame rate is divided, 1 or more")
_MARKERS = (_whole(2), "a whole number of markers, 2 or more")
_NUMBER = (math.isfinite, "a number")
_SHARE = (lambda level: 0 <= level < 1, "a share from 0 to below 1")
_SIZE = (lambda level: level >= 0, "0 or more")
_SNAP = (lambda level: level > 0, "a standard deviation of the snap above 0, rad/s^4")

KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            "filter-noise",
            "the filter's noise",
            "ukf-smooth",
            "rad/s^4",
            (1e1, 1e2, 1e3, 1e4),
            *_SNAP,
            targets=_THESIS_SD,
            free=True,
            worse="either",
        ),
        Kind("angle-bias", "angle bias", "identify-dim", "rad", (0.01, 0.03, 0.1), *_ANGLE, targets=JOINTS),
        Kind(
            "angle-noise",
            "angle noise",
            "ukf-smooth",
            "rad",
            (0.001, 0.003, 0.01),
            *_SIZE,
            targets=JOINTS,
            usual=(ALL,),
            random=True,
        ),
        Kind(
            "clock-offset",
            "clock offset, estimated",
            "identify-dim",
            "s",
            _both_ways(0.001, 0.01, 0.1),
            *_CLOCK,
        ),
        Kind(
            "clock-offset-ignored",
            "clock offset, not estimated",
            "identify-dim",
            "s",
            _both_ways(0.001, 0.003, 0.01, 0.03, 0.1),
            *_CLOCK,
        ),
        Kind(
            "wrench-bias",
            "wrench bias",
            "identify-dim",
            "N or N*m",
            (0.1, 1.0, 10.0),
            *_NUMBER,
            targets=COMPONENTS,
        ),
        Kind(
            "wrench-noise",
            "wrench noise",
            "identify-dim",
            "N or N*m",
            (0.01, 0.1, 1.0),
            *_SIZE,
            targets=COMPONENTS,
            random=True,
        ),
        Kind(
            "board-steps",
            "steps of a balance board's cells",
            "identify-dim",
            "kg",
            (0.1, 0.5, 2.0),
            *_SIZE,
            random=True,
        ),
        Kind(
            "stamp-jitter",
            "jitter of the force's time stamps",
            "identify-dim",
            "s",
            (0.003, 0.01, 0.03),
            *_SIZE,
            random=True,
        ),
        Kind("camera-noise", "camera noise", "fit-joints", "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
        Kind("marker-count", "markers a segment", "fit-joints", "", (4, 3, 2), *_MARKERS, worse="less", random=True),
        Kind("drop-outs", "drop-outs", "fit-joints", "of samples", (0.05, 0.2, 0.5), *_SHARE, random=True),
        Kind("soft-tissue", "soft tissue", "fit-joints", "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
        Kind("frame-rate", "frame rate", "fit-joints", "", (2, 4, 8), *_DIVISOR),
        Kind(
            "imu-clock",
            "wander of the inertial sensors' clocks",
            "ukf-smooth",
            "s",
            (0.002, 0.01, 0.05),
            *_SIZE,
            random=True,
            needs_imus=True,
        ),
        Kind(
            "imu-bias",
            "drift of the gyroscopes' biases",
            "ukf-smooth",
            "rad/s",
            (0.003, 0.01, 0.03),
            *_SIZE,
            random=True,
            needs_imus=True,
        ),
        Kind(
            "imu-mounting",
            "turn of the inertial sensors on the skin",
            "ukf-smooth",
            "rad",
            (0.03, 0.1, 0.3),
            *_ANGLE,
            random=True,
            needs_imus=True,
        ),
    )
}
"""Every kind, in the order of the tables."""
