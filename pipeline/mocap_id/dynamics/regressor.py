"""Motion of a body's segments, and the wrench and joint torques as linear maps of the parameters (thesis 4.2.1).

A link has ten parameters, in the order of eq. 4.4: m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz, all about the origin of
the link's frame. Ixy is the element of the inertia matrix, -∫ x y dm. A planar link has four of these parameters: m,
mx, my, Izz. The columns are ordered from the base to the tip. Gravity is modelled as an upward acceleration of the
base.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import Chain, link_motion, planar, se3, so3, spatial_jacobian


@dataclass(frozen=True)
class BodyMotion(ABC):
    """Motion of K bodies and of the N coordinates of the joints between them, in the plane or in space."""

    # omega, alpha: angular velocity and acceleration, (T, K) in the plane, (T, K, 3) in space, rad/s and rad/s²
    omega: FloatArray
    alpha: FloatArray
    # origin, acceleration: (T, K, 2) or (T, K, 3) origin of each body's frame, m, and its acceleration without gravity,
    # m/s²
    origin: FloatArray
    acceleration: FloatArray
    # (T, N, 2) or (T, N, 3) centre of each coordinate's joint, m; NaN where both sides of a joint belong to one body
    joint: FloatArray
    beyond: BoolArray  # (N, K) whether each body is distal to the joint of each coordinate

    @property
    @abstractmethod
    def jacobian(self) -> FloatArray:
        """Unit twists of the coordinates, (T, 3, N) or (T, 6, N): times a wrench, the moments about the joints."""

    def at(self, samples: IntArray | slice) -> Self:
        chosen = {each.name: getattr(self, each.name)[samples] for each in fields(self) if each.name != "beyond"}
        return replace(self, **chosen)

    def scale(self, factor: float) -> Self:
        """Return the motion with all lengths multiplied by a factor."""
        lengths = {name: getattr(self, name) * factor for name in ("origin", "acceleration", "joint")}
        return replace(self, **lengths)


@dataclass(frozen=True)
class PlanarMotion(BodyMotion):
    """Motion of bodies in the plane frame."""

    angle: FloatArray  # (T, K) angle of each body's frame, rad

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (p_y, -p_x, 1) of the joints (T, 3, n)."""
        x, y = self.joint[..., 0], self.joint[..., 1]
        return np.stack([y, -x, np.ones_like(x)], axis=1)

    def tilt(self, angle: float) -> PlanarMotion:
        """Return the motion rotated about the origin of the plane frame by an angle, rad; gravity is not rotated."""
        rotation, names = np.asarray(angle), ("origin", "acceleration", "joint")
        vectors: dict[str, Any] = {name: planar.rotate(rotation, getattr(self, name)) for name in names}
        return replace(self, angle=self.angle + angle, **vectors)


def move_chain(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> PlanarMotion:
    """Return the motion of a pinned chain on a fixed base; ``centres`` (n, 2) or (T, n, 2) may change over time."""
    angle, origin = planar.segment_poses(q, centres)  # (T, n + 1), (T, n + 1, 2)
    omega = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(dq, axis=1)], axis=1)
    alpha = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(ddq, axis=1)], axis=1)
    acceleration = np.zeros_like(origin)
    steps = point_acceleration(np.diff(origin, axis=1), omega[:, :-1], alpha[:, :-1])
    acceleration[:, 1:] = np.cumsum(steps, axis=1)
    joints = q.shape[1]
    beyond: BoolArray = np.arange(joints + 1) > np.arange(joints)[:, None]
    return PlanarMotion(omega, alpha, origin, acceleration, origin[:, 1:], beyond, angle)


