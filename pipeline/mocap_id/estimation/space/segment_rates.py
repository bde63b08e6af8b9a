"""Velocities and accelerations ("rates") of joints and segments, and their derivatives by the states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation.space.chain_model import group_columns
from mocap_id.estimation.space.space_kernels import ChainModel, Pose
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint


@dataclass(frozen=True)
class JointRates:
    """Rates of n joints at F frames in the child's axes, and their derivatives by the joints' coordinates."""

    velocity: FloatArray  # (F, n, 3) rad/s
    acceleration: FloatArray  # (F, n, 3) rad/s²
    jerk: FloatArray  # (F, n, 3) rad/s³
    maps: list[FloatArray]  # n arrays (F, 9, 3 c): derivatives of rotation, velocity, acceleration by c coordinates

    def at(self, frames: slice | IntArray) -> JointRates:
        """Return the rates in the chosen frames."""
        maps = [each[frames] for each in self.maps]
        return JointRates(self.velocity[frames], self.acceleration[frames], self.jerk[frames], maps)


def compute_joint_rates(chain: SpatialChain, model: ChainModel, pose: Pose) -> JointRates:
    """Return the rates of all joints in the axes of their child segments."""
    frames, n = len(pose.origin), len(chain.joints)
    rates = np.zeros((3, frames, n, 3))
    maps = []
    for k, (joint, own) in enumerate(zip(chain.joints, group_columns(model)[1:], strict=True)):
        rate = pose.rate[:, :, own]
        if joint.kind == "ball":
            rates[:, :, k] = np.swapaxes(rate, 0, 1)
            maps.append(np.broadcast_to(np.eye(9), (frames, 9, 9)))
            continue
        rates[:, :, k], own_map = _compute_axis_rates(joint, pose.turn[:, k + 1], rate)
        maps.append(own_map)
    return JointRates(rates[0], rates[1], rates[2], maps)


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


@dataclass(frozen=True)
class SegmentRates:
    """Angular velocity and acceleration of n + 1 segments at F frames, in the axes of the trial."""

    omega: FloatArray  # (F, n + 1, 3) rad/s
    alpha: FloatArray  # (F, n + 1, 3) rad/s²

    def at(self, frames: slice | IntArray) -> SegmentRates:
        """Return the rates in the chosen frames."""
        return SegmentRates(self.omega[frames], self.alpha[frames])


def compute_segment_rates(chain: SpatialChain, pose: Pose, turns: FloatArray, joints: JointRates) -> SegmentRates:
    """Return the rates of all segments; ``turns`` (F, n + 1, 3, 3) are their rotations."""
    omega, alpha = np.empty(turns.shape[:3]), np.empty(turns.shape[:3])
    omega[:, 0] = _rotate(turns[:, 0], pose.rate[:, 0, 3:6])
    alpha[:, 0] = _rotate(turns[:, 0], pose.rate[:, 1, 3:6])
    for k, joint in enumerate(chain.joints):
        before, own = joint.parent, _rotate(turns[:, k + 1], joints.velocity[:, k])
        omega[:, k + 1] = omega[:, before] + own
        grows = _rotate(turns[:, k + 1], joints.acceleration[:, k]) + np.cross(omega[:, before], own)
        alpha[:, k + 1] = alpha[:, before] + grows
    return SegmentRates(omega, alpha)


def compute_rate_jacobians(
    chain: SpatialChain, model: ChainModel, turns: FloatArray, joints: JointRates, rates: SegmentRates
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
        mapped = turns[:, None, k + 1] @ joints.maps[k].reshape(-1, 3, 3, 3 * c)
        for order in range(3):
            part[order][..., own] = mapped[:, order].reshape(-1, 3, 3, c)
        spins, velocity, acceleration = (each.reshape(flat) for each in part)
        spun = spin[:, before].reshape(flat) + spins
        own_rate = _rotate(turns[:, k + 1], joints.velocity[:, k])
        own_change = velocity - so3.hat(own_rate) @ spun
        omega[:, k + 1] = omega[:, before] + own_change.reshape(shape[0], *shape[2:])
        change = (
            acceleration
            - so3.hat(_rotate(turns[:, k + 1], joints.acceleration[:, k])) @ spun
            - so3.hat(own_rate) @ omega[:, before].reshape(flat)
            + so3.hat(rates.omega[:, before]) @ own_change
        )
        alpha[:, k + 1] = alpha[:, before] + change.reshape(shape[0], *shape[2:])
        spin[:, k + 1] = spun.reshape(shape[0], *shape[2:])
    whole = (len(turns), len(groups), 3, 3 * d)
    return spin.reshape(whole), omega.reshape(whole), alpha.reshape(whole)


def _rotate(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("fij,fj->fi", turns, vectors))
