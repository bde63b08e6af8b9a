"""Rigid motions: SE(3), its Lie algebra, twists and wrenches in different frames (thesis 2.2.2, 2.2.3).

A pose g_AB is a homogeneous matrix (..., 4, 4) that maps coordinates in frame B to coordinates in frame A. A twist (v,
ω) and a wrench (F, τ) are (..., 6), with the linear part first. Leading axes are optional.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

_SMALL = 1e-2  # rad; the series are accurate to rounding below this angle, and the closed forms above it


def pose(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return the pose matrix of a rotation (..., 3, 3) and a position (..., 3), m (eq. 2.9, 2.16)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    g = np.zeros((*shape, 4, 4))
    g[..., :3, :3], g[..., :3, 3], g[..., 3, 3] = rotation, position, 1.0
    return g


def inverse(g: FloatArray) -> FloatArray:
    """Return the inverse of a pose (eq. 2.17)."""
    transposed = np.swapaxes(g[..., :3, :3], -1, -2)
    return pose(transposed, -(transposed @ g[..., :3, 3:])[..., 0])


def act(g: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points (..., 3) from frame B to frame A with the pose g = g_AB (eq. 2.8)."""
    return (g[..., :3, :3] @ points[..., None])[..., 0] + g[..., :3, 3]


def hat_twist(twist: FloatArray) -> FloatArray:
    """Return the matrix (..., 4, 4) of a twist in se(3) (eq. 2.19)."""
    twist = np.asarray(twist, dtype=np.float64)
    matrix = np.zeros((*twist.shape[:-1], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3] = so3.hat(twist[..., 3:]), twist[..., :3]
    return matrix


def vee_twist(matrix: FloatArray) -> FloatArray:
    """Return the twist of a matrix in se(3); the inverse of :func:`hat_twist`."""
    return np.concatenate([matrix[..., :3, 3], so3.vee(matrix[..., :3, :3])], axis=-1)


def exp_twist(twist: FloatArray) -> FloatArray:
    """Return the pose after a motion with a constant twist (m, rad; ξθ in the thesis) for unit time (eq. 2.20)."""
    twist = np.asarray(twist, dtype=np.float64)
    v, omega = twist[..., :3], twist[..., 3:]
    angle = np.linalg.norm(omega, axis=-1)[..., None]
    _, second = so3.exp_coefficients(angle)
    small = np.abs(angle) < _SMALL
    safe = np.where(small, 1.0, angle)
    third = np.where(small, 1 / 6 - angle**2 / 120 + angle**4 / 5040, (safe - np.sin(safe)) / safe**3)  # (θ - sin θ)/θ³
    once = np.cross(omega, v)
    position = v + second * once + third * np.cross(omega, once)
    return pose(so3.exp(omega), position)


def Ad(g: FloatArray) -> FloatArray:
    """Return the adjoint (..., 6, 6) of a pose g_AB, which maps twists in B to twists in A (eq. 2.33, 2.34)."""
    rotation, position = g[..., :3, :3], g[..., :3, 3]
    matrix = np.zeros((*g.shape[:-2], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = rotation
    matrix[..., :3, 3:] = so3.hat(position) @ rotation
    return matrix


def ad(twist: FloatArray) -> FloatArray:
    """Return the matrix (..., 6, 6) of the Lie bracket with a twist (eq. 2.35, 2.36).

    ``hat_twist(ad(a) @ b) == hat_twist(a) @ hat_twist(b) - hat_twist(b) @ hat_twist(a)``
    """
    twist = np.asarray(twist, dtype=np.float64)
    matrix = np.zeros((*twist.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = so3.hat(twist[..., 3:])
    matrix[..., :3, 3:] = so3.hat(twist[..., :3])
    return matrix


def move_wrench(g: FloatArray, wrench: FloatArray) -> FloatArray:
    """Transform wrenches from frame B to frame A with the pose g = g_AB; moments are about the origin of each frame.

    The matrix is the transposed adjoint of the inverse pose (eq. 2.54 in the form of 2.57), so the power of the wrench,
    its product with the twist, is the same in both frames.
    """
    return (np.swapaxes(Ad(inverse(g)), -1, -2) @ wrench[..., None])[..., 0]
