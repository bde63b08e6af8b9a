"""Covariance of the parameters of a chain in space, with soft tissue.

The inverse of the normal matrix holds noise, with the number of frames that share one error. Soft tissue does worse: it
has the same error whenever the posture is the same, and moves in step with the joints. Every marker is therefore let
slide in proportion to each component of the rotation of its joints, with a variance from the lasting part of its
residual. The slides are carried through the normal equations.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bundle import Bundle
from mocap_id.kinematics.space.bundle_equations import joint_rotations
from mocap_id.kinematics.space.joint_kinds import middle_rotation

_SLIDE = 0.4  # variance of the slides of a marker, as a multiple of the lasting variance of its residual


def chain_covariance(bundle: Bundle) -> FloatArray:
    """Return the covariance (P, P) of the parameters of a solved bundle."""
    inverse = np.linalg.inv(bundle.matrix)
    problem, linear = bundle.problem, bundle.linear
    rows = 3 * len(problem.segment)
    frames = len(linear.off)
    by = np.concatenate([np.zeros((frames, rows, rows)), linear.by_chain[:, :rows]], axis=2)
    weights = np.repeat(linear.root, 3, axis=1)
    by[:, np.arange(rows), np.arange(rows)] -= weights
    by -= linear.by_frame[:, :rows] @ bundle.reduced.gain
    by *= weights[..., None]
    lasting = bundle.sd**2 * np.maximum(1 - 1 / bundle.together, 0)
    turns = joint_rotations(problem, bundle.state)
    total = inverse
    for j, parent in enumerate(problem.parents):
        shape = so3.log(middle_rotation(turns[:, j]).T @ turns[:, j])
        shape = shape - shape.mean(axis=0)
        shape = shape @ _whitening(shape)
        moved = (shape.T @ by.reshape(frames, -1)).reshape(-1, rows, inverse.shape[0]) @ inverse
        here = np.isin(problem.segment, [parent, j + 1])
        size = np.repeat(np.sqrt(_SLIDE * lasting * here), 3)
        flat = (moved * size[:, None]).reshape(-1, inverse.shape[0])
        total = total + flat.T @ flat
    return np.asarray(total)


def _whitening(shape: FloatArray) -> FloatArray:
    """Return the matrix that gives the components of rotations (F, 3) unit variance."""
    values, vectors = np.linalg.eigh(shape.T @ shape / len(shape))
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1e-8)))
