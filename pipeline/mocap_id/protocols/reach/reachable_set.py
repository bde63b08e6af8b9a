"""Visited region of joint space, and the reachable set of the wrist, computed by inverse kinematics.

In a posture (plane, elevation, axial, flexion), the wrist is at R_y(plane) R_x(-elevation) R_y(axial) w(flexion) from
the shoulder. The distance |w| determines the flexion. At a given distance and polar angle, there are two axial
rotations for each elevation, and two elevations for each axial rotation. The plane only rotates the wrist about the
vertical axis of the thorax, so every solution is an arc as long as the range of the plane. The set is the union of
these arcs. Its volume is the sum of their lengths over distances and polar angles.

The surface of the set is the largest distance from the shoulder in each direction. Its area is the integral of the
squared distance over the solid angle; the slope of the surface is ignored. The area is relative to half a sphere with
the arm's length as radius, like the relative surface area of Kurillo et al. (2013) and Han et al. (2015). It is 1 if
the straight arm can point in all directions in front of the frontal plane through the shoulder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_FEWEST = 40  # smallest number of postures for a region
_MOST = 200  # approximate number of postures for a hull; four times as many change the volume by less than 1 %
_BLOCK = 8192  # postures computed at once, to limit the memory
_FLAT = 1e-9  # slope of a face that does not limit the plane


@dataclass(frozen=True)
class VisitedRegion:
    """Convex hull of postures x (plane, elevation, axial, flexion), rad.

    The postures x with ``normals`` (F, 4) x <= ``bounds`` (F,) are inside; ``limits`` (4, 2) is the box around them.
    """

    normals: FloatArray
    bounds: FloatArray
    limits: FloatArray

    def planes(self, elevation: FloatArray, axial: FloatArray, flexion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest plane (K,) for the three other angles (K,), rad.

        Outside the region, the lowest plane is above the highest one.
        """
        low, high = np.empty(len(elevation)), np.empty(len(elevation))
        slope = self.normals[:, 0]
        up, down = slope > _FLAT, slope < -_FLAT
        flat = ~up & ~down
        size = np.where(flat, 1.0, slope)  # faces as plane <= or >= bound - normals @ others
        normals, bounds = ((each.T / size).T.astype(np.float32) for each in (self.normals[:, 1:], self.bounds))
        for first in range(0, len(elevation), _BLOCK):
            part = slice(first, first + _BLOCK)
            others = np.stack([elevation[part], axial[part], flexion[part]]).astype(np.float32)
            high[part] = (bounds[up, None] - normals[up] @ others).min(axis=0)
            low[part] = (bounds[down, None] - normals[down] @ others).max(axis=0)
            if flat.any():
                outside = (bounds[flat, None] < normals[flat] @ others).any(axis=0)
                low[part] = np.where(outside, np.inf, low[part])
        return low, high


