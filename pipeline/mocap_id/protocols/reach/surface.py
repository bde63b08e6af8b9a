"""Surface of the reachable set: furthest reach by direction from the shoulder, and the area of the surface by quadrant.

The area is the integral of the squared furthest reach over the solid angle; the slope of the surface is ignored. It is
relative to half a sphere with the arm's length as radius, like the relative surface area of Kurillo et al. (2013) and
Han et al. (2015). It is 1 if the straight arm reaches everywhere in front of the frontal plane through the shoulder.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.reach.reachable_set import Grid, PlaneRange, ReachArm, compute_reachable_set

GRID = Grid(48, 24, 16)
"""Grid of the surface, with many distances because the distance is the radius of the surface."""
AZIMUTHS = 48
QUADRANTS = ("upper_medial", "upper_lateral", "lower_medial", "lower_lateral")


@dataclass(frozen=True)
class Surface:
    """Furthest reach by direction from the shoulder."""

    polar: FloatArray  # (C,) angles from the upward axis of the thorax, ascending, rad
    azimuth: FloatArray  # (K,) angles about this axis, rad: 0 is lateral, π/2 forward
    radius: FloatArray  # (C, K) furthest reach, m; NaN where nothing is reached
    # relative areas: ``total`` and :data:`QUADRANTS` in front of the shoulder, ``behind`` for the other half
    areas: dict[str, float]

    def points(self) -> FloatArray:
        """Return the points (C, K, 3) of the surface from the shoulder, in the axes of the thorax, m."""
        across = np.sin(self.polar)[:, None]
        along = np.broadcast_to(np.cos(self.polar)[:, None], self.radius.shape)
        direction = np.stack([across * np.sin(self.azimuth), along, across * np.cos(self.azimuth)], axis=-1)
        return np.asarray(self.radius[..., None] * direction)


def compute_reach_surface(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> Surface:
    """Return the surface of the set of :func:`~.reachable_set.compute_reachable_set`, which explains the arguments."""
    reachable = compute_reachable_set(arm, limits, GRID, planes)
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    radius = reachable.radius(azimuth)[::-1]
    polar = np.arccos((reachable.cosine[1:] + reachable.cosine[:-1]) / 2)[::-1]
    return Surface(polar, azimuth, radius, _compute_areas(polar, azimuth, radius / arm.length))


def _compute_areas(polar: FloatArray, azimuth: FloatArray, radius: FloatArray) -> dict[str, float]:
    """Return the relative areas by name; ``radius`` is relative to the arm's length."""
    each = np.nan_to_num(radius) ** 2 * 2 / radius.size  # all cells have the same solid angle
    front, lateral = np.sin(azimuth) > 0, np.cos(azimuth) > 0
    upper = np.cos(polar)[:, None] > 0
    areas = {"total": float(each[:, front].sum())}
    for name in QUADRANTS:
        height, side = name.split("_")
        there = (upper == (height == "upper")) & front & (lateral == (side == "lateral"))
        areas[name] = float(each[there].sum())
    return areas | {"behind": float(each[:, ~front].sum())}
