"""Planar motion of a body's segments, the input of the regressor.

It comes from the joint angles of a chain whose segments are pinned to each other (:func:`chain_motion`), or from the
measured poses of marker clusters, in which every body moves by itself (:mod:`mocap_id.dynamics.measured_motion`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import planar


@dataclass(frozen=True)
class PlanarMotion:
    """Poses of K bodies, their derivatives, and the n joints between them, in the plane frame.

    Parameters
    ----------
    angle, omega, alpha : (T, K) arrays
        Angle of each body's frame, rad, and its time derivatives.
    origin, acceleration : (T, K, 2) arrays
        Origin of each body's frame, m, and its kinematic acceleration, without gravity, m/s².
    joint : (T, n, 2) array
        Centres of the joints, m; NaN where both sides of a joint belong to one body.
    beyond : (n, K) bool array
        Whether each body is distal to each joint.
    """

    angle: FloatArray
    omega: FloatArray
    alpha: FloatArray
    origin: FloatArray
    acceleration: FloatArray
    joint: FloatArray
    beyond: BoolArray

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (p_y, -p_x, 1) of the joints, (T, 3, n); their product with a wrench is its moment about them."""
        x, y = self.joint[..., 0], self.joint[..., 1]
        return np.stack([y, -x, np.ones_like(x)], axis=1)

    def at(self, samples: IntArray | slice) -> PlanarMotion:
        """Return the motion at some samples."""
        return PlanarMotion(
            self.angle[samples],
            self.omega[samples],
            self.alpha[samples],
            self.origin[samples],
            self.acceleration[samples],
            self.joint[samples],
            self.beyond,
        )

    def scale(self, factor: float) -> PlanarMotion:
        """Return the motion with all lengths multiplied by a factor."""
        return replace(
            self, origin=self.origin * factor, acceleration=self.acceleration * factor, joint=self.joint * factor
        )

    def tilt(self, angle: float) -> PlanarMotion:
        """Return the motion turned about the plane frame's origin by an angle, rad; gravity keeps its direction."""
        turn = np.asarray(angle)
        return replace(
            self,
            angle=self.angle + angle,
            origin=planar.rotate(turn, self.origin),
            acceleration=planar.rotate(turn, self.acceleration),
            joint=planar.rotate(turn, self.joint),
        )


def chain_motion(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> PlanarMotion:
    """Return the motion of the segments of a pinned chain on a fixed base.

    Parameters
    ----------
    centres : (n, 2) or (T, n, 2) array
        Centre of joint j in the frame of segment j - 1, m.
    q, dq, ddq : (T, n) arrays
        Joint angles, rad, and their time derivatives.

    Returns
    -------
    PlanarMotion
        Motion of n + 1 segments, base first.
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
    """Return the acceleration of a point at ``arm`` (..., 2) in a rotating body, relative to the body's origin."""
    turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    acceleration: FloatArray = alpha[..., None] * turned - (omega**2)[..., None] * arm
    return acceleration
