"""Pseudo-inertia: the 4 × 4 matrix of a body's moments, positive semidefinite if and only if the body can exist.

With the second moments Σ = ∫ x xᵀ dm it is [[Σ, m c], [m cᵀ, m]] (Wensing, Kim and Slotine 2018, Linear Matrix
Inequalities for Physically Consistent Inertial Parameter Identification). The matrix of moments of inertia is tr(Σ) 1 -
Σ.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # matrix entries of Ixx, Iyy, Izz, Ixy, Ixz, Iyz


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the pseudo-inertia (..., 4, 4) of ten parameters (..., 10), kg, kg·m and kg·m²."""
    inertia = np.zeros((*parameters.shape[:-1], 3, 3))
    for value, (i, j) in zip(np.moveaxis(parameters[..., 4:], -1, 0), _ENTRIES, strict=True):
        inertia[..., i, j] = inertia[..., j, i] = value
    matrix = np.zeros((*parameters.shape[:-1], 4, 4))
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    matrix[..., :3, :3] = trace / 2 * np.eye(3) - inertia
    matrix[..., :3, 3] = matrix[..., 3, :3] = parameters[..., 1:4]
    matrix[..., 3, 3] = parameters[..., 0]
    return matrix


def body_parameters(matrix: FloatArray) -> FloatArray:
    """Return the ten parameters (..., 10) of a pseudo-inertia (..., 4, 4); the inverse of :func:`pseudo_inertia`."""
    second = matrix[..., :3, :3]
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    entries = np.stack([inertia[..., i, j] for i, j in _ENTRIES], axis=-1)
    return np.concatenate([matrix[..., 3:, 3], matrix[..., :3, 3], entries], axis=-1)


def point_mass(position: FloatArray) -> FloatArray:
    """Return the ten parameters (10,) of 1 kg at a point (3,), m."""
    at = np.append(position, 1.0)
    return body_parameters(np.outer(at, at))


def change_of_frame(pose: FloatArray) -> FloatArray:
    """Return the matrix (..., 10, 10) that transforms a body's ten parameters into another frame.

    ``pose`` (..., 4, 4) is the pose of the present frame in the other frame.
    """
    units = pseudo_inertia(np.eye(10))
    moved = pose[..., None, :, :] @ units @ np.swapaxes(pose, -1, -2)[..., None, :, :]
    return np.swapaxes(body_parameters(moved), -1, -2)
