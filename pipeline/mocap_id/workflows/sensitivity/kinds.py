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
    """One kind of perturbation.

    Parameters
    ----------
    name : str
        Name in the settings file and the tables.
    title : str
        Name in texts.
    entry : str
        The first stage that uses the perturbed quantity; it and all later stages are run again.
    unit : str
        Unit of the levels; empty for counts.
    levels : tuple of float
        PerturbationRun where nothing else is asked for.
    allowed : callable
        Returns whether a level is valid.
    expected : str
        Description of a valid level.
    targets : tuple of str
        What it can act on; :data:`JOINTS` stands for each of the trial's joints and all of them. Empty: everything.
    usual : tuple of str
        Default targets; all if empty.
    free : bool
        Targets are any numbers; ``targets`` are the defaults.
    worse : {"more", "less", "either"}
        Direction in which the levels get worse.
    random : bool
        The perturbation is drawn at random, from the seed.
    needs_plate : bool
        The perturbation changes the measured wrench.
    """

    name: str
    title: str
    entry: Entry
    unit: str
    levels: tuple[float, ...]
    allowed: Callable[[float], bool]
    expected: str
    targets: tuple[str, ...] = ()
    usual: tuple[str, ...] = ()
    free: bool = False
    worse: Worse = "more"
    random: bool = False
    needs_plate: bool = False

    @property
    def counted(self) -> bool:
        """Whether the levels are counts."""
        return not self.unit


JOINTS = ("joints",)


def _not_negative(level: float) -> bool:
    return level >= 0


def _whole(least: int) -> Callable[[float], bool]:
    return lambda level: level >= least and level == int(level)


def _both_ways(*levels: float) -> tuple[float, ...]:
    return tuple(sign * level for level in levels for sign in (1, -1))


_CLOCK = (lambda level: abs(level) <= 1, "a time up to ± 1 s")
_SIZE = (_not_negative, "0 or more")

KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            "filter-noise",
            "the filter's noise",
            "ukf-smooth",
            "rad/s^4",
            (1e1, 1e2, 1e3, 1e4),
            lambda level: level > 0,
            "a standard deviation of the snap above 0, rad/s^4",
            targets=_THESIS_SD,
            free=True,
            worse="either",
        ),
        Kind(
            "angle-bias",
            "angle bias",
            "identify-dim",
            "rad",
            (0.01, 0.03, 0.1),
            lambda level: abs(level) <= math.pi,
            "an angle up to ± pi, rad",
            targets=JOINTS,
        ),
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
            needs_plate=True,
        ),
        Kind(
            "clock-offset-ignored",
            "clock offset, not estimated",
            "identify-dim",
            "s",
            _both_ways(0.001, 0.003, 0.01, 0.03, 0.1),
            *_CLOCK,
            needs_plate=True,
        ),
        Kind(
            "wrench-bias",
            "wrench bias",
            "identify-dim",
            "N or N*m",
            (0.1, 1.0, 10.0),
            math.isfinite,
            "a number",
            targets=COMPONENTS,
            needs_plate=True,
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
            needs_plate=True,
        ),
        Kind("camera-noise", "camera noise", "fit-joints", "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
        Kind(
            "marker-count",
            "markers a segment",
            "fit-joints",
            "",
            (4, 3, 2),
            _whole(2),
            "a whole number of markers, 2 or more",
            worse="less",
            random=True,
        ),
        Kind(
            "drop-outs",
            "drop-outs",
            "fit-joints",
            "of samples",
            (0.05, 0.2, 0.5),
            lambda level: 0 <= level < 1,
            "a share from 0 to below 1",
            random=True,
        ),
        Kind("soft-tissue", "soft tissue", "fit-joints", "m", (0.001, 0.003, 0.01), *_SIZE, random=True),
        Kind(
            "frame-rate",
            "frame rate",
            "fit-joints",
            "",
            (2, 4, 8),
            _whole(1),
            "a whole number by which the frame rate is divided, 1 or more",
        ),
    )
}
"""Every kind, in the order of the tables."""
