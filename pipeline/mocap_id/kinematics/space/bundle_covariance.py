"""Covariance of the parameters of a chain in space, including soft tissue.

The inverse of the normal matrix describes noise, which may persist over several frames. Soft tissue causes larger
errors, which are the same whenever the posture is the same. Three motions in proportion to the joint rotations are
therefore modelled: every marker slides, with a variance from the persistent part of its residual; every cluster rotates
on the bone; and every joint slides between clusters that slide as a whole. These motions are propagated through the
normal equations.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bundle import Bundle
from mocap_id.kinematics.space.bundle_model import joint_rotations, locate_columns
from mocap_id.kinematics.space.rigid_body import mean_rotation

_ANYWHERE = 0.1  # m; standard deviation of a centre along its hinge
_TURN = 0.5  # variance of the rotation of a cluster, relative to the persistent part of its residuals
_SLIDE = 0.4  # variance of the slides of a marker, relative to the persistent variance of its residual


def chain_covariance(bundle: Bundle) -> FloatArray:
    """Return the covariance (P, P) of the parameters of the chain; NaN if only the frames' unknowns were fitted."""
    if np.isnan(bundle.matrix).any():
        return bundle.matrix
    inverse = np.linalg.inv(bundle.matrix)
    problem, linear = bundle.problem, bundle.linear
    rows = 3 * len(problem.segment)
    frames = len(linear.off)
    by = np.concatenate([np.zeros((frames, rows, rows)), linear.by_chain[:, :rows]], axis=2)
    weights = np.repeat(problem.weights, 3, axis=1)
    by[:, np.arange(rows), np.arange(rows)] -= weights
    by -= linear.by_frame[:, :rows] @ bundle.reduced.gain
    by *= weights[..., None]
    lasting = bundle.sd**2 * np.maximum(1 - 1 / bundle.together, 0)
    turns = joint_rotations(problem, bundle.state)
    total = inverse
    sliding = _slide_derivatives(bundle)
    for j, parent in enumerate(problem.parents):
        shape = so3.log(mean_rotation(turns[:, j]).T @ turns[:, j])
        shape = shape - shape.mean(axis=0)
        values, vectors = np.linalg.eigh(shape.T @ shape / len(shape))
        shape = shape @ (vectors / np.sqrt(np.maximum(values, 1e-8)))  # with unit variance
        flat = (shape.T @ sliding.reshape(frames, -1)).reshape(-1, inverse.shape[0]) @ inverse
        total = total + _SLIDE * flat.T @ flat
        moved = (shape.T @ by.reshape(frames, -1)).reshape(-1, rows, inverse.shape[0]) @ inverse
        here = np.isin(problem.segment, [parent, j + 1])
        size = np.repeat(np.sqrt(_SLIDE * lasting * here), 3)
        flat = (moved * size[:, None]).reshape(-1, inverse.shape[0])
        total = total + flat.T @ flat
        for k in (parent, j + 1):
            flat = (_cluster_rotations(bundle, k, lasting) @ moved).reshape(-1, inverse.shape[0])
            total = total + _TURN * flat.T @ flat
    if bundle.prior is not None:
        flat = bundle.prior.axis_errors(problem, bundle.state) @ inverse
        total = total + flat.T @ flat
    return np.asarray(total + _hinge_covariance(bundle))


def _slide_derivatives(bundle: Bundle) -> FloatArray:
    """Return second derivatives (F, 3 J, P) of the cost by slides of J joints (as multiples of rms) and parameters."""
    problem, linear = bundle.problem, bundle.linear
    rows = slice(linear.off.shape[1] - 3 * len(problem.sliding), None)
    size = np.array([np.sqrt(np.mean(bundle.state.slides[:, j] ** 2)) for j in problem.sliding])
    weights = np.repeat(size / problem.slide_sd[problem.sliding], 3)
    return np.asarray(weights[:, None] * (linear.by_frame[:, rows] @ bundle.reduced.gain))


def _cluster_rotations(bundle: Bundle, k: int, lasting: FloatArray) -> FloatArray:
    """Return the displacements (3, 3 M) of a segment's markers in three independent rotations of typical size, m."""
    here = np.flatnonzero(bundle.problem.segment == k)
    share = float(np.sum(lasting[here]) / np.sum(bundle.sd[here] ** 2))
    sizes, axes = np.linalg.eigh(bundle.cluster_noise(k))
    about = bundle.state.local[here] - bundle.state.local[here].mean(axis=0)
    turns = np.zeros((3, len(bundle.sd), 3))
    turns[:, here] = np.cross(axes.T[:, None], about) * np.sqrt(share * sizes)[:, None, None]
    return turns.reshape(3, -1)


def _hinge_covariance(bundle: Bundle) -> FloatArray:
    """Return the covariance (P, P) from the arbitrary position of each hinge centre along its axis."""
    problem, state = bundle.problem, bundle.state
    cols = locate_columns(problem)
    total = np.zeros((cols.size, cols.size))
    for j, kind in enumerate(problem.kinds):
        if kind == "hinge":
            move = np.zeros(cols.size)
            move[cols.centre[j]] = state.first[j]
            for m in np.flatnonzero(problem.segment == j + 1):
                move[3 * m : 3 * m + 3] = -state.second[j]
            for i in np.flatnonzero(np.array(problem.parents) == j + 1):
                move[cols.centre[i]] = -state.second[j]
            total += _ANYWHERE**2 * np.outer(move, move)
    return total
