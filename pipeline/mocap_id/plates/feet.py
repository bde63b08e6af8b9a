"""Positions of the standing feet, estimated from the low markers that do not move."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_STILL_M = 0.015
"""Largest rms distance of a marker on a standing foot from its mean position; for heels and toes it is 3 to 9 mm."""

_ON_SURFACE_M = 0.008
"""Markers within this height of the plate's surface are on the plate. Markers on a foot are at least 10 mm higher."""

_LOW_M = 0.15
"""Markers on toes, heels and ankles are at most this much higher than the lowest marker."""

_LEG_M, _BESIDE_M = 0.6, 0.25
"""A marker of the leg is above the foot: it is at most the first length higher, and horizontally within the second."""

_NEIGHBOUR_M = (0.2, 0.175, 0.15, 0.125)
"""Largest distances between neighbouring markers of a foot, tried in turn: small ones separate feet close together."""

_MIN_MARKERS = 2
"""Minimum number of markers of a foot: one marker gives neither its length nor its direction."""

_FRAMES = 20_000
"""Largest number of frames over which positions are averaged; more frames would only need more memory."""

_DIRECTIONS = np.stack([np.cos(np.radians(np.arange(0, 360, 2))), np.sin(np.radians(np.arange(0, 360, 2)))])


def find_standing_feet(
    positions: FloatArray, samples: BoolArray, surface: float | None, count: int
) -> list[FloatArray]:
    """Return the mean marker positions (K, 3), m, of each foot that stands still under a leg.

    Parameters
    ----------
    samples : (F,) bool array
        Frames to average over.
    surface : float or None
        Height of the plates' surface, m, to exclude the markers on it; None if it is not known.
    count : int
        Number of feet to look for. Markers are separated into smaller groups until at least this many feet are found.
        The result can contain fewer or more feet.
    """
    chosen = np.flatnonzero(samples)
    considered = positions[chosen[:: -(-len(chosen) // _FRAMES) or 1]]
    often = np.isfinite(considered).all(axis=2).sum(axis=0) > len(considered) / 2
    if not often.any():
        return []
    middle, scatter = np.full((len(often), 3), np.nan), np.full(len(often), np.inf)
    middle[often] = np.nanmean(considered[:, often], axis=0)
    scatter[often] = np.sqrt(np.nansum(np.nanvar(considered[:, often], axis=0), axis=1))
    still = scatter < _STILL_M
    if surface is not None:
        still &= np.abs(middle[:, 2] - surface) > _ON_SURFACE_M
    if not still.any():
        return []
    lowest = float(middle[still, 2].min())
    height = np.where(often, middle[:, 2] - lowest, np.inf)
    legs, low = middle[(height >= _LOW_M) & (height < _LEG_M)], middle[still & (height < _LOW_M)]
    groups: list[FloatArray] = []
    for reach in _NEIGHBOUR_M:
        groups = [low[group] for group in _group_neighbours(low[:, :2], reach)]
        groups = [group for group in groups if len(group) >= _MIN_MARKERS and _is_under_leg(group, legs)]
        if len(groups) >= count:
            break
    return groups


def measure_outside(points: FloatArray, outline: FloatArray) -> FloatArray:
    """Return the distance (P,) of points (P, 2) from the convex hull of an outline (K, 2), m; negative inside.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> measure_outside(np.array([[0.5, 0.5], [1.2, 0.5]]), square).round(3)
    array([-0.5,  0.2])
    """
    support = (outline @ _DIRECTIONS).max(axis=0)
    return np.asarray((points @ _DIRECTIONS - support).max(axis=1))


def measure_width(outline: FloatArray) -> float:
    """Return the least distance between two parallel lines that enclose an outline (K, 2), m.

    Examples
    --------
    >>> round(measure_width(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])), 3)
    1.0
    """
    return float(np.ptp(outline @ _DIRECTIONS, axis=0).min())


def measure_length(outline: FloatArray) -> float:
    """Return the largest distance between any two points of an outline (K, 2), m."""
    return float(np.max(np.linalg.norm(outline[:, None] - outline[None], axis=-1)))


def _group_neighbours(points: FloatArray, reach: float) -> list[IntArray]:
    """Return the indices of the points in each group of points (K, 2) with neighbours at most ``reach``, m, apart."""
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) <= reach
    for _ in range(len(points)):
        near = near @ near
    return [np.flatnonzero(row) for row in np.unique(near, axis=0)]


def _is_under_leg(foot: FloatArray, legs: FloatArray) -> bool:
    """Return whether the horizontal distance of a marker of the legs (L, 3) from the foot (K, 3) is small."""
    if not len(legs):
        return False
    away = np.linalg.norm(legs[:, None, :2] - foot[None, :, :2], axis=-1)
    return bool(away.min() < _BESIDE_M)
