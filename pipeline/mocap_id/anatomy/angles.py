"""Angles of shoulder, elbow and wrist (ISB: Wu 2005) and coordinates of other joints, with standard deviations.

Rotations are from child to parent, for a right arm:

    shoulder  R_y(plane) R_x(-elevation) R_y(axial)         elevation 0 to π; plane 0: abduction, π/2: forward
    elbow     R_z(flexion) R_x(carrying) R_y(pronation)     carrying is negative at a normal elbow
    wrist     R_z(flexion) R_x(deviation) R_y(rest)         R_y(rest) is not a wrist angle and is left out

The filter works on rotations (SO(3)). They are decomposed into angles afterwards, so no angle is ever filtered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint

SHOULDER = ("shoulder_plane", "shoulder_elevation", "shoulder_axial")
ELBOW = ("elbow_flexion", "elbow_carrying", "elbow_pronation")
WRIST = ("wrist_flexion", "wrist_deviation")

GIMBAL = float(np.sin(np.radians(15)))
"""Least sine of the elevation at which plane and axial rotation are defined separately."""

_TERMS = 40  # of a power series
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True)
class JointAngles:
    """Angles of one joint over time, with standard deviations.

    Errors of the anatomical frames shift the mean of an angle (``constant_sd``) and change its course over time
    (included in ``sd``). The standard deviation of an absolute angle is ``hypot(sd, constant_sd)``.
    """

    names: tuple[str, ...]  # names of the k angles
    angle: FloatArray  # (F, k) continuous in time, rad
    rate: FloatArray  # (F, k) rad/s
    acceleration: FloatArray  # (F, k) rad/s²
    sd: FloatArray  # (F, k) standard deviation of changes of the angles, from motion and frames, rad
    sd_rate: FloatArray  # (F, k) rad/s
    sd_acceleration: FloatArray  # (F, k) rad/s²
    constant_sd: FloatArray  # (k,) uncertainty of the mean angles from the frames, rad
    condition: FloatArray  # (F,) amplification of errors: 1/|sin elevation|, 1/|cos carrying|, else 1
    near_gimbal: BoolArray  # (F,) samples within 15° of the pose in which two angles are not defined separately


def shoulder_angles(motion: RelativeMotion, frames: FloatArray | None = None) -> JointAngles:
    """Return plane of elevation, elevation and axial rotation of the upper arm in the thorax.

    The elevation is never negative. Near an elevation of 0, only the sum of plane and axial rotation is defined; near
    π, only their difference. This sum or difference is continuous in time. When the arm passes through one of these
    poles, the plane of elevation may jump by up to π, and the axial rotation changes so that the sum or difference does
    not jump. In the first sample away from the poles, both angles lie in (-π, π]. ``frames`` (6, 6) is the covariance
    of the errors of both segment frames, rad² (:func:`~mocap_id.anatomy.frames.frame_covariance`). Without it, the
    frames are assumed to be exact.
    """
    r = motion.rotation
    elevation = np.arctan2(np.hypot(r[:, 0, 1], r[:, 2, 1]), r[:, 1, 1])
    plane, axial = np.arctan2(-r[:, 0, 1], -r[:, 2, 1]), np.arctan2(-r[:, 1, 0], r[:, 1, 2])
    sine = np.sin(elevation)

    # near a pole, only the sum or difference of plane and axial rotation is free of jumps
    seen, meaningful = np.isfinite(plane), sine >= GIMBAL
    plane = _unwrap(plane, meaningful)
    if seen.any():
        p, a = plane[seen], axial[seen]
        sign = np.where((elevation[seen][1:] + elevation[seen][:-1]) < np.pi, 1.0, -1.0)
        step = _wrap(np.diff(a) + sign * np.diff(p)) - sign * np.diff(p)
        continuous = a[0] + np.concatenate([[0.0], np.cumsum(step)])
        good = np.flatnonzero(meaningful[seen])
        start = good[0] if len(good) else 0
        continuous += _wrap(continuous[start : start + 1]) - continuous[start]
        axial[seen] = continuous
    turns = np.stack([_Y, -_X, _Y])
    angles = np.stack([plane, elevation, axial], axis=1)
    return _build_joint_angles(SHOULDER, angles, axes_of_rotations(turns, angles), motion, frames, sine=np.abs(sine))


def elbow_angles(
    motion: RelativeMotion, frames: FloatArray | None = None, names: tuple[str, ...] = ELBOW
) -> JointAngles:
    """Return flexion, carrying angle and pronation of the forearm in the upper arm.

    Only the first two are returned if no marker or joint determines the pronation (``names`` of two angles). For the
    hand in the forearm (:data:`WRIST`), they are flexion and deviation; ulnar deviation is positive.
    """
    r = motion.rotation
    cosine = np.hypot(r[:, 0, 1], r[:, 1, 1])
    flexion = _unwrap(np.arctan2(-r[:, 0, 1], r[:, 1, 1]))
    carrying = np.arctan2(r[:, 2, 1], cosine)
    pronation = _unwrap(np.arctan2(-r[:, 2, 0], r[:, 2, 2]))
    angles = np.stack([flexion, carrying, pronation], axis=1)
    axes = axes_of_rotations(np.stack([_Z, _X, _Y]), angles)
    return _build_joint_angles(names, angles, axes, motion, frames, sine=cosine)


def joint_coordinates(motion: RelativeMotion, joint: SpatialJoint, names: tuple[str, ...]) -> JointAngles:
    """Return the coordinates of a joint, rad: one angle (hinge), two angles (two-axis) or a rotation vector (ball)."""
    r, one = motion.rotation, np.ones(len(motion.rotation))
    if joint.kind == "ball":
        vector = so3.log(r)
        last: FloatArray | None = None
        for i in np.flatnonzero(np.isfinite(vector).all(axis=1)):  # continuous when the rotation angle exceeds π
            angle = float(np.linalg.norm(vector[i]))
            if last is not None and angle > 0:
                axis = vector[i] / angle
                turned = np.round((float(last @ axis) - angle) / (2 * np.pi))
                vector[i] = (angle + 2 * np.pi * turned) * axis
            last = vector[i]
        return _build_joint_angles(names, vector, axes_of_rotation_vector(vector), motion, None, sine=one)
    a, b = joint.first_axis, joint.second_axis
    if joint.kind == "hinge":
        first = _measure_rotation_about(a, r @ joint.offset.T)
        turns, offsets, columns = (joint.offset.T @ a)[None], None, [first]
    else:
        before, after = joint.offset @ b, r @ b
        first = np.arctan2(np.cross(before, after) @ a, after @ before - (after @ a) * (before @ a))
        rest = joint.offset.T @ np.swapaxes(so3.exp(first[:, None] * a), 1, 2) @ r
        turns, offsets, columns = np.stack([a, b]), joint.offset[None], [first, _measure_rotation_about(b, rest)]
    angles = np.stack([_unwrap(column) for column in columns], axis=1)
    return _build_joint_angles(names, angles, axes_of_rotations(turns, angles, offsets), motion, None, sine=one)


def _build_joint_angles(
    names: tuple[str, ...],
    angles: FloatArray,
    axes: AxisDerivatives,
    motion: RelativeMotion,
    frames: FloatArray | None,
    *,
    sine: FloatArray,
) -> JointAngles:
    """Return the first ``len(names)`` of the angles (F, d), with rates, accelerations and standard deviations.

    ``sine`` (F,) is 0 where two angles are not defined separately. The errors of the angles grow with 1 / |``sine``|.
    """
    rate, acceleration, jacobian = compute_rates(axes, motion)
    keep, dimension = len(names), angles.shape[1]
    sd, constant, turned = propagate_covariance(jacobian, motion.covariance), np.zeros(keep), np.abs(sine) < GIMBAL
    if frames is not None:
        # derivatives of the motion by constant errors of both frames: rotation vectors, each in its frame's axes, rad
        lever = np.zeros((len(motion.rotation), 9, 6))
        lever[:, :3, :3] = -np.swapaxes(motion.rotation, 1, 2)
        lever[:, :3, 3:] = np.eye(3)
        lever[:, 3:6, 3:] = so3.hat(motion.velocity)
        lever[:, 6:, 3:] = so3.hat(motion.acceleration)
        by_frames = jacobian @ lever
        good = ~turned & np.isfinite(by_frames).all(axis=(1, 2))
        mean = by_frames[good, :keep].mean(axis=0) if good.any() else np.zeros((keep, 6))
        by_frames[:, :keep] -= mean
        sd, constant = np.hypot(sd, propagate_covariance(by_frames, frames)), propagate_covariance(mean, frames)

    of_angle, of_rate, of_acceleration = (sd[:, i * dimension : i * dimension + keep] for i in range(3))
    condition = 1 / np.maximum(np.abs(sine), 1e-12)
    rate, acceleration = rate[:, :keep], acceleration[:, :keep]
    return JointAngles(
        names, angles[:, :keep], rate, acceleration, of_angle, of_rate, of_acceleration, constant, condition, turned
    )


def _measure_rotation_about(axis: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the angle (F,), rad, of the rotation about an axis that is closest to a rotation (F, 3, 3)."""
    sine = 2 * (so3.vee(rotation) @ axis)
    cosine = np.trace(rotation, axis1=1, axis2=2) - np.einsum("i,fij,j->f", axis, rotation, axis)
    return np.asarray(np.arctan2(sine, cosine))


