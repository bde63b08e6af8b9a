"""Where the feet stand: outlines on the floor of the low markers that stay where they are."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_STILL_M = 0.015
"""rms distance from its mean place that a marker on a standing foot keeps to; heels and toes move by 3 to 9 mm."""

_ON_SURFACE_M = 0.008
"""Nearer to the height of a plate's surface is a marker on the plate itself; on a foot it is 10 mm and more above."""

_LOW_M = 0.15
"""Markers on toes, heels and ankles are within this height of the lowest of them."""

_LEG_M, _BESIDE_M = 0.6, 0.25
"""A foot has a marker of its leg above it, up to this height, and no farther to the side than this."""

_APART_M = (0.2, 0.175, 0.15, 0.125)
"""Two neighbouring markers of one foot are nearer than the first; feet close together part at one of the others."""

_FEWEST = 2
"""Markers of a foot: one tells neither its length nor its direction."""

_DIRECTIONS = np.stack([np.cos(np.radians(np.arange(0, 360, 2))), np.sin(np.radians(np.arange(0, 360, 2)))])


def standing_feet(positions: FloatArray, samples: BoolArray, surface: float | None, wanted: int) -> list[FloatArray]:
    """Markers of every foot that stands still under a leg.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab axes with Z up, m; NaN where unseen.
    samples : (F,) bool array
        Frames in question.
    surface : float or None
        Height of the plates' surface, m; markers glued to it are no feet. None where it is not known.
    wanted : int
        Feet that stand close together are told apart until there are this many.

    Returns
    -------
    list of (K, 3) arrays
        Mean positions of each foot's markers, m; empty where no foot stays where it is.
    """
    seen = positions[samples]
    count = np.isfinite(seen).all(axis=2).sum(axis=0)
    often = count > len(seen) / 2
    if not often.any():
        return []
    middle, scatter = np.full((len(often), 3), np.nan), np.full(len(often), np.inf)
    middle[often] = np.nanmean(seen[:, often], axis=0)
    scatter[often] = np.sqrt(np.nansum(np.nanvar(seen[:, often], axis=0), axis=1))
    still = scatter < _STILL_M
    if surface is not None:
        still &= np.abs(middle[:, 2] - surface) > _ON_SURFACE_M
    if not still.any():
        return []
    lowest = float(middle[still, 2].min())
    height = np.where(often, middle[:, 2] - lowest, np.inf)
    legs, low = middle[(height >= _LOW_M) & (height < _LEG_M)], middle[still & (height < _LOW_M)]
    groups: list[FloatArray] = []
    for reach in _APART_M:
        groups = [low[group] for group in _groups(low[:, :2], reach)]
        groups = [group for group in groups if len(group) >= _FEWEST and _under_a_leg(group, legs)]
        if len(groups) >= wanted:
            break
    return groups


def outside(points: FloatArray, outline: FloatArray) -> FloatArray:
    """Distance of points (P, 2) from the convex hull of others (K, 2), m; negative inside, as far as its border.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> outside(np.array([[0.5, 0.5], [1.2, 0.5]]), square).round(3)
    array([-0.5,  0.2])
    """
    support = (outline @ _DIRECTIONS).max(axis=0)
    return np.asarray((points @ _DIRECTIONS - support).max(axis=1))


def length(outline: FloatArray) -> float:
    """Largest distance between two of the points (K, 2), m."""
    return float(np.max(np.linalg.norm(outline[:, None] - outline[None], axis=-1)))


def _groups(points: FloatArray, reach: float) -> list[IntArray]:
    """Indexes of points (K, 2) that hang together by steps of at most ``reach``."""
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) <= reach
    for _ in range(len(points)):
        near = near @ near
    return [np.flatnonzero(row) for row in np.unique(near, axis=0)]


def _under_a_leg(foot: FloatArray, legs: FloatArray) -> bool:
    if not len(legs):
        return False
    away = np.linalg.norm(legs[:, None, :2] - foot[None, :, :2], axis=-1)
    return bool(away.min() < _BESIDE_M)
