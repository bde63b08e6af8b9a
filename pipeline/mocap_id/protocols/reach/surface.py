"""Surface of the reachable set about the shoulder: furthest reach by direction, and its area by quadrants.

The area is that of spheres about the shoulder: the furthest reach squared, over the solid angle. It is relative to
half a sphere of the arm's length in front of the shoulder, as the relative surface area of Kurillo et al. (2013) and
Han et al. (2015): 1 if the straight arm reaches everywhere in front of the frontal plane through the shoulder. The
slope of the surface does not count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.reach.reachable_set import Grid, PlaneRange, ReachArm, reachable_set

GRID = Grid(48, 24, 16)
"""Grid of the surface, fine in the distance, because this is the radius of the surface."""
AZIMUTHS = 48
QUADRANTS = ("upper_medial", "upper_lateral", "lower_medial", "lower_lateral")


@dataclass(frozen=True)
class Surface:
    """Furthest reach by direction.

    Parameters
    ----------
    polar : (C,) array
        Angle from the upward axis of the thorax, ascending, rad.
    azimuth : (K,) array
        Angle about it: 0 lateral, π/2 forward, rad.
    radius : (C, K) array
        m; NaN where nothing is reached.
    areas : dict
        ``total`` and :data:`QUADRANTS` in front of the shoulder as shares of half a sphere of the arm's length;
        ``behind`` as share of the other half.
    """

    polar: FloatArray
    azimuth: FloatArray
    radius: FloatArray
    areas: dict[str, float]

    def points(self) -> FloatArray:
        """Return the surface (C, K, 3) in the axes of the thorax, m from the shoulder."""
        across = np.sin(self.polar)[:, None]
        along = np.broadcast_to(np.cos(self.polar)[:, None], self.radius.shape)
        direction = np.stack([across * np.sin(self.azimuth), along, across * np.cos(self.azimuth)], axis=-1)
        return np.asarray(self.radius[..., None] * direction)


def reach_surface(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> Surface:
    """Return the surface of the reachable set (:func:`~.reachable_set.reachable_set`)."""
    found = reachable_set(arm, limits, GRID, planes)
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    radius = found.radius(azimuth)[::-1]
    polar = np.arccos((found.cosine[1:] + found.cosine[:-1]) / 2)[::-1]
    return Surface(polar, azimuth, radius, _areas(polar, azimuth, radius / arm.length))


def _areas(polar: FloatArray, azimuth: FloatArray, radius: FloatArray) -> dict[str, float]:
    each = np.nan_to_num(radius) ** 2 * 2 / radius.size  # both cells are even in solid angle; a half sphere is 1
    front, lateral = np.sin(azimuth) > 0, np.cos(azimuth) > 0
    upper = np.cos(polar)[:, None] > 0
    areas = {"total": float(each[:, front].sum())}
    for name in QUADRANTS:
        height, side = name.split("_")
        there = (upper == (height == "upper")) & front & (lateral == (side == "lateral"))
        areas[name] = float(each[there].sum())
    return areas | {"behind": float(each[:, ~front].sum())}
