"""Reachable volume of a recorded arm with its interval: box of independent limits, and visited region (7.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.protocols.reach.arm_geometry import ANGLES, RecordedArm, UnknownReach
from mocap_id.protocols.reach.ranges import AngleRange
from mocap_id.protocols.reach.reachable_set import Grid, PlaneRange, ReachArm, reachable_set
from mocap_id.protocols.reach.visited_region import VisitedRegion

_BOX, _REGION = Grid(12, 24, 16), Grid(8, 16, 32)
"""First grids of the box and of a region, which needs more axial rotations."""
_CHANGES = Grid(9, 18, 12)
"""Grid of the changes by one standard deviation, which it gives within a few per cent."""
_ENOUGH = 0.01, 0.02
"""The grid of the box (a region) is refined until the volume changes by less than this share."""
_MOST = 4  # grids


@dataclass(frozen=True)
class Volume:
    """A volume, m³, its change with the last refinement of the grid, its 95 % interval, and the grids' volumes."""

    volume: float
    discretisation: float
    interval: tuple[float, float]
    convergence: tuple[float, ...]


@dataclass(frozen=True)
class Workspace:
    """Reachable volume within the box of the ranges, and within the visited region.

    Parameters
    ----------
    box : Volume
    visited : Volume or None
        None if the motion leaves no region of joint space with a volume.
    limits : (4, 2) array
        The box: plane, elevation, axial rotation, flexion, rad.
    sd : float
        Standard deviation of the box's volume, m³.
    sources : dict
        Share of each range and dimension in the variance of the volume.
    """

    box: Volume
    visited: Volume | None
    limits: FloatArray
    sd: float
    sources: dict[str, float]

    def relative(self, arm: ReachArm) -> float:
        """Return the box's volume as a share of the sphere about the shoulder with the arm's length."""
        return self.box.volume / (4 / 3 * np.pi * arm.length**3)


def workspace(arm: RecordedArm, ranges: Mapping[str, AngleRange], region: VisitedRegion | None) -> Workspace:
    """Return the reachable volume of an arm.

    The interval contains the errors of the ends of the ranges, constant errors of the angles from the landmarks, errors
    of the lengths and of the shoulder's rise, each with its own standard deviation, and the discretisation. A constant
    error of the plane only turns the set.

    Parameters
    ----------
    arm : RecordedArm
    ranges : mapping
        Range of the four angles of :data:`~.arm_geometry.ANGLES`.
    region : VisitedRegion or None

    Raises
    ------
    UnknownReach
        The ranges are too small for a volume.
    """
    limits = np.array([(ranges[name].low, ranges[name].high) for name in ANGLES])
    volumes = _converged(arm.arm, limits)
    if not volumes[-1]:
        raise UnknownReach("the ranges of the angles are too small for a volume: record larger reaches")
    effects = _effects(arm, ranges, limits)
    total = float(np.sqrt(sum(effect**2 for effect in effects.values())))
    visited = None
    if region is not None:
        found = _converged(arm.arm, region.limits, region.planes)
        visited = _with_interval(found, found[-1] * total / volumes[-1])
    return Workspace(
        box=_with_interval(volumes, total),
        visited=visited,
        limits=limits,
        sd=total,
        sources={name: (effect / total) ** 2 if total else 0.0 for name, effect in effects.items()},
    )


def _with_interval(volumes: tuple[float, ...], sd: float) -> Volume:
    volume, change = volumes[-1], abs(volumes[-1] - volumes[-2])
    reach = NORMAL_95 * sd + change
    return Volume(volume, change, (max(volume - reach, 0.0), volume + reach), volumes)


def _volume(arm: ReachArm, limits: FloatArray, grid: Grid, planes: PlaneRange | None = None) -> float:
    return reachable_set(arm, limits, grid, planes).volume


def _converged(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> tuple[float, ...]:
    """Return the volumes on finer and finer grids, at least two."""
    grid, enough = (_BOX, _ENOUGH[0]) if planes is None else (_REGION, _ENOUGH[1])
    found = [_volume(arm, limits, grid, planes)]
    while len(found) < _MOST:
        grid = grid.refined()
        found.append(_volume(arm, limits, grid, planes))
        if abs(found[-1] - found[-2]) <= enough * found[-1]:
            break
    return tuple(found)


def _effects(arm: RecordedArm, ranges: Mapping[str, AngleRange], limits: FloatArray) -> dict[str, float]:
    """Return the change of the volume by one standard deviation of each input, m³."""
    own = arm.arm

    def half(up: ReachArm, down: ReachArm, step: FloatArray) -> float:
        return 0.5 * (_volume(up, limits + step, _CHANGES) - _volume(down, limits - step, _CHANGES))

    found = {}
    for k, name in enumerate(ANGLES):
        one = ranges[name]
        for side, sd in (("low", one.low_sd), ("high", one.high_sd), ("both", one.constant_sd)):
            if (name, side) == ("shoulder_plane", "both"):
                continue
            step = np.zeros((4, 2))
            step[k, {"low": slice(0, 1), "high": slice(1, 2), "both": slice(0, 2)}[side]] = sd
            found[f"{name}_{side}"] = half(own, own, _inside(step, limits))
    longer = own.elbow * (1 + arm.upper_arm_sd / float(np.linalg.norm(own.elbow)))
    pairs = {
        "upper_arm": (replace(own, elbow=longer), replace(own, elbow=2 * own.elbow - longer)),
        "forearm": tuple(replace(own, forearm=own.forearm + s * arm.forearm_sd) for s in (1, -1)),
        "rise": tuple(replace(own, rise=own.rise + s * arm.rise_sd) for s in (1, -1)),
    }
    return found | {name: half(up, down, np.zeros((4, 2))) for name, (up, down) in pairs.items()}


def _inside(step: FloatArray, limits: FloatArray) -> FloatArray:
    """Return a step that keeps the elevation between 0 and 180° and no range negative."""
    step = step.copy()
    step[1] = np.minimum(step[1], [max(limits[1, 0], 0.0), max(np.pi - limits[1, 1], 0.0)])
    return np.minimum(step, 0.5 * (limits[:, 1:] - limits[:, :1]))
