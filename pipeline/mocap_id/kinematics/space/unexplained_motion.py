"""Motion of markers in their body that the joints next to the body do not explain.

Skin slides with the joints next to it, so its motion is a function of their angles. An undetected joint inside the body
moves independently. The motion that remains after a regression on the joint angles distinguishes the two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bodies import LEAST, SpatialBody, subtract_means
from mocap_id.kinematics.space.rigid_body import mean_rotation

_RIDGE = 1e-3  # ridge of the regression, whose terms have unit variance
_TURNS = 0.09  # rad rms; smaller rotations are not used, because an undetected joint in the body also causes them
_FLOOR = 0.5e-3  # m; smaller residuals do not increase a gain


def unexplained_motion(
    points: FloatArray, body: SpatialBody, neighbours: Sequence[SpatialBody]
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of a body's markers in its frame that rotations relative to its neighbours do not explain.

    The motion (F, k, 3), m, is 0 where missing; the mean position (k, 3) of each marker, m, is also returned. The
    motion is regressed on the components of each rotation vector relative to a neighbour, and on their products.
    Neighbours are bodies that joints connect with the body. Trajectories (F, M, 3) are in the lab, m.
    """
    off, shape, _ = subtract_means(body.local(points[:, body.markers]))
    terms = np.concatenate([np.ones((len(off), 1)), *(_posture_terms(body, other) for other in neighbours)], axis=1)
    known = np.isfinite(terms).all(axis=1)
    seen = np.isfinite(points[:, body.markers, 0]) & known[:, None]
    motion = np.zeros_like(off)
    counts, size = seen.sum(axis=0), terms.shape[1]
    penalty = _RIDGE * np.diag([0.0, *np.ones(size - 1)])
    enough = np.flatnonzero(counts > size)
    if enough.size:
        given = np.where(known[:, None], terms, 0.0)
        weight, moved = seen[:, enough].T.astype(np.float64), np.where(seen[..., None], off, 0.0)[:, enough]
        products = (given[:, :, None] * given[:, None]).reshape(len(given), -1)
        normal = (weight @ products).reshape(-1, size, size) + counts[enough, None, None] * penalty
        explained = np.linalg.solve(
            normal, np.swapaxes((given.T @ moved.reshape(len(moved), -1)).reshape(size, -1, 3), 0, 1)
        )
        motion[:, enough] = np.where(seen[:, enough, None], moved - np.swapaxes(given @ explained, 0, 1), 0.0)
    return motion, shape


def gain_of_parts(motion: FloatArray, shape: FloatArray, parts: Sequence[IntArray]) -> float:
    """Return the sum over all markers of log(residual with one common rigid motion / residual with one each).

    All motions are small. "One each" is one motion for each of the ``parts``, which are arrays of marker indices.
    ``motion`` and ``shape`` are results of :func:`unexplained_motion`.
    """
    together = _without_pose(motion, shape)
    apart = np.empty_like(together)
    for part in parts:
        apart[part] = _without_pose(motion[:, part], shape[part])
    return float(np.sum(np.log((together**2 + _FLOOR**2) / (apart**2 + _FLOOR**2))) / 2)


def unexplained_residuals(points: FloatArray, body: SpatialBody, neighbours: Sequence[SpatialBody]) -> FloatArray:
    """Return the rms (k,) of the unexplained motion of a body's markers, without rigid motion of the body, m."""
    return _without_pose(*unexplained_motion(points, body, neighbours))


def unexplained_distance_sd(motion: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the standard deviation (k, k) of mutual distances by the motion of :func:`unexplained_motion`, m."""
    along = shape[:, None] - shape
    along /= np.maximum(np.linalg.norm(along, axis=2), 1e-9)[..., None]
    change = np.einsum("fijc,ijc->fij", motion[:, :, None] - motion[:, None], along)
    return np.asarray(np.sqrt(np.mean(change**2, axis=0)))


def _posture_terms(body: SpatialBody, other: SpatialBody) -> FloatArray:
    """Return the components of the relative rotation vector and their products (F, 9), scaled to unit variance.

    The components are along the principal axes of the rotation; small ones are set to 0.
    """
    turn = np.swapaxes(other.rotation, 1, 2) @ body.rotation
    known = np.isfinite(turn[:, 0, 0])
    terms = np.full((len(turn), 9), np.nan)
    if known.any():
        vector = so3.log(mean_rotation(turn[known]).T @ turn[known])
        _, axes = np.linalg.eigh(np.cov(vector.T))
        vector = vector @ axes
        size = vector.std(axis=0)
        vector = np.where(size >= _TURNS, vector / np.maximum(size, _TURNS), 0.0)
        first, second = np.triu_indices(3)
        terms[known] = np.concatenate([vector, vector[:, first] * vector[:, second]], axis=1)
        terms[known] -= terms[known].mean(axis=0)
    return terms


def _without_pose(motion: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the rms (k,) of motion (F, k, 3) without its rigid-body part (6 degrees of freedom), m."""
    count = len(shape)
    centred = shape - shape.mean(axis=0)
    pose = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), so3.hat(centred)], axis=2).reshape(3 * count, 6)
    basis, _ = np.linalg.qr(pose)
    flat = motion.reshape(len(motion), 3 * count)
    left = flat - (flat @ basis) @ basis.T
    square = np.sum(left.reshape(motion.shape) ** 2, axis=(0, 2))
    freedom = 3 * max(count, LEAST)
    seen = np.maximum(np.any(motion != 0, axis=2).sum(axis=0), 1)
    return np.asarray(np.sqrt(square / seen * freedom / (freedom - 6)))
