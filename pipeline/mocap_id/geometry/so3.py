"""Rotations: SO(3) and its Lie algebra (thesis 2.2.1).

Vectors are (..., 3) and matrices (..., 3, 3); leading axes are optional. The length of a rotation vector is its angle
in rad. It is the product ωθ of the thesis, in which ω is a unit vector.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray


def hat(omega: FloatArray) -> FloatArray:
    """Return the skew-symmetric matrix of a vector, so that ``hat(u) @ v == cross(u, v)`` (eq. 2.11, 2.14)."""
    x, y, z = np.moveaxis(np.asarray(omega, dtype=np.float64), -1, 0)
    matrix = np.zeros((*x.shape, 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def vee(matrix: FloatArray) -> FloatArray:
    """Return the vector of a skew-symmetric matrix; the inverse of :func:`hat`. A symmetric part is ignored."""
    skew = (matrix - np.swapaxes(matrix, -1, -2)) / 2
    return np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def exp_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sin θ / θ and (1 - cos θ) / θ², accurate to rounding at every angle, also at zero.

    The second coefficient uses the half angle, which avoids the difference of nearly equal numbers.
    """
    return np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2


def exp(omega: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector, rad, by Rodrigues' formula (eq. 2.12, 2.13)."""
    omega = np.asarray(omega, dtype=np.float64)
    first, second = exp_coefficients(np.linalg.norm(omega, axis=-1)[..., None, None])
    cross = hat(omega)
    return np.eye(3) + first * cross + second * (cross @ cross)


def log(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector, rad, of a rotation matrix; the inverse of :func:`exp`. The vector's length is 0 to π.

    The unit quaternion is computed from its largest component, so the result is accurate near zero and near π. At
    exactly π the sign of the axis is arbitrary.
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
    """Return the unit quaternion (..., 4) of a rotation matrix, scalar first, with arbitrary sign."""
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


def shift_to_shortest_arc(angles: FloatArray) -> FloatArray:
    """Return angles (K,), rad, shifted by multiples of 2π so that they lie on their shortest common arc, near zero.

    This corrects angles that were unwrapped through a gap or a singular pose, which can shift them by multiples of 2π.

    Examples
    --------
    >>> np.degrees(shift_to_shortest_arc(np.radians([350.0, 20.0, 380.0]))).round(6)
    array([-10.,  20.,  20.])
    """
    turn = 2 * np.pi
    wrapped = np.mod(angles, turn)
    around = np.sort(wrapped)
    gaps = np.diff(around, append=around[0] + turn)
    start = around[(int(gaps.argmax()) + 1) % len(around)]
    on_arc = np.mod(wrapped - start, turn) + start
    turns = np.round((on_arc.min() + on_arc.max()) / 2 / turn)
    return np.asarray(on_arc - turn * turns)