def point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the acceleration (..., 2) of a point at ``arm`` (..., 2) in a rotating body, relative to its origin."""
    normal = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    return np.asarray(alpha[..., None] * normal - (omega**2)[..., None] * arm)


LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
PLANAR_PARAMETERS = ("m", "mx", "my", "Izz")
WRENCH_COMPONENTS = ("Fx", "Fy", "tauz")


def momentum_regressor(twist: FloatArray) -> FloatArray:
    """Return the regressor Y_V (..., 6, 10) of the momentum I V of one link (eq. 4.15).

    ``twist`` (..., 6) is V = (v, ω) in the link frame, or its time derivative for the regressor of eq. 4.16.
    """
    v, omega = twist[..., :3], twist[..., 3:]
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    matrix = np.zeros((*twist.shape[:-1], 6, 10))
    matrix[..., :3, 0], matrix[..., :3, 1:4] = v, so3.hat(omega)
    matrix[..., 3:, 1:4] = -so3.hat(v)
    matrix[..., 3, 4], matrix[..., 4, 5], matrix[..., 5, 6] = x, y, z
    matrix[..., 3, 7], matrix[..., 4, 7] = y, x
    matrix[..., 3, 8], matrix[..., 5, 8] = z, x
    matrix[..., 4, 9], matrix[..., 5, 9] = z, y
    return matrix


def link_regressor(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor Y_i (..., 6, 10) of a link's wrench from its velocity and acceleration (eq. 4.17, 4.18)."""
    return momentum_regressor(acceleration) - np.swapaxes(se3.ad(velocity), -1, -2) @ momentum_regressor(velocity)


def spatial_regressor(
    chain: Chain, q: FloatArray, dq: FloatArray, ddq: FloatArray, base_acceleration: FloatArray
) -> FloatArray:
    """Return the regressor Y (..., 6, 10(n + 1)) of the ground's wrench on the whole chain (eq. 4.19-4.22).

    The product of Y with the full parameters, base first, is the wrench (F, τ) of the ground on the chain about the
    origin of the world frame, in world axes. ``q``, ``dq`` and ``ddq`` (..., N) are the joint coordinates and their
    derivatives; ``base_acceleration`` (6,) is ``(g·up, 0)`` for gravity.
    """
    moving = link_motion(chain, q, dq, ddq, base_acceleration)
    return bodies_regressor(chain.poses(q), moving.velocity, moving.acceleration)


