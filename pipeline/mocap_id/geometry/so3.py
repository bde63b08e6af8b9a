"""Rotations: SO(3) and its Lie algebra (thesis 2.2.1).

Functions accept any leading axes: vectors are (..., 3), matrices (..., 3, 3). The length of a rotation vector is its
angle in rad: ωθ with a unit vector ω in the thesis is one vector here.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray


def hat(omega: FloatArray) -> FloatArray:
    """Return the skew-symmetric matrix of a vector: ``hat(u) @ v == cross(u, v)`` (eq. 2.11, 2.14)."""
    x, y, z = np.moveaxis(np.asarray(omega, dtype=np.float64), -1, 0)
    matrix = np.zeros((*x.shape, 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def vee(matrix: FloatArray) -> FloatArray:
    """Return the vector of a skew-symmetric matrix; the inverse of :func:`hat`. The symmetric part is ignored."""
    skew = (matrix - np.swapaxes(matrix, -1, -2)) / 2
    return np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def exp_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sin θ / θ and (1 - cos θ) / θ², exact to rounding at every angle including zero.

    The second uses the half angle, which avoids the difference of nearly equal numbers.
    """
    return np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2


def exp(omega: FloatArray) -> FloatArray:
    """Return the rotation by ``|omega|`` rad about ``omega`` by Rodrigues' formula (eq. 2.12, 2.13).

    Parameters
    ----------
    omega : (..., 3) array
        Rotation vector, rad.

    Returns
    -------
    (..., 3, 3) array
        Rotation matrix.
    """
    omega = np.asarray(omega, dtype=np.float64)
    first, second = exp_coefficients(np.linalg.norm(omega, axis=-1)[..., None, None])
    cross = hat(omega)
    return np.eye(3) + first * cross + second * (cross @ cross)


def log(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector of a rotation matrix, of length 0 to π; the inverse of :func:`exp`.

    The computation uses the unit quaternion and starts from its largest component, so it is accurate both near zero and
    near π. At exactly π the sign of the axis is arbitrary.

    Parameters
    ----------
    rotation : (..., 3, 3) array

    Returns
    -------
    (..., 3) array
        Rotation vector, rad.
    """
    either = quaternion(np.asarray(rotation, dtype=np.float64))
    positive = np.where(either[..., :1] < 0, -either, either)
    scalar, vector = positive[..., 0], positive[..., 1:]
    length = np.linalg.norm(vector, axis=-1)
    turned = length > 0
    safe = np.where(turned, length, 1.0)
    scale = np.where(turned, 2 * np.arctan2(length, scalar) / safe, 2.0)
    return vector * scale[..., None]


def quaternion(rotation: FloatArray) -> FloatArray:
    """Return the unit quaternion (..., 4), scalar first, with arbitrary sign."""
    trace = np.trace(rotation, axis1=-2, axis2=-1)
    diagonal = np.diagonal(rotation, axis1=-2, axis2=-1)
    outer = np.empty((*trace.shape, 4, 4))  # 4 q qᵀ: every row is proportional to q
    outer[..., 0, 0] = 1 + trace
    outer[..., 1:, 0] = outer[..., 0, 1:] = 2 * vee(rotation)
    outer[..., 1:, 1:] = rotation + np.swapaxes(rotation, -1, -2)
    axis = np.arange(1, 4)
    outer[..., axis, axis] = 1 + 2 * diagonal - trace[..., None]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row: FloatArray = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    unit: FloatArray = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return unit
