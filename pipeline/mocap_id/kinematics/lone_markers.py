"""Trajectories that keep their distance from no other marker, such as reflections."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.kinematics.frame_sampling import frames_along_motion

_FRAMES = 120
_FEWEST = 20  # frames that show both markers
_MOVES = 0.02  # m, rms; the others move more: a distance from a still marker may stay the same by chance
_NEAR_BASE = 0.07  # m, rms; a marker that moves less may be beside the first joint, near still markers
_MOST = 0.1  # of all markers; more of them are limbs with one marker each
_SHARE = 0.3  # 10 to 90 % range of the distance from every other marker, relative to the marker's own scatter
_STRAYS = (0.02, 0.04)  # m; that limit is never below or above


def find_lone_markers(points: FloatArray) -> BoolArray:
    """Return which markers (M,) move and keep their distance from no other moving marker.

    Two markers of one segment keep their distance, and those of a limb without a joint centre nearly do. The image of a
    marker in a mirror does not, nor do those of a passer-by.

    Parameters
    ----------
    points : (F, M, 3) array
        Trajectories, m; NaN where unseen.
    """
    step = max(1, len(points) // (10 * _FRAMES))
    some = points[::step]
    paths = np.concatenate([some[..., 0] + 1j * some[..., 1], some[..., 2] + 0j], axis=1)
    some = some[frames_along_motion(paths, _FRAMES)]
    seen: BoolArray = np.asarray(np.isfinite(some).all(axis=2))
    counts = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen[..., None], some, 0).sum(axis=0) / counts[:, None]
    away = np.where(seen, np.linalg.norm(some - mean, axis=2), 0)
    scatter = np.sqrt((away**2).sum(axis=0) / counts)
    moves = (scatter > _MOVES) & (counts >= _FEWEST)
    lone = moves.copy()
    for marker in np.flatnonzero(moves):
        others = (moves | (scatter[marker] < _NEAR_BASE)) & (np.arange(len(moves)) != marker)
        nearest = _distance_ranges(some, int(marker), others).min(initial=np.inf)
        lone[marker] = np.isfinite(nearest) and nearest > np.clip(_SHARE * scatter[marker], *_STRAYS)
    return lone if lone.mean() <= _MOST else np.zeros_like(lone)


def _distance_ranges(points: FloatArray, marker: int, others: BoolArray) -> FloatArray:
    """Return the 10 to 90 % ranges of the distances from other markers, m; inf if hardly seen together."""
    distance = np.sort(np.linalg.norm(points[:, others] - points[:, [marker]], axis=2), axis=0)  # NaN last
    counts = np.isfinite(distance).sum(axis=0)
    last, column = np.maximum(counts - 1, 0), np.arange(distance.shape[1])
    low, high = (distance[np.round(share * last).astype(np.int64), column] for share in (0.1, 0.9))
    return np.asarray(np.where(counts >= _FEWEST, high - low, np.inf))
