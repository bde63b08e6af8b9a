"""Rates, accelerations and uncertainty of joint coordinates, from the rotation of the joint.

The coordinates q rotate the child about d axes b_i, which are given here in the child's frame:

    omega = B(q) dq,   alpha = B(q) ddq + dB/dt dq,   B = [b_1 … b_d]

All equations are valid for any B. The errors of rotation, angular velocity and angular acceleration are propagated to
q, dq and ddq with the first and second derivatives of B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3


@dataclass(frozen=True)
class RelativeMotion:
    """Motion of a child segment relative to its parent.

    The error of the rotation is the vector e of ``true = R exp(e)``, in the child's axes.
    """

    rotation: FloatArray  # (F, 3, 3) R, child to parent
    velocity: FloatArray  # (F, 3) angular velocity in the child's axes, rad/s
    acceleration: FloatArray  # (F, 3) derivative of this vector, rad/s²
    covariance: FloatArray  # (F, 9, 9) covariance of the errors of rotation, velocity and acceleration


def compose_motions(first: RelativeMotion, second: RelativeMotion) -> RelativeMotion:
    """Return the motion of a grandchild relative to its grandparent, from two successive motions.

    With the rotation R of ``second``, omega = R^T omega_1 + omega_2 and alpha = R^T alpha_1 + (R^T omega_1) x omega_2 +
    alpha_2. The errors of the two motions are assumed to be independent.
    """
    back = np.swapaxes(second.rotation, 1, 2)
    carried = np.einsum("fij,fj->fi", back, first.velocity)
    lever = np.zeros((len(back), 9, 9))
    for i in range(3):
        lever[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = back
    lever[:, 6:, 3:6] = -so3.hat(second.velocity) @ back
    return RelativeMotion(
        first.rotation @ second.rotation,
        carried + second.velocity,
        np.einsum("fij,fj->fi", back, first.acceleration) + np.cross(carried, second.velocity) + second.acceleration,
        lever @ first.covariance @ np.swapaxes(lever, 1, 2) + second.covariance,
    )


@dataclass(frozen=True)
class AxisDerivatives:
    """Matrix B of a joint, whose columns are the axes b_i, and its derivatives with respect to the coordinates."""

    axes: FloatArray  # (F, 3, d) B
    first: FloatArray  # (F, 3, d, d) derivative of column i with respect to q_k at [:, :, i, k]
    second: FloatArray  # (F, 3, d, d, d) derivative of column i with respect to q_k and q_l at [:, :, i, k, l]


def axes_of_rotations(turns: FloatArray, q: FloatArray, offsets: FloatArray | None = None) -> AxisDerivatives:
    """Return B of successive rotations, ``R = exp(a_1 q_1) O_1 exp(a_2 q_2) O_2 … exp(a_d q_d)``.

    Later coordinates rotate an axis in the child's frame: db_i/dq_k = b_i × b_k for k > i, and zero otherwise.
    ``turns`` (d, 3) are the unit axes a_i, q (F, d) the coordinates, rad, and ``offsets`` (d - 1, 3, 3) the constant
    rotations O_i (identity by default).
    """
    count, dimension = q.shape
    axes, later = np.empty((count, 3, dimension)), np.broadcast_to(np.eye(3), (count, 3, 3))
    for i in reversed(range(dimension)):
        axes[:, :, i] = np.einsum("fji,j->fi", later, turns[i])
        later = so3.exp(q[:, i : i + 1] * turns[i]) @ later
        if offsets is not None and i > 0:
            later = offsets[i - 1] @ later
    first = np.zeros((count, 3, dimension, dimension))
    second = np.zeros((count, 3, dimension, dimension, dimension))
    pairs = [(i, k) for i in range(dimension) for k in range(i + 1, dimension)]
    for i, k in pairs:
        first[:, :, i, k] = _cross(axes[:, :, i], axes[:, :, k])
    for i, k in pairs:
        for j in range(i + 1, dimension):
            bent = _cross(first[:, :, i, j], axes[:, :, k])
            second[:, :, i, k, j] = bent + _cross(axes[:, :, i], first[:, :, k, j]) if j > k else bent
    return AxisDerivatives(axes, first, second)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b of arrays (F, 3), faster than ``numpy.cross``."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def axes_of_rotation_vector(q: FloatArray) -> AxisDerivatives:
    """Return the matrix B (ω = B dq/dt) and its derivatives for ``R = exp(q)`` with a rotation vector q (F, 3), rad.

    B = 1 - a(s) q^ + c(s) q^ q^, where q^ is the cross-product matrix of q. Further,
    s = |q|², a = (1 - cos |q|) / s and c = (|q| - sin |q|) / |q|³.
    """
    a, c = _sum_series(np.sum(q**2, axis=1))
    cross, unit = so3.hat(q), so3.hat(np.eye(3))
    square = cross @ cross
    mixed = np.einsum("kij,fjl->fkil", unit, cross) + np.einsum("fij,kjl->fkil", cross, unit)
    pair = np.einsum("kij,ljm->klim", unit, unit)
    pair = pair + np.swapaxes(pair, 0, 1)
    axes = np.eye(3) - a[0][:, None, None] * cross + c[0][:, None, None] * square
    step = 2 * q
    a0, c0 = a[0][:, None, None, None], c[0][:, None, None, None]
    da, dc = (a[1][:, None] * step)[:, :, None, None], (c[1][:, None] * step)[:, :, None, None]
    first = -da * cross[:, None] - a0 * unit + dc * square[:, None] + c0 * mixed
    outer = step[:, :, None] * step[:, None, :]
    dda = a[2][:, None, None] * outer + 2 * a[1][:, None, None] * np.eye(3)
    ddc = c[2][:, None, None] * outer + 2 * c[1][:, None, None] * np.eye(3)
    second = -dda[..., None, None] * cross[:, None, None] + ddc[..., None, None] * square[:, None, None]
    second = second + c0[..., None] * pair
    second = second - da[:, :, None] * unit[None, None] - da[:, None, :] * unit[None, :, None]
    second = second + dc[:, :, None] * mixed[:, None] + dc[:, None, :] * mixed[:, :, None]
    return AxisDerivatives(axes, np.einsum("fkim->fimk", first), np.einsum("fklim->fimkl", second))


def _sum_series(square: FloatArray) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
    """Return a(s) and c(s) of :func:`axes_of_rotation_vector`, each with its first two derivatives, by power series."""
    terms = 40
    results = []
    for shift in (2, 3):
        values = [np.zeros_like(square) for _ in range(3)]
        factor = 1.0 / np.prod(np.arange(1, shift + 1))
        powers = [np.ones_like(square)]
        for n in range(terms):
            values[0] += factor * powers[n]
            if n > 0:
                values[1] += factor * n * powers[n - 1]
            if n > 1:
                values[2] += factor * n * (n - 1) * powers[n - 2]
            powers.append(powers[n] * square)
            factor /= -(2 * n + shift + 1) * (2 * n + shift + 2)
        results.append((values[0], values[1], values[2]))
    return tuple(results)


def compute_rates(axes: AxisDerivatives, motion: RelativeMotion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rates, accelerations, and the Jacobian of the coordinates with respect to the errors of the motion.

    The rates dq (F, d), rad/s, and the accelerations ddq (F, d), rad/s², are NaN where two axes coincide. The Jacobian
    (F, 3 d, 9) contains the derivatives of (q, dq, ddq) with respect to the errors of rotation, velocity and
    acceleration.
    """
    inverse = _invert_axes(axes.axes)
    rate = np.einsum("fki,fi->fk", inverse, motion.velocity)
    swept = np.einsum("fxik,fk->fxi", axes.first, rate)  # dB/dt
    held = np.einsum("fxik,fi->fxk", axes.first, rate)
    rest = motion.acceleration - np.einsum("fxi,fi->fx", swept, rate)
    acceleration = np.einsum("fki,fi->fk", inverse, rest)
    bend = np.einsum("fxik,fi->fxk", axes.first, acceleration)
    bend = bend + np.einsum("fxikl,fk,fi->fxl", axes.second, rate, rate)
    dimension = rate.shape[1]
    jacobian = np.zeros((len(rate), 3 * dimension, 9))
    angle, speed, change = (jacobian[:, i * dimension : (i + 1) * dimension] for i in range(3))
    angle[:, :, :3] = inverse
    speed[:, :, :3] = -inverse @ held @ inverse
    speed[:, :, 3:6] = inverse
    change[:, :, :3] = -inverse @ (bend @ inverse + (held + swept) @ speed[:, :, :3])
    change[:, :, 3:6] = -inverse @ (held + swept) @ inverse
    change[:, :, 6:] = inverse
    return rate, acceleration, jacobian


