"""Rates of joints and segments, and variances of the states from skin that slides with the joints.

A marker's lasting error, which is the same in all frames with the same posture, is proportional to the motion of the
joints beside its segment. The error of the pose is the gain of the weighted fit times this error. The errors of
velocity and acceleration are proportional to the velocity and acceleration of the joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation.space.frame_poses import degrees_of_freedom, group_columns, select_frames
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, locate_markers
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint


@dataclass(frozen=True)
class Rates:
    """Rates of n joints and n + 1 segments at F frames, and the joints' derivatives by their coordinates."""

    velocity: FloatArray  # (F, n, 3) of the joints, in the child's axes, rad/s
    acceleration: FloatArray  # (F, n, 3) rad/s²
    jerk: FloatArray  # (F, n, 3) rad/s³
    maps: list[FloatArray]  # n arrays (F, 9, 3 c): derivatives of rotation, velocity, acceleration by c coordinates
    omega: FloatArray  # (F, n + 1, 3) angular velocity of the segments, in the axes of the trial, rad/s
    alpha: FloatArray  # (F, n + 1, 3) angular acceleration, rad/s²

    def at(self, frames: slice | IntArray) -> Rates:
        """Return the rates in the chosen frames."""
        maps, joints = [each[frames] for each in self.maps], (self.velocity, self.acceleration, self.jerk)
        return Rates(*(each[frames] for each in joints), maps, self.omega[frames], self.alpha[frames])


def compute_rates(chain: SpatialChain, model: ChainModel, pose: Pose, turns: FloatArray) -> Rates:
    """Return the rates of all joints and segments; ``turns`` (F, n + 1, 3, 3) are the rotations of the segments."""
    frames, n = len(pose.origin), len(chain.joints)
    joint_rates, maps = np.zeros((3, frames, n, 3)), []
    omega, alpha = np.empty(turns.shape[:3]), np.empty(turns.shape[:3])
    omega[:, 0] = _rotate(turns[:, 0], pose.rate[:, 0, 3:6])
    alpha[:, 0] = _rotate(turns[:, 0], pose.rate[:, 1, 3:6])
    for k, (joint, columns) in enumerate(zip(chain.joints, group_columns(model)[1:], strict=True)):
        rate = pose.rate[:, :, columns]
        if joint.kind == "ball":
            joint_rates[:, :, k] = np.swapaxes(rate, 0, 1)
            maps.append(np.broadcast_to(np.eye(9), (frames, 9, 9)))
        else:
            joint_rates[:, :, k], own_map = _compute_axis_rates(joint, pose.turn[:, k + 1], rate)
            maps.append(own_map)
        before, own = joint.parent, _rotate(turns[:, k + 1], joint_rates[0, :, k])
        omega[:, k + 1] = omega[:, before] + own
        grows = _rotate(turns[:, k + 1], joint_rates[1, :, k]) + np.cross(omega[:, before], own)
        alpha[:, k + 1] = alpha[:, before] + grows
    return Rates(joint_rates[0], joint_rates[1], joint_rates[2], maps, omega, alpha)


