"""Motion of a body's segments in the plane: what the regressor needs of it, whatever it comes from.

Two sources give it. The chain's joint angles move segments that are pinned to each other (:func:`chain_motion`). The
measured poses of marker clusters move every body by itself (:mod:`mocap_id.dynamics.measured_motion`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry import planar


@dataclass(frozen=True)
class Motion:
    """Poses of K bodies, their derivatives, and the n joints between them, in the plane frame.

    Parameters
    ----------
    angle, omega, alpha : (T, K) arrays
        Angle of each body's frame, rad, and its time derivatives.
    origin, acceleration : (T, K, 2) arrays
        Origin of each body's frame, m, and its acceleration without gravity, m/s².
    joint : (T, n, 2) array
        Centres of the joints, m; NaN where both sides of a joint are one body.
    beyond : (n, K) bool array
        The bodies that a joint carries: those distal to it.
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
        """(T, 3, n) unit twists (p_y, -p_x, 1) of the joints: times a wrench, its moment about each joint."""
        x, y = self.joint[..., 0], self.joint[..., 1]
        return np.stack([y, -x, np.ones_like(x)], axis=1)


def chain_motion(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> Motion:
    """Motion of the segments of a pinned chain on a fixed base.

    Parameters
    ----------
    centres : (n, 2) array
        Centre of joint j in the frame of segment j - 1, m.
    q, dq, ddq : (T, n) arrays
        Joint angles, rad, and their time derivatives.

    Returns
    -------
    Motion
        Of n + 1 segments, base first.
    """
    angle, origin = planar.segment_poses(q, centres)  # (T, n + 1), (T, n + 1, 2)
    omega = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(dq, axis=1)], axis=1)
    alpha = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(ddq, axis=1)], axis=1)
    acceleration = np.zeros_like(origin)
    steps = point_acceleration(np.diff(origin, axis=1), omega[:, :-1], alpha[:, :-1])
    acceleration[:, 1:] = np.cumsum(steps, axis=1)
    joints = len(centres)
    beyond: BoolArray = np.arange(joints + 1) > np.arange(joints)[:, None]
    return Motion(angle, omega, alpha, origin, acceleration, origin[:, 1:], beyond)


def point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Acceleration of a point at ``arm`` (..., 2) from the origin of a body that turns, relative to that origin."""
    turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    acceleration: FloatArray = alpha[..., None] * turned - (omega**2)[..., None] * arm
    return acceleration
