"""Rigid bodies in space: the shape of a marker cluster, and its pose in every frame."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_ITERATIONS = 60
_TOLERANCE = 1e-7  # m
_OUTLIER = 3.0  # median distances; a sample this far from its place has half its weight
_FLOOR = 1e-5  # m; median distances below this do not make outliers
_COLLINEAR = 0.02  # width of a cluster over its length, below which the rotation about its line is unknown


def fit_shape(points: FloatArray, start: FloatArray | None = None, iterations: int = _ITERATIONS) -> FloatArray:
    """Fit the shape of a rigid body to its markers (generalised Procrustes with gaps, robust against outliers).

    Parameters
    ----------
    points : (F, k, 3) array
        Trajectories of the body's markers, m; NaN where unseen. A few hundred frames along the motion are enough.
    start : (k, 3) array, optional
        First guess, m; NaN where unknown. Default: the frame in which most markers are seen.
    iterations : int, optional
        Largest number of iterations; two are enough to compare groups of markers.

    Returns
    -------
    (k, 3) array
        Marker coordinates, m, about their centroid and along no particular axes; NaN for markers that are never seen
        together with three known ones.

    Examples
    --------
    >>> triangle = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]])
    >>> local = fit_shape(np.stack([triangle, triangle + 1.0]))
    >>> round(float(np.linalg.norm(local[1] - local[2])), 6)
    0.223607
    """
    seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    local = points[int(np.argmax(seen.sum(axis=1)))] if start is None else start
    weights: FloatArray = seen.astype(np.float64)
    for _ in range(iterations):
        rotation, origin, _ = rigid_poses(points, local, weights)
        back = np.einsum("fji,fkj->fki", rotation, points - origin[:, None])
        used = np.where(np.isfinite(back[..., 0]), weights, 0.0)
        total = used.sum(axis=0)
        mean = np.einsum("fk,fki->ki", used, np.where(used[..., None] > 0, back, 0.0))
        places = np.where(total[:, None] > 0, mean / np.maximum(total, 1e-12)[:, None], np.nan)
        updated = places - np.nanmean(places, axis=0) if np.isfinite(places).any() else places
        step = np.abs(updated - local)
        known = np.isfinite(step)
        grown = bool((np.isfinite(updated) != np.isfinite(local)).any())
        local = updated
        if not known.any() or (not grown and float(step[known].max()) < _TOLERANCE):
            break
        weights = _robust_weights(back - places, seen)
    return np.asarray(local)


def rigid_poses(
    points: FloatArray, local: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the pose of a rigid body in every frame, by weighted least squares (Kabsch's closed form).

    Parameters
    ----------
    points : (F, k, 3) array
        Trajectories of the body's markers, m; NaN where unseen.
    local : (k, 3) array
        Marker coordinates in the body's frame, m; NaN where unknown.
    weights : (k,) or (F, k) array, optional
        Weights of the markers, 0 or more; default: equal.

    Returns
    -------
    rotation : (F, 3, 3) array
        Body to the frame of ``points``; NaN where fewer than three markers are seen, or only markers on one line.
    origin : (F, 3) array
        Origin of the body's frame, m; NaN likewise.
    seen : (F,) int array
        Number of markers used.
    """
    used: BoolArray = np.asarray(np.isfinite(points).all(axis=2) & np.isfinite(local).all(axis=1))
    weight = np.where(used, 1.0 if weights is None else np.broadcast_to(weights, used.shape), 0.0)
    seen = (weight > 0).sum(axis=1)
    total = np.maximum(weight.sum(axis=1), 1e-12)[:, None]
    here, there = np.where(used[..., None], points, 0.0), np.where(np.isfinite(local), local, 0.0)
    point_mean, local_mean = np.einsum("fk,fki->fi", weight, here) / total, weight @ there / total
    moment = np.einsum("fk,fki,kj->fij", weight, here, there) - total[..., None] * (
        point_mean[:, :, None] * local_mean[:, None, :]
    )
    left, size, right = np.linalg.svd(moment)
    mirrored = np.linalg.det(left @ right) < 0
    left[mirrored, :, 2] *= -1
    rotation = left @ right
    flat = (seen < 3) | (size[:, 1] <= _COLLINEAR**2 * size[:, 0])
    rotation[flat] = np.nan
    return rotation, point_mean - np.einsum("fij,fj->fi", rotation, local_mean), np.asarray(seen)


def marker_distances(points: FloatArray, local: FloatArray, rotation: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the distance (F, k) of every sample from its place on a body, m; NaN where either is unknown.

    Parameters
    ----------
    points, local : (F, k, 3) and (k, 3) arrays
        As for :func:`rigid_poses`.
    rotation, origin : (F, 3, 3) and (F, 3) arrays
        Pose of the body in every frame.
    """
    placed = origin[:, None] + np.einsum("fij,kj->fki", rotation, local)
    return np.asarray(np.linalg.norm(points - placed, axis=2))


def _robust_weights(off: FloatArray, seen: BoolArray) -> FloatArray:
    """Return weights (F, k), near 1 for usual samples and small for outliers, from their offsets (F, k, 3), m."""
    distance = np.linalg.norm(off, axis=2)
    known = np.isfinite(distance)
    usual = max(float(np.median(distance[known])) if known.any() else 0.0, _FLOOR)
    weight = 1 / (1 + (np.where(known, distance, 0.0) / (_OUTLIER * usual)) ** 2)
    return np.where(seen, weight, 0.0)
