"""Rigid-body motions: SE(3), its Lie algebra, and how twists and wrenches move between frames (thesis 2.2.2, 2.2.3).

Functions take any leading axes. Poses are homogeneous matrices (..., 4, 4), where g_AB takes coordinates in B to
coordinates in A. A twist is (v, ω), a wrench (F, τ), both (..., 6): linear part first.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3


def pose(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Homogeneous matrix (..., 4, 4) of a rotation (..., 3, 3) and a position (..., 3), m (eq. 2.9, 2.16)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    g = np.zeros((*shape, 4, 4))
    g[..., :3, :3], g[..., :3, 3], g[..., 3, 3] = rotation, position, 1.0
    return g


def inverse(g: FloatArray) -> FloatArray:
    """Inverse of a pose (eq. 2.17)."""
    transposed = np.swapaxes(g[..., :3, :3], -1, -2)
    return pose(transposed, -(transposed @ g[..., :3, 3:])[..., 0])


def act(g: FloatArray, points: FloatArray) -> FloatArray:
    """Coordinates in A of points (..., 3) given in B, for g = g_AB (eq. 2.8)."""
    return (g[..., :3, :3] @ points[..., None])[..., 0] + g[..., :3, 3]


def hat(twist: FloatArray) -> FloatArray:
    """Matrix (..., 4, 4) of a twist (eq. 2.19)."""
    twist = np.asarray(twist, dtype=np.float64)
    matrix = np.zeros((*twist.shape[:-1], 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3] = so3.hat(twist[..., 3:]), twist[..., :3]
    return matrix


def vee(matrix: FloatArray) -> FloatArray:
    """Twist of an element of se(3), the inverse of :func:`hat`."""
    return np.concatenate([matrix[..., :3, 3], so3.vee(matrix[..., :3, :3])], axis=-1)


def exp(twist: FloatArray) -> FloatArray:
    """Motion along a twist for unit time (eq. 2.20).

    Parameters
    ----------
    twist : (..., 6) array
        (v, ω), m and rad; ξθ of the thesis.

    Returns
    -------
    (..., 4, 4) array
        Pose.
    """
    twist = np.asarray(twist, dtype=np.float64)
    v, omega = twist[..., :3], twist[..., 3:]
    angle = np.linalg.norm(omega, axis=-1)[..., None]
    _, second = so3.exp_coefficients(angle)
    once = np.cross(omega, v)
    position = v + second * once + _third_coefficient(angle) * np.cross(omega, once)
    return pose(so3.exp(omega), position)


def log(g: FloatArray) -> FloatArray:
    """Twist whose :func:`exp` is this pose, with a rotation of 0 … π.

    Parameters
    ----------
    g : (..., 4, 4) array

    Returns
    -------
    (..., 6) array
        (v, ω), m and rad.
    """
    omega, position = so3.log(g[..., :3, :3]), g[..., :3, 3]
    angle = np.linalg.norm(omega, axis=-1)[..., None]
    once = np.cross(omega, position)
    v = position - once / 2 + _log_coefficient(angle) * np.cross(omega, once)
    return np.concatenate([v, omega], axis=-1)


def Ad(g: FloatArray) -> FloatArray:
    """Adjoint (..., 6, 6) of a pose: takes twists in B to twists in A for g = g_AB (eq. 2.33, 2.34)."""
    rotation, position = g[..., :3, :3], g[..., :3, 3]
    matrix = np.zeros((*g.shape[:-2], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = rotation
    matrix[..., :3, 3:] = so3.hat(position) @ rotation
    return matrix


def ad(twist: FloatArray) -> FloatArray:
    """Matrix (..., 6, 6) of the Lie bracket (eq. 2.35, 2.36).

    ``hat(ad(a) @ b) == hat(a) @ hat(b) - hat(b) @ hat(a)``
    """
    twist = np.asarray(twist, dtype=np.float64)
    matrix = np.zeros((*twist.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = so3.hat(twist[..., 3:])
    matrix[..., :3, 3:] = so3.hat(twist[..., :3])
    return matrix


def move_twist(g: FloatArray, twist: FloatArray) -> FloatArray:
    """Twist (..., 6) of B seen in A, for g = g_AB (eq. 2.38)."""
    return (Ad(g) @ twist[..., None])[..., 0]


def move_wrench(g: FloatArray, wrench: FloatArray) -> FloatArray:
    """Wrench (..., 6) about B's origin in B's axes, taken to A's origin and axes, for g = g_AB.

    The map is the transpose of the adjoint of the *inverse* pose (eq. 2.54 as 2.57 has it), so that power, the product
    of twist and wrench, is the same in both frames.
    """
    return (np.swapaxes(Ad(inverse(g)), -1, -2) @ wrench[..., None])[..., 0]


_SMALL = 1e-2  # below this angle the series are exact to rounding; above it, so are the closed forms


def _third_coefficient(angle: FloatArray) -> FloatArray:
    """(θ - sin θ) / θ³."""
    small = np.abs(angle) < _SMALL
    safe = np.where(small, 1.0, angle)
    return np.where(small, 1 / 6 - angle**2 / 120 + angle**4 / 5040, (safe - np.sin(safe)) / safe**3)


def _log_coefficient(angle: FloatArray) -> FloatArray:
    """(1 - (θ/2) cot(θ/2)) / θ²."""
    small = np.abs(angle) < _SMALL
    safe = np.where(small, 1.0, angle)
    closed = (1 - safe / 2 * np.cos(safe / 2) / np.sin(safe / 2)) / safe**2
    return np.where(small, 1 / 12 + angle**2 / 720 + angle**4 / 30240, closed)