def find_visited_region(postures: FloatArray, limits: FloatArray) -> VisitedRegion | None:
    """Return the region of the visited postures; None if the postures are too few or if the hull has no volume.

    ``postures`` (T, 4) are plane, elevation, axial rotation and flexion, rad. ``limits`` (4, 2) are the robust ranges
    of these angles, rad; postures outside are moved to the limit.
    """
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  only a reach needs it

    size = limits[:, 1] - limits[:, 0]
    if len(postures) < _FEWEST or np.any(size <= 0):
        return None
    thinned = postures[:: max(len(postures) // _MOST, 1)]
    share = np.clip((thinned - limits[:, 0]) / size, 0.0, 1.0)
    try:
        hull = ConvexHull(share)
    except QhullError:
        return None
    faces = np.unique(np.round(hull.equations, 9), axis=0)
    normals = faces[:, :4] / size
    around = np.stack([share.min(axis=0), share.max(axis=0)], axis=1)
    return VisitedRegion(normals, normals @ limits[:, 0] - faces[:, 4], limits[:, :1] + around * size[:, None])


PlaneRange: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Function from elevation, axial rotation and flexion to the lowest and highest plane, (K,) arrays, rad.

If the lowest plane is above the highest one, the posture is not possible."""

_FULL = 2 * np.pi
_CURVE = 400  # flexions at which the position of the wrist is computed


@dataclass(frozen=True)
class ReachArm:
    """Dimensions of an arm."""

    elbow: FloatArray  # (3,) elbow centre in the axes of the upper arm, whose origin is the shoulder centre, m
    forearm: float  # distance from the elbow centre to the wrist along the forearm's y axis, m
    # (3,) coefficients c0, c1, c2 of the carrying angle c0 + c1 cos(flexion) + c2 sin(flexion), rad
    carrying: FloatArray
    # rise of the shoulder in the thorax at an elevation of 180°, m; at others, it is rise (1 - cos(elevation)) / 2
    rise: float

    def wrist(self, flexion: FloatArray) -> FloatArray:
        """Return the position (K, 3) of the wrist in the axes of the upper arm, m, for flexions (K,), rad."""
        bent = self.carrying @ np.stack([np.ones_like(flexion), np.cos(flexion), np.sin(flexion)])
        along = np.stack([np.sin(flexion) * np.cos(bent), -np.cos(flexion) * np.cos(bent), -np.sin(bent)], axis=1)
        return np.asarray(self.elbow + self.forearm * along)

    @property
    def length(self) -> float:
        """Length of the straight arm from shoulder to wrist, m."""
        return float(np.linalg.norm(self.elbow) + self.forearm)


@dataclass(frozen=True)
class CellGrid:
    """Numbers of distances and polar angles; ``turns`` is the number of elevations and also of axial rotations."""

    distances: int
    polar: int
    turns: int

    def refined(self) -> CellGrid:
        """Return a grid with 1.5 times as many values in every direction."""
        return CellGrid(*(int(np.ceil(1.5 * each)) for each in (self.distances, self.polar, self.turns)))


@dataclass(frozen=True)
class ReachableSet:
    """Reachable set as arcs about the vertical axis of the thorax through the shoulder."""

    distance: FloatArray  # (R + 1,) edges of the cells of the distance from the shoulder, m
    cosine: FloatArray  # (C + 1,) edges of the cells of the cosine of the polar angle
    # Start, end: (R, C, A) azimuths of the ends of the arcs, rad: 0 is lateral, π/2 forward. ``start`` is ascending,
    # in [0, 2π). Arcs of length 0 are ignored.
    start: FloatArray
    end: FloatArray

    @property
    def volume(self) -> float:
        """Volume of the set, m³."""
        over = np.maximum(self.end.max(axis=-1, keepdims=True) - _FULL, 0.0)
        reached = np.maximum.accumulate(np.concatenate([over, np.minimum(self.end, _FULL)], axis=-1), axis=-1)
        covered = over[..., 0] + np.maximum(reached[..., 1:] - np.maximum(self.start, reached[..., :-1]), 0).sum(
            axis=-1
        )
        cell = np.diff(self.distance**3)[:, None] / 3 * np.diff(self.cosine)
        return float(np.sum(np.minimum(covered, _FULL) * cell))

    def radius(self, azimuth: FloatArray) -> FloatArray:
        """Return the largest distance (C, K), m, in each polar cell at azimuths (K,), rad; NaN for an empty cell."""
        far = np.full((len(self.cosine) - 1, len(azimuth)), np.nan)
        for k, angle in enumerate(azimuth):
            inside = ((self.start <= angle) & (angle <= self.end)) | (angle + _FULL <= self.end)
            there = (inside & (self.end > self.start)).any(axis=-1)
            last = len(there) - 1 - there[::-1].argmax(axis=0)
            far[:, k] = np.where(there.any(axis=0), self.distance[1:][last], np.nan)
        return far


def compute_reachable_set(
    arm: ReachArm, limits: FloatArray, grid: CellGrid, planes: PlaneRange | None = None
) -> ReachableSet:
    """Return the set of positions that the wrist can reach, relative to the shoulder at the middle elevation.

    ``limits`` (4, 2) are the lowest and highest plane, elevation, axial rotation and flexion, rad. ``planes`` gives the
    range of the plane, which depends on the other angles; by default, it is the range in ``limits``.
    """
    # distance of the wrist from the shoulder, ascending, and flexion and wrist in the upper arm at this distance
    flexions = np.linspace(limits[3, 0], limits[3, 1], _CURVE)
    wrist = arm.wrist(flexions)
    reach = np.linalg.norm(wrist, axis=1)
    longest = int(reach.argmax())  # smaller flexions only repeat distances
    reach, flexions, wrist = reach[longest:][::-1], flexions[longest:][::-1], wrist[longest:][::-1]
    slack = abs(arm.rise) / 2
    near, far = max(reach[0] - slack, 0.0), reach[-1] + slack
    distance = np.cbrt(np.linspace(near**3, far**3, grid.distances + 1))
    cosine = np.linspace(-1.0, 1.0, grid.polar + 1)
    # distance from the vertical axis and height (R, C, 1) of the middle of every cell, m
    r = np.cbrt((distance[1:] ** 3 + distance[:-1] ** 3) / 2)[:, None, None]
    c = ((cosine[1:] + cosine[:-1]) / 2)[:, None]
    across, level = r * np.sqrt(1 - c**2), r * c

    def shoulder_height(elevation: FloatArray) -> FloatArray:
        """Return the height of the shoulder at an elevation, relative to the middle elevation, m."""
        return np.asarray(arm.rise * (np.cos(limits[1]).mean() - np.cos(elevation)) / 2)

    def bend_arm(height: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return x, y, z of the wrist in the upper arm, m, the flexion, and True where the distance is possible."""
        d = np.hypot(across, height)
        x, y, z, flexion = (np.interp(d, reach, each) for each in (*wrist.T, flexions))
        return x, y, z, flexion, (d >= reach[0]) & (d <= reach[-1])

    # azimuth at plane 0, elevation, axial rotation, flexion, and True where the limits allow them, (R, C, A) arrays
    solutions: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]] = []
    # the two axial rotations at every elevation of the grid
    elevation = np.linspace(limits[1, 0], limits[1, 1], grid.turns)
    sine = np.maximum(np.sin(elevation), 1e-9)
    height = level - shoulder_height(elevation)
    x, y, z, flexion, possible = bend_arm(height)
    forward, wide = (height - np.cos(elevation) * y) / sine, np.hypot(x, z)
    lowest, highest = limits[2]
    for sign in (-1.0, 1.0):
        axial = sign * np.arccos(np.clip(forward / wide, -1, 1)) - np.arctan2(x, z)
        valid = possible & (np.abs(forward) <= wide) & (np.mod(axial - lowest, _FULL) <= highest - lowest)
        azimuth = np.arctan2(x * np.cos(axial) + z * np.sin(axial), np.cos(elevation) * forward - sine * y)
        solutions.append((azimuth, np.broadcast_to(elevation, axial.shape), axial, flexion, valid))
    # the two elevations at every axial rotation of the grid
    axial = np.linspace(limits[2, 0], limits[2, 1], grid.turns)
    for sign in (-1.0, 1.0):
        elevation = np.full((*level.shape[:2], len(axial)), limits[1].mean())
        for _ in range(2 if arm.rise else 1):  # the height of the shoulder changes a little with the elevation
            height = level - shoulder_height(elevation)
            x, y, z, flexion, possible = bend_arm(height)
            sideways, forward = x * np.cos(axial) + z * np.sin(axial), z * np.cos(axial) - x * np.sin(axial)
            wide = np.hypot(y, forward)
            elevation = np.arctan2(forward, y) + sign * np.arccos(np.clip(height / wide, -1, 1))
        elevation = np.mod(elevation, _FULL)
        valid = possible & (np.abs(height) <= wide) & (elevation >= limits[1, 0]) & (elevation <= limits[1, 1])
        azimuth = np.arctan2(sideways, np.cos(elevation) * forward - np.sin(elevation) * y)
        solutions.append((azimuth, elevation, np.broadcast_to(axial, elevation.shape), flexion, valid))

    azimuth, elevation, axial, flexion, valid = (np.concatenate(each, axis=-1) for each in zip(*solutions, strict=True))
    low, high = np.full_like(azimuth, limits[0, 0]), np.full_like(azimuth, limits[0, 1])
    if planes is not None:
        low[valid], high[valid] = planes(elevation[valid], axial[valid], flexion[valid])
    valid &= high > low
    start = np.where(valid, np.mod(np.where(valid, azimuth + low, 0.0), _FULL), _FULL)
    end = np.where(valid, start + np.minimum(high - low, _FULL), _FULL)
    order = np.argsort(start, axis=-1)
    start, end = (np.take_along_axis(each, order, axis=-1) for each in (start, end))
    return ReachableSet(distance, cosine, start, end)


