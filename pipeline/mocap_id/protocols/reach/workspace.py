"""Reachable volume of a recorded arm with its 95 % interval (7.2), within two kinds of joint limits.

The first kind is the box of the ranges of the four angles. The second is the visited region, in which the limits of an
angle depend on the other angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.protocols.reach.arm_geometry import ANGLES, RecordedArm, UnknownReach
from mocap_id.protocols.reach.ranges import AngleRange
from mocap_id.protocols.reach.reachable_set import Grid, PlaneRange, ReachArm, compute_reachable_set
from mocap_id.protocols.reach.visited_region import VisitedRegion

_BOX, _REGION = Grid(12, 24, 16), Grid(8, 16, 32)
"""First grids for the box and for a region, which needs more axial rotations."""
_CHANGES = Grid(9, 18, 12)
"""Grid for the changes of the volume by one standard deviation; their error is a few per cent."""
_ENOUGH = 0.01, 0.02
"""Grids for the box and for a region are refined until the volume changes by less than this share."""
_MOST = 4  # largest number of grids


@dataclass(frozen=True)
class Volume:
    """A reachable volume, m³."""

    volume: float  # volume with the finest grid, m³
    discretisation: float  # change of the volume by the last refinement of the grid, m³
    interval: tuple[float, float]  # 95 % interval, m³
    convergence: tuple[float, ...]  # volumes with finer and finer grids, m³


@dataclass(frozen=True)
class Workspace:
    """Reachable volume within the box of the ranges, and within the visited region."""

    box: Volume  # volume within the box
    visited: Volume | None  # volume within the visited region; None without a region
    limits: FloatArray  # (4, 2) ends of the box: plane, elevation, axial rotation, flexion, rad
    sd: float  # standard deviation of the volume within the box, m³
    sources: dict[str, float]  # share of each range and dimension in the variance of this volume, by name

    def relative(self, arm: ReachArm) -> float:
        """Return the volume within the box as a share of a sphere with the arm's length as radius."""
        return self.box.volume / (4 / 3 * np.pi * arm.length**3)


def compute_workspace(arm: RecordedArm, ranges: Mapping[str, AngleRange], region: VisitedRegion | None) -> Workspace:
    """Return the reachable volume of an arm, its 95 % interval and the sources of its variance.

    The interval contains the errors of the ends of the ranges, of the lengths and of the shoulder's rise, the constant
    errors of the angles from the landmarks, and the error of the grid. A constant error of the plane is left out
    because it only rotates the set.

    Parameters
    ----------
    arm : RecordedArm
        Dimensions of the arm with their standard deviations.
    ranges : mapping
        Ranges of the four angles of :data:`~.arm_geometry.ANGLES`, by name.
    region : VisitedRegion or None
        Visited region; None if the motion has none.

    Raises
    ------
    UnknownReach
        The ranges are too small for a volume.
    """
    limits = np.array([(ranges[name].low, ranges[name].high) for name in ANGLES])
    volumes = _refine(arm.arm, limits)
    if not volumes[-1]:
        raise UnknownReach("the ranges of the angles are too small for a volume: record larger reaches")
    effects = _compute_effects(arm, ranges, limits)
    sd = float(np.sqrt(sum(effect**2 for effect in effects.values())))
    visited = None
    if region is not None:
        visited_volumes = _refine(arm.arm, region.limits, region.planes)
        visited = _add_interval(visited_volumes, visited_volumes[-1] * sd / volumes[-1])
    return Workspace(
        box=_add_interval(volumes, sd),
        visited=visited,
        limits=limits,
        sd=sd,
        sources={name: (effect / sd) ** 2 if sd else 0.0 for name, effect in effects.items()},
    )


def _add_interval(volumes: tuple[float, ...], sd: float) -> Volume:
    volume, change = volumes[-1], abs(volumes[-1] - volumes[-2])
    half = NORMAL_95 * sd + change
    return Volume(volume, change, (max(volume - half, 0.0), volume + half), volumes)


def _refine(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> tuple[float, ...]:
    """Return the volumes with finer and finer grids, at least two, m³."""
    grid, enough = (_BOX, _ENOUGH[0]) if planes is None else (_REGION, _ENOUGH[1])
    volumes = [compute_reachable_set(arm, limits, grid, planes).volume]
    while len(volumes) < _MOST:
        grid = grid.refined()
        volumes.append(compute_reachable_set(arm, limits, grid, planes).volume)
        if abs(volumes[-1] - volumes[-2]) <= enough * volumes[-1]:
            break
    return tuple(volumes)


def _compute_effects(arm: RecordedArm, ranges: Mapping[str, AngleRange], limits: FloatArray) -> dict[str, float]:
    """Return the change of the volume by one standard deviation of each input, m³, by name."""
    own = arm.arm

    def change(up: ReachArm, down: ReachArm, step: FloatArray) -> float:
        larger = compute_reachable_set(up, limits + step, _CHANGES)
        return 0.5 * (larger.volume - compute_reachable_set(down, limits - step, _CHANGES).volume)

    effects = {}
    for k, name in enumerate(ANGLES):
        sds = ranges[name].low_sd, ranges[name].high_sd, ranges[name].constant_sd
        for side, columns, sd in zip(("low", "high", "both"), ([0], [1], [0, 1]), sds, strict=True):
            if (name, side) == ("shoulder_plane", "both"):
                continue
            step = np.zeros((4, 2))
            step[k, columns] = sd
            effects[f"{name}_{side}"] = change(own, own, _limit_step(step, limits))
    longer = own.elbow * (1 + arm.upper_arm_sd / float(np.linalg.norm(own.elbow)))
    pairs = {
        "upper_arm": (replace(own, elbow=longer), replace(own, elbow=2 * own.elbow - longer)),
        "forearm": tuple(replace(own, forearm=own.forearm + s * arm.forearm_sd) for s in (1, -1)),
        "rise": tuple(replace(own, rise=own.rise + s * arm.rise_sd) for s in (1, -1)),
    }
    return effects | {name: change(up, down, np.zeros((4, 2))) for name, (up, down) in pairs.items()}


def _limit_step(step: FloatArray, limits: FloatArray) -> FloatArray:
    """Return ``step`` (4, 2), reduced so that elevations and ranges stay valid; the argument itself is changed too."""
    step[1] = np.minimum(step[1], [max(limits[1, 0], 0.0), max(np.pi - limits[1, 1], 0.0)])
    return np.minimum(step, 0.5 * (limits[:, 1:] - limits[:, :1]))
