"""Joints, serial chains in SE(3), and their recursive kinematics and dynamics (thesis 2.3, 2.4).

Link 0 is the base, and its frame is the world frame. Joint i (from 1) moves link i, and frame i is fixed to link i. The
coordinates q (..., N) are the coordinates of all joints in order from base to tip. Leading axes are optional.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import se3, so3

_SMALL = 0.05  # rad; the series are accurate to rounding below this angle, and the closed forms above it


class Joint(Protocol):
    """Protocol of a joint: the members that :class:`mocap_id.geometry.chain.Chain` uses."""

    @property
    def dimension(self) -> int:
        """Number of coordinates d."""

    @property
    def twists(self) -> FloatArray:
        """Twists ξ_k of the coordinates in the joint frame, (6, d)."""

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the matrix S(q), (..., 6, d); S(q) q̇ is the body velocity of the link in the joint frame."""

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the time derivative of :meth:`subspace`, (..., 6, d), from coordinates and rates (..., d)."""


@dataclass(frozen=True)
class Revolute:
    """Hinge: rotation about an axis through the origin of the joint frame.

    The axis (x, y, z) is scaled to unit length. A ValueError is raised if it is zero or not finite.
    """

    axis: tuple[float, float, float]

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.axis))
        if not 0 < length < np.inf:
            raise ValueError(f"the axis of a revolute joint is {self.axis}; expected a finite, non-zero vector")
        object.__setattr__(self, "axis", tuple(float(x) / length for x in self.axis))

    @property
    def dimension(self) -> int:
        return 1

    @property
    def twists(self) -> FloatArray:
        return np.concatenate([np.zeros(3), self.axis])[:, None]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the twist of the axis, (..., 6, 1), which does not depend on the angle (eq. 2.49)."""
        return np.broadcast_to(self.twists, (*q.shape[:-1], 6, 1))

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return zeros, because :meth:`subspace` is constant."""
        return np.zeros((*q.shape[:-1], 6, 1))


@dataclass(frozen=True)
class Ball:
    """Ball joint: any rotation about the origin of the joint frame. Its coordinates are a rotation vector, rad."""

    @property
    def dimension(self) -> int:
        return 3

    @property
    def twists(self) -> FloatArray:
        return np.eye(6)[:, 3:]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the matrix S(q), (..., 6, 3): three rows of zeros above the right Jacobian 1 - a q̂ + b q̂².

        The factors a and b are those of :func:`_jacobian_coefficients`. The right Jacobian times q̇ is the angular
        velocity of the link in its own frame (Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol.
        2, 10.86).
        """
        a, b, _, _ = _jacobian_coefficients(np.linalg.norm(q, axis=-1)[..., None, None])
        cross = so3.hat(q)
        right = np.eye(3) - a * cross + b * cross @ cross
        return np.concatenate([np.zeros_like(right), right], axis=-2)

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the time derivative of :meth:`subspace`, (..., 6, 3)."""
        a, b, da, db = _jacobian_coefficients(np.linalg.norm(q, axis=-1)[..., None, None])
        cross, change = so3.hat(q), so3.hat(dq)
        along = np.sum(q * dq, axis=-1)[..., None, None]  # θ dθ/dt
        square = cross @ change + change @ cross
        rate = along * (db * cross @ cross - da * cross) - a * change + b * square
        return np.concatenate([np.zeros_like(rate), rate], axis=-2)


def _jacobian_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a = (1 - cos θ)/θ², b = (θ - sin θ)/θ³, (da/dθ)/θ and (db/dθ)/θ at the angles θ."""
    sine, a = so3.exp_coefficients(angle)
    square = angle**2
    small = angle < _SMALL
    safe = np.where(small, 1.0, square)
    b = np.where(small, 1 / 6 - square / 120 + square**2 / 5040 - square**3 / 362880, (1 - sine) / safe)
    da = np.where(small, -1 / 12 + square / 180 - square**2 / 6720 + square**3 / 453600, (sine - 2 * a) / safe)
    db = np.where(small, -1 / 60 + square / 1260 - square**2 / 60480 + square**3 / 4989600, (a - 3 * b) / safe)
    return a, b, da, db