def _invert_axes(axes: FloatArray) -> FloatArray:
    """Return the pseudo-inverse (F, d, 3) of B (the inverse for d = 3); NaN where the columns of B are dependent."""
    square = np.swapaxes(axes, 1, 2) @ axes
    usable = np.asarray(np.isfinite(square).all(axis=(1, 2)))
    usable &= np.linalg.det(np.where(usable[:, None, None], square, 0.0)) > 1e-16
    inverse = np.full((len(axes), axes.shape[2], 3), np.nan)
    inverse[usable] = np.linalg.solve(square[usable], np.swapaxes(axes[usable], 1, 2))
    return inverse


def frame_error_jacobian(motion: RelativeMotion) -> FloatArray:
    """Return the derivatives (F, 9, 6) of a relative motion with respect to constant errors of the two segment frames.

    The errors are the rotation vectors of the parent's and of the child's frame, each in its own axes, rad.
    """
    lever = np.zeros((len(motion.rotation), 9, 6))
    lever[:, :3, :3] = -np.swapaxes(motion.rotation, 1, 2)
    lever[:, :3, 3:] = np.eye(3)
    lever[:, 3:6, 3:] = so3.hat(motion.velocity)
    lever[:, 6:, 3:] = so3.hat(motion.acceleration)
    return lever


def propagate_covariance(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return standard deviations (..., k) from a Jacobian (..., k, m) and a covariance (..., m, m)."""
    variance = np.sum((jacobian @ covariance) * jacobian, axis=-1)
    return np.asarray(np.sqrt(np.maximum(variance, 0)))
