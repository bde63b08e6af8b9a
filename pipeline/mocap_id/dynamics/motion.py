"""Planar motion of a body's segments, the input of the regressor.

It is computed from the joint angles of a pinned chain, whose segments cannot move apart in the joints
(:func:`move_chain`), or from measured poses of marker clusters, in which every body moves separately
(:mod:`mocap_id.dynamics.measured_motion`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import planar


@dataclass(frozen=True)
class PlanarMotion:
    """Poses of K bodies, their derivatives, and the n joints between them, in the plane frame."""

    # angle, omega, alpha: (T, K) angle of each body's frame, rad, and its time derivatives
    angle: FloatArray
    omega: FloatArray
    alpha: FloatArray
    # origin, acceleration: (T, K, 2) origin of each body's frame, m, and its acceleration without gravity, m/s²
    origin: FloatArray
    acceleration: FloatArray
    joint: FloatArray  # (T, n, 2) centres of the joints, m; NaN where both sides of a joint belong to one body
    beyond: BoolArray  # (n, K) whether each body is distal to each joint

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (p_y, -p_x, 1) of the joints (T, 3, n); times a wrench, they give moments about the joints."""
        x, y = self.joint[..., 0], self.joint[..., 1]
        return np.stack([y, -x, np.ones_like(x)], axis=1)

    def at(self, samples: IntArray | slice) -> PlanarMotion:
        """Return the motion at some samples."""
        chosen = {each.name: getattr(self, each.name)[samples] for each in fields(self) if each.name != "beyond"}
        return replace(self, **chosen)

    def scale(self, factor: float) -> PlanarMotion:
        """Return the motion with all lengths multiplied by a factor."""
        return replace(
            self, origin=self.origin * factor, acceleration=self.acceleration * factor, joint=self.joint * factor
        )

    def tilt(self, angle: float) -> PlanarMotion:
        """Return the motion rotated about the origin of the plane frame by an angle, rad; gravity is not rotated."""
        rotation = np.asarray(angle)
        return replace(
            self,
            angle=self.angle + angle,
            origin=planar.rotate(rotation, self.origin),
            acceleration=planar.rotate(rotation, self.acceleration),
            joint=planar.rotate(rotation, self.joint),
        )


def move_chain(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> PlanarMotion:
    """Return the motion of the n + 1 segments of a pinned chain on a fixed base, base first.

    ``centres`` (n, 2) or (T, n, 2) contains the centre of joint j in the frame of segment j - 1, m.
    """
    angle, origin = planar.segment_poses(q, centres)  # (T, n + 1), (T, n + 1, 2)
    omega = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(dq, axis=1)], axis=1)
    alpha = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(ddq, axis=1)], axis=1)
    acceleration = np.zeros_like(origin)
    steps = point_acceleration(np.diff(origin, axis=1), omega[:, :-1], alpha[:, :-1])
    acceleration[:, 1:] = np.cumsum(steps, axis=1)
    joints = q.shape[1]
    beyond: BoolArray = np.arange(joints + 1) > np.arange(joints)[:, None]
    return PlanarMotion(angle, omega, alpha, origin, acceleration, origin[:, 1:], beyond)


def point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the acceleration (..., 2) of a point at ``arm`` (..., 2) in a rotating body, relative to its origin."""
    normal = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    acceleration: FloatArray = alpha[..., None] * normal - (omega**2)[..., None] * arm
    return acceleration
