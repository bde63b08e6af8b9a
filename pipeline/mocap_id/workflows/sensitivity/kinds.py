"""The kinds of perturbation: those of thesis 5.5.2, and further errors that occur in a laboratory."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

Entry: TypeAlias = Literal["fit-joints", "ukf-smooth", "identify-dim"]
Worse: TypeAlias = Literal["more", "less", "either"]

COMPONENTS = ("Fx", "Fy", "tauz")
JOINTS = ("joints",)
"""Value of :attr:`Kind.targets` for a kind that acts on each joint of the trial, or on all joints."""
ALL = "all"
"""Target for all joints at once."""
_THESIS_SD = ("0.0001", "0.001", "0.1")


@dataclass(frozen=True)
class Kind:
    """One kind of perturbation."""

    name: str  # name in the settings file and the tables
    title: str  # name in texts
    entry: Entry  # first stage that uses the perturbed quantity; this stage and all later stages are run again
    unit: str  # unit of the levels; empty for counts
    levels: tuple[float, ...]  # default levels
    allowed: Callable[[float], bool]  # returns whether a level is valid
    expected: str  # description of a valid level
    targets: tuple[str, ...] = ()  # possible targets, or :data:`JOINTS`; empty if the kind acts on everything
    usual: tuple[str, ...] = ()  # default targets; empty if all targets are the default
    free: bool = False  # whether a target may be any number; ``targets`` are then the defaults
    worse: Worse = "more"  # direction in which the levels get worse
    random: bool = False  # whether the perturbation is drawn at random, from the seed
    needs_imus: bool = False  # whether the perturbation changes the logs of inertial sensors

    @property
    def changes_lengths(self) -> bool:
        """Whether the perturbation can change lengths of segments, and not only states and dynamics."""
        return self.entry == "fit-joints"

    @property
    def is_count(self) -> bool:
        """Whether the levels are counts."""
        return not self.unit


def _at_least(least: int) -> Callable[[float], bool]:
    return lambda level: level >= least and level == int(level)


def _both_signs(*levels: float) -> tuple[float, ...]:
    return tuple(sign * level for level in levels for sign in (1, -1))


_ANGLE = (lambda level: abs(level) <= math.pi, "an angle up to ± pi, rad")
_CLOCK = (lambda level: abs(level) <= 1, "a time up to ± 1 s")
_DIVISOR = (_at_least(1), "a whole number by which the frame rate is divided, 1 or more")
_MARKERS = (_at_least(2), "a whole number of markers, 2 or more")
_NUMBER = (math.isfinite, "a number")
_SHARE = (lambda level: 0 <= level < 1, "a fraction of at least 0 and below 1")
_SIZE = (lambda level: level >= 0, "0 or more")
_SNAP = (lambda level: level > 0, "a standard deviation of the snap above 0, rad/s^4")
_IGNORED = _both_signs(0.001, 0.003, 0.01, 0.03, 0.1)
_FIT: Entry = "fit-joints"
_UKF: Entry = "ukf-smooth"
_DYN: Entry = "identify-dim"
# fmt: off
_KINDS = (
    Kind("filter-noise", "the filter's noise", _UKF, "rad/s^4", (1e1, 1e2, 1e3, 1e4), *_SNAP,
         targets=_THESIS_SD, free=True, worse="either"),
    Kind("angle-bias", "angle bias", _DYN, "rad", (0.01, 0.03, 0.1), *_ANGLE, targets=JOINTS),
    Kind("angle-noise", "angle noise", _UKF, "rad", (0.001, 0.003, 0.01), *_SIZE,
         targets=JOINTS, usual=(ALL,), random=True),
    Kind("clock-offset", "clock offset, estimated", _DYN, "s", _both_signs(0.001, 0.01, 0.1), *_CLOCK),
    Kind("clock-offset-ignored", "clock offset, not estimated", _DYN, "s", _IGNORED, *_CLOCK),
    Kind("wrench-bias", "wrench bias", _DYN, "N or N*m", (0.1, 1.0, 10.0), *_NUMBER, targets=COMPONENTS),
    Kind("wrench-noise", "wrench noise", _DYN, "N or N*m", (0.01, 0.1, 1.0), *_SIZE,
         targets=COMPONENTS, random=True),
    Kind("board-steps", "steps of a balance board's cells", _DYN, "kg", (0.1, 0.5, 2.0), *_SIZE, random=True),
    Kind("stamp-jitter", "jitter of the force's time stamps", _DYN, "s", (0.003, 0.01, 0.03), *_SIZE, random=True),
    Kind("camera-noise", "camera noise", _FIT, "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
    Kind("marker-count", "markers per segment", _FIT, "", (4, 3, 2), *_MARKERS, worse="less", random=True),
    Kind("drop-outs", "drop-outs", _FIT, "of samples", (0.05, 0.2, 0.5), *_SHARE, random=True),
    Kind("soft-tissue", "soft tissue", _FIT, "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
    Kind("frame-rate", "frame rate", _FIT, "", (2, 4, 8), *_DIVISOR),
    Kind("imu-clock", "wander of the inertial sensors' clocks", _UKF, "s", (0.002, 0.01, 0.05), *_SIZE,
         random=True, needs_imus=True),
    Kind("imu-bias", "drift of the gyroscopes' biases", _UKF, "rad/s", (0.003, 0.01, 0.03), *_SIZE,
         random=True, needs_imus=True),
    Kind("imu-mounting", "rotation of the inertial sensors on the skin", _UKF, "rad", (0.03, 0.1, 0.3), *_ANGLE,
         random=True, needs_imus=True),
)
# fmt: on
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _KINDS}
"""Each kind by name, in the order of the tables."""