def _wrap(angle: FloatArray) -> FloatArray:
    """Return an angle wrapped to (-π, π]."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def _unwrap(angle: FloatArray, meaningful: BoolArray | None = None) -> FloatArray:
    """Return an angle (F,), rad, without jumps of 2π across gaps and across samples in which the angle is not defined.

    ``meaningful`` (F,) marks the samples in which the angle is defined (by default all). Changes by 2π in the other
    samples are noise and are removed. The first meaningful sample lies in (-π, π].
    """
    seen = np.isfinite(angle)
    result = angle.copy()
    if not seen.any():
        return result
    values = np.unwrap(angle[seen])
    anchors = seen if meaningful is None else seen & meaningful
    if anchors.any():
        good = np.flatnonzero(anchors[seen])
        kept = np.unwrap(angle[anchors])
        kept += _wrap(kept[:1]) - kept[:1]
        owner = np.clip(np.searchsorted(good, np.arange(len(values)), side="right") - 1, 0, None)
        values += (kept - values[good])[owner]
    else:
        values += _wrap(values[:1]) - values[:1]
    result[seen] = values
    return result


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


AxisDerivatives: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Matrix B (F, 3, d) of a joint, whose columns are the axes b_i, and its derivatives by the coordinates q.

The derivative of column i with respect to q_k is at [:, :, i, k] (F, 3, d, d), with respect to q_k and q_l at
[:, :, i, k, l] (F, 3, d, d, d)."""


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
    return axes, first, second


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b of arrays (F, 3), faster than ``numpy.cross``."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def axes_of_rotation_vector(q: FloatArray) -> AxisDerivatives:
    """Return the matrix B (ω = B dq/dt) and its derivatives for ``R = exp(q)`` with a rotation vector q (F, 3), rad.

    B = 1 - a(s) q^ + c(s) q^ q^, where q^ is the cross-product matrix of q. Further,
    s = |q|², a = (1 - cos |q|) / s and c = (|q| - sin |q|) / |q|³.
    """
    s = np.sum(q**2, axis=1)
    powers = [np.ones(len(q))]
    for _ in range(_TERMS):
        powers.append(powers[-1] * s)
    series = []  # a(s) and c(s), each with its first two derivatives, by power series
    for shift in (2, 3):
        values = [np.zeros(len(q)) for _ in range(3)]
        factor = 1.0 / np.prod(np.arange(1, shift + 1))
        for n in range(_TERMS):
            values[0] += factor * powers[n]
            if n > 0:
                values[1] += factor * n * powers[n - 1]
            if n > 1:
                values[2] += factor * n * (n - 1) * powers[n - 2]
            factor /= -(2 * n + shift + 1) * (2 * n + shift + 2)
        series.append(values)
    a, c = series
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
    return axes, np.einsum("fkim->fimk", first), np.einsum("fklim->fimkl", second)


