"""Composite inertia of a planar chain: the wrench and torques for a unit acceleration of each joint.

From the tip to the base, the segments beyond joint k are treated as one body with a mass, a first moment U_k and a
second moment Q_k about joint k. A unit acceleration of joint k requires the force z × U_k and, about an earlier joint
j, the moment

    ∫ (p - p_j) · (p - p_k) dm = Q_k + U_k · (p_k - p_j),

which is an element of the mass matrix. The regressor at rest, without gravity and with a unit acceleration, gives the
same result but takes much longer. With a unit mass at each marker, the mass matrix is the information of the markers on
the joint angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import planar


@dataclass(frozen=True)
class CompositeInertia:
    """Derivatives with respect to the joint accelerations."""

    # (T, 3, n) derivatives of (Fx, Fy, tauz) of the ground about the origin of the plane frame, N and N·m per rad/s²
    wrench: FloatArray
    torque: FloatArray  # (T, n, n) derivatives of the joint torques: the mass matrix, kg·m²


def composite_inertia(
    q: FloatArray, centres: FloatArray, mass: FloatArray, first: FloatArray, second: FloatArray
) -> CompositeInertia:
    """Return the wrench and torques for a unit acceleration of each joint, in every posture; NaN for missing angles.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad; NaN where missing.
    mass : (n + 1,) array
        Mass of every segment, base first, kg. The mass of the base has no effect, because no joint moves the base.
    first : (n + 1, 2) array
        First moments in the frame of each segment, kg·m.
    second : (n + 1,) array
        Moments of inertia about the origin of each segment's frame, kg·m².
    """
    size, joints = q.shape
    angle, origin = planar.segment_poses(q, centres)
    wrench, torque = np.empty((size, 3, joints)), np.empty((size, joints, joints))
    total, moment, spread = (
        0.0,
        np.zeros((size, 2)),
        np.zeros(size),
    )  # mass and moments of all segments beyond the joint
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
    return CompositeInertia(wrench, torque)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of plane vectors (T, 2)."""
    product: FloatArray = a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
    return product
