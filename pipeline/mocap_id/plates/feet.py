"""Positions of the standing feet, from the low markers that do not move."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_STILL_M = 0.015
"""Largest rms distance of a marker on a standing foot from its mean; for heels and toes it is 3 to 9 mm."""

_ON_SURFACE_M = 0.008
"""A marker closer to the height of the plate's surface is on the plate; on a foot it is at least 10 mm higher."""

_LOW_M = 0.15
"""Markers on toes, heels and ankles are at most this much higher than the lowest one."""

_LEG_M, _BESIDE_M = 0.6, 0.25
"""A foot has a marker of the leg above it, up to this height and within this horizontal distance."""

_NEIGHBOUR_M = (0.2, 0.175, 0.15, 0.125)
"""Largest distance between neighbouring markers of a foot; the smaller values separate feet that are close."""

_MIN_MARKERS = 2
"""Minimum number of markers of a foot: one shows neither its length nor its direction."""

_FRAMES = 20_000
"""Largest number of frames that places of feet are averaged over: more only cost memory."""

_DIRECTIONS = np.stack([np.cos(np.radians(np.arange(0, 360, 2))), np.sin(np.radians(np.arange(0, 360, 2)))])


def find_standing_feet(
    positions: FloatArray, samples: BoolArray, surface: float | None, wanted: int
) -> list[FloatArray]:
    """Find the feet that stand still under a leg.

    Parameters
    ----------
    positions : (F, M, 3) array
        Markers, lab axes with Z up, m; NaN where not visible.
    samples : (F,) bool array
        Frames to consider.
    surface : float or None
        Height of the plates' surface, m, to exclude markers on it; None if unknown.
    wanted : int
        Number of feet to look for: feet close together are separated until there are this many.

    Returns
    -------
    list of (K, 3) arrays
        Mean positions of the markers of each foot, m; empty if no foot stands still.
    """
    chosen = np.flatnonzero(samples)
    considered = positions[chosen[:: -(-len(chosen) // _FRAMES) or 1]]
    count = np.isfinite(considered).all(axis=2).sum(axis=0)
    often = count > len(considered) / 2
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
        groups = [low[group] for group in _groups(low[:, :2], reach)]
        groups = [group for group in groups if len(group) >= _MIN_MARKERS and _under_a_leg(group, legs)]
        if len(groups) >= wanted:
            break
    return groups


def distance_outside(points: FloatArray, outline: FloatArray) -> FloatArray:
    """Return the distance (P,) of points (P, 2) from the convex hull of an outline (K, 2), m; negative inside.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> distance_outside(np.array([[0.5, 0.5], [1.2, 0.5]]), square).round(3)
    array([-0.5,  0.2])
    """
    support = (outline @ _DIRECTIONS).max(axis=0)
    return np.asarray((points @ _DIRECTIONS - support).max(axis=1))


def least_width(outline: FloatArray) -> float:
    """Return the least distance between two parallel lines that enclose an outline (K, 2), m.

    Examples
    --------
    >>> round(least_width(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])), 3)
    1.0
    """
    return float(np.ptp(outline @ _DIRECTIONS, axis=0).min())


def largest_distance(outline: FloatArray) -> float:
    """Return the largest distance between any two points of an outline (K, 2), m."""
    return float(np.max(np.linalg.norm(outline[:, None] - outline[None], axis=-1)))


def _groups(points: FloatArray, reach: float) -> list[IntArray]:
    """Group points (K, 2) that are connected by steps of at most ``reach``; return their indices."""
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) <= reach
    for _ in range(len(points)):
        near = near @ near
    return [np.flatnonzero(row) for row in np.unique(near, axis=0)]


def _under_a_leg(foot: FloatArray, legs: FloatArray) -> bool:
    if not len(legs):
        return False
    away = np.linalg.norm(legs[:, None, :2] - foot[None, :, :2], axis=-1)
    return bool(away.min() < _BESIDE_M)
