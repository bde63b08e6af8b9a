"""Recursive kinematics and dynamics of a serial chain (thesis 2.3.3, 2.4).

The motion is computed from base to tip, and the wrenches from tip to base. Twists, accelerations and wrenches of link i
are in frame i, about its origin; the base is link 0. An acceleration is the time derivative of the six components of
the body velocity. Gravity enters as an upward acceleration g of the base: ``base_acceleration = (g·up, 0)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import se3, so3
from mocap_id.geometry.chain import Chain


@dataclass(frozen=True)
class LinkMotion:
    """Motion of all links, base first."""

    relative: FloatArray  # (..., n, 4, 4) pose g_{i-1,i} of each link in the frame of the previous link
    velocity: FloatArray  # (..., n + 1, 6) body velocities, m/s and rad/s
    acceleration: FloatArray  # (..., n + 1, 6) derivatives of the body velocities, m/s² and rad/s²


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
) -> LinkMotion:
    """Return the velocities and accelerations of all links for given coordinates (..., N) (eq. 2.50-2.53).

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
    return LinkMotion(relative, np.stack(velocity, axis=-2), np.stack(acceleration, axis=-2))


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

    Parameters
    ----------
    chain : Chain
    inertias : (n + 1, 6, 6) array
        :func:`spatial_inertia` of all links, base first.
    q, dq, ddq : (..., N) arrays
        Coordinates and their time derivatives.
    base_acceleration : (6,) array
        Acceleration of the base, ``(g·up, 0)`` for gravity.
    applied : (..., n + 1, 6) array, optional
        Other external wrenches on the links (for example, from a seat), in the links' frames. The thesis has the
        opposite sign: its Γ_E is the wrench of the body on the surroundings.
    """
    moving = link_motion(chain, q, dq, ddq, base_acceleration)
    needed = link_wrench(inertias, moving.velocity, moving.acceleration)
    if applied is not None:
        needed = needed - applied
    total = needed[..., -1, :]
    wrenches, efforts = [], []
    for i in reversed(range(len(chain.joints))):
        subspace = chain.joints[i].subspace(q[..., chain.slices[i]])
        wrenches.append(total)
        efforts.append((np.swapaxes(subspace, -1, -2) @ total[..., None])[..., 0])
        total = needed[..., i, :] + se3.move_wrench(moving.relative[..., i, :, :], total)
    return JointLoads(np.stack(wrenches[::-1], axis=-2), np.concatenate(efforts[::-1], axis=-1), total)