def compute_rates(axes: AxisDerivatives, motion: RelativeMotion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rates, accelerations, and the Jacobian of the coordinates with respect to the errors of the motion.

    The rates dq (F, d), rad/s, and the accelerations ddq (F, d), rad/s², are NaN where two axes coincide. The Jacobian
    (F, 3 d, 9) contains the derivatives of (q, dq, ddq) with respect to the errors of rotation, velocity and
    acceleration.
    """
    basis, first, second = axes
    square = np.swapaxes(basis, 1, 2) @ basis
    usable = np.asarray(np.isfinite(square).all(axis=(1, 2)))
    usable &= np.linalg.det(np.where(usable[:, None, None], square, 0.0)) > 1e-16
    inverse = np.full((len(basis), basis.shape[2], 3), np.nan)  # pseudo-inverse of B (the inverse for d = 3)
    inverse[usable] = np.linalg.solve(square[usable], np.swapaxes(basis[usable], 1, 2))
    rate = np.einsum("fki,fi->fk", inverse, motion.velocity)
    swept = np.einsum("fxik,fk->fxi", first, rate)  # dB/dt
    held = np.einsum("fxik,fi->fxk", first, rate)
    rest = motion.acceleration - np.einsum("fxi,fi->fx", swept, rate)
    acceleration = np.einsum("fki,fi->fk", inverse, rest)
    bend = np.einsum("fxik,fi->fxk", first, acceleration)
    bend = bend + np.einsum("fxikl,fk,fi->fxl", second, rate, rate)
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


def propagate_covariance(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return standard deviations (..., k) from a Jacobian (..., k, m) and a covariance (..., m, m)."""
    variance = np.sum((jacobian @ covariance) * jacobian, axis=-1)
    return np.asarray(np.sqrt(np.maximum(variance, 0)))