@dataclass(frozen=True)
class Chain:
    """Serial chain of joints. The numbers of joints and placements must be equal (else a ValueError is raised)."""

    joints: tuple[Joint, ...]  # n joints from base to tip
    placements: FloatArray  # (n, 4, 4) pose g_{i-1,i} of each joint's frame in the previous link at q = 0

    def __post_init__(self) -> None:
        if self.placements.shape != (len(self.joints), 4, 4):
            raise ValueError(
                f"a chain of {len(self.joints)} joints needs placements of shape ({len(self.joints)}, 4, 4), "
                f"not {self.placements.shape}"
            )

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slice of q for each joint."""
        ends = np.cumsum([joint.dimension for joint in self.joints]).tolist()
        return tuple(slice(end - joint.dimension, end) for end, joint in zip(ends, self.joints, strict=True))

    @cached_property
    def dimension(self) -> int:
        """Number of coordinates N."""
        return sum(joint.dimension for joint in self.joints)

    @cached_property
    def home(self) -> FloatArray:
        """Poses g_{W,i} of all links at q = 0, (n, 4, 4)."""
        poses = [np.eye(4)]
        for placement in self.placements:
            poses.append(poses[-1] @ placement)
        return np.stack(poses[1:]) if self.joints else np.zeros((0, 4, 4))

    def relative_poses(self, q: FloatArray) -> FloatArray:
        """Return the pose g_{i-1,i}(q) of each link in the previous link, (..., n, 4, 4) (eq. 2.29, 2.41)."""
        moved = [
            placement @ se3.exp_twist(q[..., part] @ joint.twists.T)
            for joint, placement, part in zip(self.joints, self.placements, self.slices, strict=True)
        ]
        return np.stack(moved, axis=-3)

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses g_{W,i}(q) of all links, including the base, (..., n + 1, 4, 4) (eq. 2.37)."""
        relative = self.relative_poses(q)
        poses = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
        for i in range(len(self.joints)):
            poses.append(poses[-1] @ relative[..., i, :, :])
        return np.stack(poses, axis=-3)

    def tool_pose(self, q: FloatArray, tool: FloatArray) -> FloatArray:
        """Return the world pose (..., 4, 4) of a tool from its pose ``tool`` (4, 4) in the frame of the last link."""
        return self.poses(q)[..., -1, :, :] @ tool


def spatial_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the world pose of a tool by the product of exponentials in spatial form, (..., 4, 4) (eq. 2.39, 2.40).

    The coordinates are q (..., N). ``tool`` (4, 4) is the pose of the tool frame in the frame of the last link.
    """
    g: FloatArray = np.eye(4)
    for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True):
        g = g @ se3.exp_twist(q[..., part] @ (se3.Ad(home) @ joint.twists).T)
    at_home: FloatArray = chain.home[-1] @ tool
    return g @ at_home


def body_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the world pose of a tool by the product of exponentials in body form (eq. 2.42).

    The twists are in the tool frame at q = 0. Parameters and result are as for :func:`spatial_product`.
    """
    at_home: FloatArray = chain.home[-1] @ tool
    g = at_home
    for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True):
        to_tool = se3.Ad(se3.inverse(at_home) @ home)
        g = g @ se3.exp_twist(q[..., part] @ (to_tool @ joint.twists).T)
    return g