SURFACE_GRID = CellGrid(48, 24, 16)
"""CellGrid of the surface, with many distances because the distance is the radius of the surface."""
AZIMUTHS = 48
QUADRANTS = ("upper_medial", "upper_lateral", "lower_medial", "lower_lateral")


@dataclass(frozen=True)
class Surface:
    """Largest distance of the wrist from the shoulder in each direction."""

    polar: FloatArray  # (C,) angles from the upward axis of the thorax, ascending, rad
    azimuth: FloatArray  # (K,) angles about this axis, rad: 0 is lateral, π/2 forward
    radius: FloatArray  # (C, K) largest distance, m; NaN where nothing is reached
    # relative areas: ``total`` and :data:`QUADRANTS` in front of the shoulder, ``behind`` for the other half
    areas: dict[str, float]

    def points(self) -> FloatArray:
        """Return the points (C, K, 3) of the surface relative to the shoulder, in the axes of the thorax, m."""
        across = np.sin(self.polar)[:, None]
        along = np.broadcast_to(np.cos(self.polar)[:, None], self.radius.shape)
        direction = np.stack([across * np.sin(self.azimuth), along, across * np.cos(self.azimuth)], axis=-1)
        return np.asarray(self.radius[..., None] * direction)


def compute_reach_surface(arm: ReachArm, limits: FloatArray, planes: PlaneRange | None = None) -> Surface:
    """Return the surface of the reachable set; :func:`compute_reachable_set` explains the arguments."""
    reachable = compute_reachable_set(arm, limits, SURFACE_GRID, planes)
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    radius = reachable.radius(azimuth)[::-1]
    polar = np.arccos((reachable.cosine[1:] + reachable.cosine[:-1]) / 2)[::-1]
    # relative areas; all cells have the same solid angle
    each = np.nan_to_num(radius / arm.length) ** 2 * 2 / radius.size
    front, lateral, upper = np.sin(azimuth) > 0, np.cos(azimuth) > 0, np.cos(polar)[:, None] > 0
    areas = {"total": float(each[:, front].sum())}
    for name in QUADRANTS:
        height, side = name.split("_")
        there = (upper == (height == "upper")) & front & (lateral == (side == "lateral"))
        areas[name] = float(each[there].sum())
    areas["behind"] = float(each[:, ~front].sum())
    return Surface(polar, azimuth, radius, areas)