def bodies_regressor(poses: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor (..., 6, 10K) of the wrench on K bodies about the origin of the world frame (eq. 4.19).

    Poses (..., K, 4, 4) are in the world frame, velocities and accelerations (..., K, 6) in the bodies' frames.
    """
    to_world = np.swapaxes(se3.Ad(se3.inverse(poses)), -1, -2)  # (..., K, 6, 6)
    blocks = to_world @ link_regressor(velocity, acceleration)
    return np.moveaxis(blocks, -3, -2).reshape(*poses.shape[:-3], 6, -1)


def project_on_joints(jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray) -> FloatArray:
    """Return the joint torques (..., N, P) due to P wrenches (..., c, P) on single segments, in space or in the plane.

    The wrench through joint j is the sum of the wrenches on the segments beyond it. The product of this wrench with the
    joint's spatial twist, a column of the spatial Jacobian (..., c, N) (eq. 2.47), is the torque. The wrenches are
    columns of a regressor or external wrenches, about the frame's origin. ``segment`` (P,), from 0, is where each acts,
    and ``joint`` (N,), from 1, is the joint of each coordinate.
    """
    torque = np.swapaxes(jacobian, -1, -2) @ wrenches
    return np.where(segment >= joint[:, None], torque, 0.0)


def spatial_torque_regressor(chain: Chain, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (..., N, 10(n + 1)) of the joint torques, given that of the wrench (..., 6, 10(n + 1))."""
    segment = np.repeat(np.arange(len(chain.joints) + 1), len(LINK_PARAMETERS))
    return project_on_joints(spatial_jacobian(chain, q), number_joints(chain), regressor, segment)


def number_joints(chain: Chain) -> IntArray:
    """Return the joint, from 1, to which each of the N coordinates of a chain belongs."""
    return np.repeat(np.arange(1, len(chain.joints) + 1), [joint.dimension for joint in chain.joints])


def wrench_regressor(motion: PlanarMotion, gravity: float = 9.81) -> FloatArray:
    """Return the regressor (T, 3, 4K) of the ground's wrench on K bodies in the plane (eq. 4.15 to 4.22).

    Rows: Fx, Fy, tauz of the ground on the bodies about the origin of the plane frame. Columns: m, mx, my, Izz of every
    body about the origin of its frame. Gravity, m/s², is along -y.
    """
    acceleration = motion.acceleration.copy()
    acceleration[..., 1] += gravity
    blocks = np.zeros((*motion.angle.shape, 3, 4))  # (T, K, 3, 4)
    blocks[..., :2, 0] = acceleration
    for column, axis in ((1, np.array([1.0, 0.0])), (2, np.array([0.0, 1.0]))):
        unit = planar.rotate(motion.angle, axis)  # the body's x, then y, in the plane frame
        blocks[..., :2, column] = point_acceleration(unit, motion.omega, motion.alpha)
        blocks[..., 2, column] = _cross_product(unit, acceleration)
    blocks[..., 2, 3] = motion.alpha
    blocks[..., 2, :3] += _cross_product(motion.origin[..., None, :], np.swapaxes(blocks[..., :2, :3], -1, -2))
    return np.moveaxis(blocks, 1, 2).reshape(len(motion.angle), 3, -1)


def torque_regressor(motion: BodyMotion, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, N, p K) of the joint torques from that of the wrench (T, c, p K); NaN without centre."""
    torque = np.swapaxes(motion.jacobian, -1, -2) @ regressor
    distal = np.repeat(motion.beyond, regressor.shape[-1] // motion.beyond.shape[1], axis=1)
    return np.where(distal, torque, np.where(np.isnan(torque), np.nan, 0.0))


def planar_regressor(
    centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, gravity: float = 9.81
) -> FloatArray:
    """Return the regressor (T, 3, 4(n + 1)) of the ground's wrench on a planar chain, with the segments base first.

    It equals :func:`spatial_regressor` for the same chain and is eighty times faster; a test compares the two.
    ``centres`` (n, 2) or (T, n, 2) are as for :func:`move_chain`; gravity, m/s², is along -y.
    """
    return wrench_regressor(move_chain(centres, q, dq, ddq), gravity)


def planar_torque_regressor(centres: FloatArray, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, n, 4(n + 1)) of the joint torques of a planar chain, given that of the wrench."""
    joints = np.arange(q.shape[1] + 1)
    jacobian = planar.joint_twists(q, centres)
    return project_on_joints(jacobian, joints[1:], regressor, np.repeat(joints, len(PLANAR_PARAMETERS)))


def _cross_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z component of a × b for plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def composite_inertia(
    q: FloatArray, centres: FloatArray, mass: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the ground's wrench (T, 3, n) and of the torques (T, n, n) by the joint accelerations.

    They are the wrench (Fx, Fy, tauz) about the origin of the plane frame and the torques for a unit acceleration of
    each joint, N and N·m per rad/s²; the derivative of the torques is the mass matrix, kg·m². ``mass`` (n + 1,), kg,
    ``first`` (n + 1, 2) moments, kg·m, and ``second`` (n + 1,) moments, kg·m², are about the origins of the segments'
    frames, base first; no joint moves the base. Missing angles give NaN.
    """
    size, joints = q.shape
    angle, origin = planar.segment_poses(q, centres)
    wrench, torque = np.empty((size, 3, joints)), np.empty((size, joints, joints))
    total, moment, spread = 0.0, np.zeros((size, 2)), np.zeros(size)  # of all segments beyond the joint
    step = np.zeros((size, 2))
    for k in range(joints, 0, -1):
        spread = second[k] + spread + _dot(2.0 * moment + total * step, step)
        moment = planar.rotate(angle[:, k], first[k]) + moment + total * step
        total = total + float(mass[k])
        wrench[:, 0, k - 1], wrench[:, 1, k - 1] = -moment[:, 1], moment[:, 0]
        wrench[:, 2, k - 1] = spread + _dot(moment, origin[:, k])
        for j in range(1, k + 1):
            torque[:, j - 1, k - 1] = spread + _dot(moment, origin[:, k] - origin[:, j])
            torque[:, k - 1, j - 1] = torque[:, j - 1, k - 1]
        step = origin[:, k] - origin[:, k - 1]
    return wrench, torque


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of plane vectors (T, 2)."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])


SEAT = "seat"  # name of the chair's wrench, if a separate force plate measures it


@dataclass(frozen=True)
class ExternalWrench:
    """A measured wrench of the surroundings on one segment, other than the ground's wrench."""

    name: str  # name of the object that exerts the wrench
    segment: int  # segment on which it acts; 0 is the base
    # (T, 3) (Fx, Fy, tauz) of the surroundings on the body about the origin of the plane frame, N and N·m; NaN where
    # missing
    wrench: FloatArray
    # whether the samples follow the clock of the ground's plates; otherwise they follow the clock of the cameras
    by_plates: bool


def sum_external(
    jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return how much wrenches (..., c, K) on ``segment`` (K,) reduce the ground's wrench and the joint torques."""
    return wrenches.sum(axis=-1), project_on_joints(jacobian, joint, wrenches, segment).sum(axis=-1)