def spatial_jacobian(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the spatial Jacobian of the last link, (..., 6, N), in the world frame (eq. 2.45, 2.47)."""
    poses = chain.poses(q)
    columns = [
        se3.Ad(poses[..., i, :, :]) @ joint.subspace(q[..., part])
        for i, (joint, part) in enumerate(zip(chain.joints, chain.slices, strict=True), start=1)
    ]
    return np.concatenate(columns, axis=-1)


def body_jacobian(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the body Jacobian of a tool on the last link, (..., 6, N), in the tool frame (eq. 2.46, 2.48)."""
    return se3.Ad(se3.inverse(chain.tool_pose(q, tool))) @ spatial_jacobian(chain, q)


@dataclass(frozen=True)
class JointLoads:
    """Wrenches and generalised forces that cause a given motion of a chain."""

    joint_wrench: FloatArray  # (..., n, 6) wrench of link i - 1 on link i in frame i, N and N·m
    effort: FloatArray  # (..., N) generalised force of each coordinate; the torque of a hinge, N·m
    base_wrench: FloatArray  # (..., 6) wrench of the ground on the whole body, world frame, about its origin


def spatial_inertia(mass: FloatArray, centre: FloatArray, about_centre: FloatArray) -> FloatArray:
    """Return the spatial inertia matrix of a link about the origin of its frame, (..., 6, 6) (eq. 2.56).

    The product of this matrix and a twist (v, ω) is the momentum of the link. ``mass`` is in kg, ``centre`` (..., 3) is
    the centre of mass in the link frame, m, and ``about_centre`` (..., 3, 3) the inertia matrix about the centre of
    mass, kg·m².
    """
    mass = np.asarray(mass, dtype=np.float64)[..., None, None]
    cross = so3.hat(centre)
    matrix = np.zeros((*np.broadcast_shapes(mass.shape[:-2], cross.shape[:-2]), 6, 6))
    matrix[..., :3, :3] = mass * np.eye(3)
    matrix[..., :3, 3:], matrix[..., 3:, :3] = -mass * cross, mass * cross
    matrix[..., 3:, 3:] = about_centre - mass * (cross @ cross)
    return matrix


def link_wrench(inertia: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the wrench (..., 6) that causes the motion of a link, about the origin of the link's frame (eq. 2.55)."""
    momentum = inertia @ velocity[..., None]
    gyroscopic = np.swapaxes(se3.ad(velocity), -1, -2) @ momentum
    return (inertia @ acceleration[..., None] - gyroscopic)[..., 0]


def link_motion(
    chain: Chain, q: FloatArray, dq: FloatArray, ddq: FloatArray, base_acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the motion of all links, base first, for given coordinates (..., N) (eq. 2.50-2.53).

    The results are the pose g_{i-1,i} (..., n, 4, 4) of each link in the frame of the previous link, the body
    velocities (..., n + 1, 6), m/s and rad/s, and their derivatives (..., n + 1, 6), m/s² and rad/s².
    The base has zero velocity and the acceleration ``base_acceleration`` (6,), which is ``(g·up, 0)`` for gravity.
    """
    relative = chain.relative_poses(q)
    lead = q.shape[:-1]
    velocity = [np.zeros((*lead, 6))]
    acceleration = [np.broadcast_to(np.asarray(base_acceleration, dtype=np.float64), (*lead, 6))]
    for i, (joint, part) in enumerate(zip(chain.joints, chain.slices, strict=True)):
        backward = se3.Ad(se3.inverse(relative[..., i, :, :]))
        subspace, rate = joint.subspace(q[..., part]), joint.subspace_rate(q[..., part], dq[..., part])
        from_base = backward @ velocity[-1][..., None]
        own = subspace @ dq[..., part, None]
        change = subspace @ ddq[..., part, None] + rate @ dq[..., part, None]
        coriolis = se3.ad(from_base[..., 0]) @ own
        velocity.append((from_base + own)[..., 0])
        acceleration.append((backward @ acceleration[-1][..., None] + coriolis + change)[..., 0])
    return relative, np.stack(velocity, axis=-2), np.stack(acceleration, axis=-2)


def inverse_dynamics(
    chain: Chain,
    inertias: FloatArray,
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
    *,
    base_acceleration: FloatArray,
    applied: FloatArray | None = None,
) -> JointLoads:
    """Return the joint wrenches, joint torques and ground wrench for a given motion (eq. 2.57).

    ``inertias`` (n + 1, 6, 6) are the :func:`spatial_inertia` of all links, base first, and q, dq, ddq (..., N) the
    coordinates and their time derivatives. ``base_acceleration`` (6,) is ``(g·up, 0)`` for gravity. ``applied`` (...,
    n + 1, 6) are other external wrenches on the links (for example, from a seat), in the links' frames. The thesis has
    the opposite sign: its Γ_E is the wrench of the body on the surroundings.
    """
    relative, velocity, acceleration = link_motion(chain, q, dq, ddq, base_acceleration)
    needed = link_wrench(inertias, velocity, acceleration)
    if applied is not None:
        needed = needed - applied
    total = needed[..., -1, :]
    wrenches, efforts = [], []
    for i in reversed(range(len(chain.joints))):
        subspace = chain.joints[i].subspace(q[..., chain.slices[i]])
        wrenches.append(total)
        efforts.append((np.swapaxes(subspace, -1, -2) @ total[..., None])[..., 0])
        total = needed[..., i, :] + se3.move_wrench(relative[..., i, :, :], total)
    return JointLoads(np.stack(wrenches[::-1], axis=-2), np.concatenate(efforts[::-1], axis=-1), total)
