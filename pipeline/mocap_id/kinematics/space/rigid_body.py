"""Rigid bodies in space: shape of a marker cluster, and its pose in every frame."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled

_ITERATIONS = 60
_TOLERANCE = 1e-7  # m
_OUTLIER = 3.0  # distance from its position, in medians, at which a sample has half its weight
_FLOOR = 1e-5  # m; least median distance in this comparison
_COLLINEAR = 0.02  # least ratio of width and length of a cluster with a known rotation
_SWEEPS = 12  # largest number of sweeps of Jacobi rotations; four are typical


def fit_shape(points: FloatArray, start: FloatArray | None = None, iterations: int = _ITERATIONS) -> FloatArray:
    """Fit the shape of a rigid body to its markers (generalised Procrustes analysis with gaps and robust weights).

    The coordinates (k, 3), m, are relative to their centroid, in arbitrary axes. They are NaN for markers that are
    never visible together with three markers of known coordinates. The trajectories ``points`` (F, k, 3) are in m, NaN
    where missing; a few hundred frames along the motion are enough. ``start`` (k, 3) is a first guess, m, NaN where
    unknown; by default, it is the frame with most visible markers. Two ``iterations`` are enough to compare groups of
    markers.

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
        # robust weights: near 1 for usual samples and small for outliers
        distance = np.linalg.norm(back - places, axis=2)
        measured = np.isfinite(distance)
        usual = max(float(np.median(distance[measured])) if measured.any() else 0.0, _FLOOR)
        outlying = 1 / (1 + (np.where(measured, distance, 0.0) / (_OUTLIER * usual)) ** 2)
        weights = np.where(seen, outlying, 0.0)
    return np.asarray(local)