def _compute_axis_rates(joint: SpatialJoint, rotation: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return velocity, acceleration and jerk (3, F, 3) of a hinge or two-axis joint, and its array of ``maps``."""
    first = np.einsum("fji,j->fi", rotation, joint.first_axis)
    second, c = joint.second_axis, joint.dimension
    dq, ddq, dddq = rate[:, 0], rate[:, 1], rate[:, 2]
    rates = np.stack([dq[:, :1] * first, ddq[:, :1] * first, dddq[:, :1] * first])
    parts = np.zeros((len(rotation), 3, 3, 3, c))  # of (error, velocity, acceleration) by (q, dq, ddq)
    for order in range(3):
        parts[:, order, :, order, 0] = first
    if joint.kind == "two-axis":
        bend = -np.cross(second, first)  # derivative of the first axis by the second coordinate
        twice = -np.cross(second, bend)
        one, two = dq[:, :1], dq[:, 1:]
        rates[0] += two * second
        rates[1] += ddq[:, 1:] * second + one * two * bend
        rates[2] += dddq[:, 1:] * second + (2 * ddq[:, :1] * two + one * ddq[:, 1:]) * bend + one * two**2 * twice
        for order in range(3):
            parts[:, order, :, order, 1] = second
        parts[:, 1, :, 0, 1] = one * bend
        parts[:, 2, :, 0, 1] = ddq[:, :1] * bend + one * two * twice
        parts[:, 2, :, 1, 0] = two * bend
        parts[:, 2, :, 1, 1] = one * bend
    return rates, parts.reshape(len(rotation), 9, 3 * c)


def compute_rate_jacobians(
    chain: SpatialChain, model: ChainModel, turns: FloatArray, rates: Rates
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of rotation, omega and alpha by pose, velocity and acceleration, (F, n + 1, 3, 3 d) each.

    The change of a rotation is a rotation vector in the axes of the trial. ``turns`` (F, n + 1, 3, 3) are the rotations
    of the segments.
    """
    groups = group_columns(model)
    d = groups[-1].stop
    shape = (len(turns), len(groups), 3, 3, d)
    spin, omega, alpha = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    spin[:, 0, :, 0, 3:6] = turns[:, 0]
    omega[:, 0, :, 1, 3:6] = turns[:, 0]
    alpha[:, 0, :, 2, 3:6] = turns[:, 0]
    for m in range(3):  # a change of the base's rotation also rotates its rates
        omega[:, 0, m, 0, 3:6] = -(so3.hat(rates.omega[:, 0]) @ turns[:, 0])[:, m]
        alpha[:, 0, m, 0, 3:6] = -(so3.hat(rates.alpha[:, 0]) @ turns[:, 0])[:, m]
    flat = (len(turns), 3, 3 * d)
    for k, (joint, own) in enumerate(zip(chain.joints, groups[1:], strict=True)):
        before, c = joint.parent, joint.dimension
        part = np.zeros((3, len(turns), 3, 3, d))
        mapped = turns[:, None, k + 1] @ rates.maps[k].reshape(-1, 3, 3, 3 * c)
        for order in range(3):
            part[order][..., own] = mapped[:, order].reshape(-1, 3, 3, c)
        spins, velocity, acceleration = (each.reshape(flat) for each in part)
        spun = spin[:, before].reshape(flat) + spins
        own_rate = _rotate(turns[:, k + 1], rates.velocity[:, k])
        own_change = velocity - so3.hat(own_rate) @ spun
        omega[:, k + 1] = omega[:, before] + own_change.reshape(shape[0], *shape[2:])
        change = (
            acceleration
            - so3.hat(_rotate(turns[:, k + 1], rates.acceleration[:, k])) @ spun
            - so3.hat(own_rate) @ omega[:, before].reshape(flat)
            + so3.hat(rates.omega[:, before]) @ own_change
        )
        alpha[:, k + 1] = alpha[:, before] + change.reshape(shape[0], *shape[2:])
        spin[:, k + 1] = spun.reshape(shape[0], *shape[2:])
    whole = (len(turns), len(groups), 3, 3 * d)
    return spin.reshape(whole), omega.reshape(whole), alpha.reshape(whole)


def _rotate(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("fij,fj->fi", turns, vectors))


_AXIAL_SHARE = 1.5
"""Common displacement of a segment's markers by skin that rotates about its long axis, relative to their lasting error.

The residuals do not contain a common displacement, so the value is assumed. It is valid for simulated arms.
"""

_ALIKE = 2.0  # assumed variance of the pose from markers that slide partly alike, relative to independent markers

_POSTURES = 40
_LEAST_MOTION = 0.01  # rad, rms; joints that move less do not move the skin
_DAMPING = 1e-6  # m²/rad², for degrees of freedom that no marker determines


@dataclass(frozen=True)
class SkinErrors:
    """Covariances of the pose due to the skin of S segments, at T postures.

    There are two for each segment: for independent displacements of its markers (the first S), and for a common
    rotation about its long axis (the last S).
    """

    pose: FloatArray  # (T, 2 S, d, d) covariance at the postures for a unit of ``motion``
    postures: IntArray  # (T,) frames of the postures
    motion: FloatArray  # (3, F, 2 S) squared motion, velocity and acceleration, relative to the mean square motion

    def at_frames(self, values: FloatArray) -> FloatArray:
        """Return values (F, …) in all frames, interpolated from their values (T, …) at the postures."""
        every = np.arange(self.motion.shape[1])
        upper = np.searchsorted(self.postures, every).clip(1, max(len(self.postures) - 1, 1))
        if len(self.postures) == 1:
            return np.repeat(values, len(every), axis=0)
        low, high = self.postures[upper - 1], self.postures[upper]
        share = ((every - low) / (high - low)).clip(0, 1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[upper - 1] * (1 - share) + values[upper] * share)


def estimate_skin_errors(
    chain: SpatialChain,
    model: ChainModel,
    pose: Pose,
    rates: Rates,
    *,
    lasting: FloatArray,
    weight: FloatArray,
    known: IntArray,
) -> SkinErrors:
    """Return the variances of the states due to the motion of the skin.

    ``lasting`` (M,) is the variance of the lasting error of each marker's coordinate, m², and ``weight`` (M,) the
    weight of each marker, 1/m². ``known`` (K,) are the frames with complete states, from which postures are chosen.
    """
    postures = np.unique(known[np.linspace(0, len(known) - 1, _POSTURES).round().astype(np.int64)])
    d, count, n = degrees_of_freedom(model), len(model.segment), len(chain.joints)
    jacobian, positions = np.zeros((len(postures), count, 3, d)), np.empty((len(postures), count, 3))
    some = select_frames(pose, postures)
    locate_markers(model, some, positions, jacobian)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, weight)
    normal += _DAMPING * weight.mean() * np.eye(d)
    gain = np.einsum("fkl,fmil,m->fmki", np.linalg.inv(normal), jacobian, weight)
    covariance = np.zeros((len(postures), 2 * (n + 1), d, d))
    axes = np.zeros(
        (n, 3)
    )  # unit vectors from each joint to the next joint, or to the mean marker, in the child's frame
    origins, turns = chain.place(some.origin, some.turn[:, 0], some.turn[:, 1:])
    for s in range(n + 1):
        mine = np.flatnonzero(model.segment == s)
        covariance[:, s] = _ALIKE * np.einsum("fmki,fmli,m->fkl", gain[:, mine], gain[:, mine], lasting[mine])
        if s > 0:
            ahead, own = [joint.centre for joint in chain.joints if joint.parent == s], chain.local[chain.segment == s]
            towards = ahead[0] if ahead else own.mean(axis=0) if len(own) else np.zeros(3)
            axes[s - 1] = towards / max(float(np.linalg.norm(towards)), 1e-9)
            around = np.cross((turns[:, s] @ axes[s - 1])[:, None], positions[:, mine] - origins[:, s, None])
            around /= np.maximum(np.linalg.norm(around, axis=2, keepdims=True), 1e-9)
            moved = np.einsum("fmki,fmi,m->fk", gain[:, mine], around, np.sqrt(lasting[mine]))
            covariance[:, n + 1 + s] = _AXIAL_SHARE**2 * moved[:, :, None] * moved[:, None, :]
    # squared motion of the joints beside each segment, then about its long axis; zero for joints that hardly move
    squares = np.zeros((3, len(pose.origin), 2 * (n + 1)))
    for k, joint in enumerate(chain.joints):
        u, _, v = np.linalg.svd(pose.turn[known, k + 1].mean(axis=0))
        middle = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        bent = so3.log(middle.T @ pose.turn[:, k + 1])
        moves = (bent, rates.velocity[:, k], rates.acceleration[:, k])
        for s in (k + 1, joint.parent):
            squares[:, :, s] += [np.sum(each**2, axis=1) for each in moves]
        squares[:, :, n + 2 + k] = [(each @ axes[k]) ** 2 for each in moves]
    usual = squares[0, known].mean(axis=0)
    motion = np.where(usual > _LEAST_MOTION**2, squares / np.maximum(usual, _LEAST_MOTION**2), 0.0)
    return SkinErrors(covariance, postures, motion)