def rigid_poses(
    points: FloatArray, local: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the pose of a rigid body in every frame, by weighted least squares (Kabsch's closed form).

    The trajectories (F, k, 3), m, are NaN where missing. ``local`` (k, 3) are the coordinates in the body's frame, m,
    NaN where unknown. The weights (k,) or (F, k) are 0 or more, by default equal. The results are the rotation
    (F, 3, 3) from the body to the frame of ``points``, the origin (F, 3) of the body's frame, m, and the number (F,) of
    markers used. The pose is NaN with fewer than three visible markers, or with markers on one line.
    """
    weight = np.ones(points.shape[:2]) * (1.0 if weights is None else weights)
    rotation, origin = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
    seen = np.empty(len(points), dtype=np.int64)
    _turn_onto(np.ascontiguousarray(points), np.ascontiguousarray(local), weight, rotation, origin, seen)
    return rotation, origin, seen


def mean_rotation(rotation: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) nearest to the mean of rotations (F, 3, 3)."""
    left, _, right = np.linalg.svd(rotation.mean(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


@compiled
def _turn_onto(  # noqa: PLR0917
    points: FloatArray, local: FloatArray, weight: FloatArray, rotation: FloatArray, origin: FloatArray, seen: IntArray
) -> None:
    """Write the results of :func:`rigid_poses` to ``rotation``, ``origin`` and ``seen``.

    The eigenvectors v of MᵀM, with the moment M, give the axes M v of the points. The third axes complete both frames,
    so the result is not a reflection, and markers in one plane need no special case.
    """
    here, there, moment = np.empty(3), np.empty(3), np.empty((3, 3))
    for f in range(points.shape[0]):
        seen[f] = _moment(points[f], local, weight[f], here, there, moment)
        squares, axes = _principal_axes(moment)
        if seen[f] < 3 or squares[1] <= _COLLINEAR**4 * squares[0]:
            rotation[f] = np.nan
            origin[f] = np.nan
            continue
        first, second = np.zeros(3), np.zeros(3)
        for i in range(3):
            for j in range(3):
                first[i] += moment[i, j] * axes[j, 0]
                second[i] += moment[i, j] * axes[j, 1]
        _orthonormalise(first, second)
        third, own = _cross(first, second), _cross(axes[:, 0], axes[:, 1])
        for i in range(3):
            origin[f, i] = here[i]
            for j in range(3):
                rotation[f, i, j] = first[i] * axes[j, 0] + second[i] * axes[j, 1] + third[i] * own[j]
                origin[f, i] -= rotation[f, i, j] * there[j]


@compiled
def _moment(  # noqa: PLR0917
    points: FloatArray,
    local: FloatArray,
    weight: FloatArray,
    here: FloatArray,
    there: FloatArray,
    moment: FloatArray,
) -> int:
    """Write the weighted means ``here`` and ``there`` and the moment about them; return the number of markers used."""
    total, count = 0.0, 0
    here[:], there[:], moment[:] = 0.0, 0.0, 0.0
    for k in range(len(points)):
        w = weight[k]
        if w > 0 and np.isfinite(points[k, 0] + points[k, 1] + points[k, 2] + local[k, 0] + local[k, 1] + local[k, 2]):
            count += 1
            total += w
            for i in range(3):
                here[i] += w * points[k, i]
                there[i] += w * local[k, i]
    for i in range(3):
        here[i] /= max(total, 1e-12)
        there[i] /= max(total, 1e-12)
    for k in range(len(points)):
        w = weight[k]
        if w > 0 and np.isfinite(points[k, 0] + points[k, 1] + points[k, 2] + local[k, 0] + local[k, 1] + local[k, 2]):
            for i in range(3):
                for j in range(3):
                    moment[i, j] += w * (points[k, i] - here[i]) * (local[k, j] - there[j])
    return count


@compiled
def _orthonormalise(first: FloatArray, second: FloatArray) -> None:
    """Make two vectors (3,) unit vectors normal to each other, in place; the first keeps its direction."""
    first /= np.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    second -= (first[0] * second[0] + first[1] * second[1] + first[2] * second[2]) * first
    second /= np.sqrt(second[0] ** 2 + second[1] ** 2 + second[2] ** 2)


@compiled
def _principal_axes(moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of MᵀM (3,), the largest first, and its eigenvectors in columns (Jacobi's rotations)."""
    square, axes = np.zeros((3, 3)), np.eye(3)
    for k in range(3):
        for i in range(3):
            for j in range(3):
                square[i, j] += moment[k, i] * moment[k, j]
    size = square[0, 0] + square[1, 1] + square[2, 2]
    for _ in range(_SWEEPS):
        if abs(square[0, 1]) + abs(square[0, 2]) + abs(square[1, 2]) <= 1e-17 * size:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if square[p, q] != 0.0:
                    _rotate(square, axes, p, q)
    values, order = np.array([square[0, 0], square[1, 1], square[2, 2]]), np.arange(3)
    for p, q in ((0, 1), (1, 2), (0, 1)):
        if values[order[p]] < values[order[q]]:
            order[p], order[q] = order[q], order[p]
    return values[order], axes[:, order]


@compiled
def _rotate(square: FloatArray, axes: FloatArray, p: int, q: int) -> None:
    """Rotate a symmetric matrix (3, 3) and its axes, in place, so that the element (p, q) becomes 0."""
    ratio = (square[q, q] - square[p, p]) / (2 * square[p, q])
    tangent = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + np.sqrt(ratio**2 + 1))
    cosine = 1 / np.sqrt(tangent**2 + 1)
    sine = tangent * cosine
    for i in range(3):
        square[i, p], square[i, q] = (
            cosine * square[i, p] - sine * square[i, q],
            sine * square[i, p] + cosine * square[i, q],
        )
    for i in range(3):
        square[p, i], square[q, i] = (
            cosine * square[p, i] - sine * square[q, i],
            sine * square[p, i] + cosine * square[q, i],
        )
        axes[i, p], axes[i, q] = cosine * axes[i, p] - sine * axes[i, q], sine * axes[i, p] + cosine * axes[i, q]


@compiled
def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
