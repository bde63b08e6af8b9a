"""Recursive kinematics and dynamics of a serial chain (thesis 2.3.3, 2.4).

The motion is computed from base to tip, the wrenches from tip to base. Twists, accelerations and wrenches of link i are
in frame i, about its origin; the base is link 0. An acceleration is the time derivative of the six components of the
body velocity. Gravity is not a separate term: the base accelerates upwards with g, ``base_acceleration = (g·up, 0)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import se3, so3
from mocap_id.geometry.chain import Chain


@dataclass(frozen=True)
class LinkMotion:
    """Motion of every link, base first.

    Parameters
    ----------
    relative : (..., n, 4, 4) array
        Pose g_{i-1,i} of each link in the frame of the previous one.
    velocity, acceleration : (..., n + 1, 6) array
        Body velocity (m/s, rad/s) and its derivative (m/s², rad/s²) in the link's frame.
    """

    relative: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class JointLoads:
    """Wrenches that cause the motion.

    Parameters
    ----------
    joint_wrench : (..., n, 6) array
        Wrench of link i - 1 on link i, in frame i about its origin, N and N·m.
    effort : (..., N) array
        Generalised force of each joint coordinate; for a revolute joint its torque, N·m.
    base_wrench : (..., 6) array
        Wrench of the ground on the whole body, world frame, about the world origin.
    """

    joint_wrench: FloatArray
    effort: FloatArray
    base_wrench: FloatArray


def spatial_inertia(mass: FloatArray, centre: FloatArray, about_centre: FloatArray) -> FloatArray:
    """Return the spatial inertia matrix of a link about the origin of its frame (eq. 2.56).

    Parameters
    ----------
    mass : (...) array
        Mass, kg.
    centre : (..., 3) array
        Centre of mass in the link frame, m.
    about_centre : (..., 3, 3) array
        Moment-of-inertia matrix about the centre of mass, kg·m².

    Returns
    -------
    (..., 6, 6) array
        Maps a twist (v, ω) to momentum.
    """
    mass = np.asarray(mass, dtype=np.float64)[..., None, None]
    cross = so3.hat(centre)
    matrix = np.zeros((*np.broadcast_shapes(mass.shape[:-2], cross.shape[:-2]), 6, 6))
    matrix[..., :3, :3] = mass * np.eye(3)
    matrix[..., :3, 3:], matrix[..., 3:, :3] = -mass * cross, mass * cross
    matrix[..., 3:, 3:] = about_centre - mass * (cross @ cross)
    return matrix


def link_wrench(inertia: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the wrench (..., 6) that one link needs for its motion, in its frame about its origin (eq. 2.55)."""
    momentum = inertia @ velocity[..., None]
    gyroscopic = np.swapaxes(se3.ad(velocity), -1, -2) @ momentum
    return (inertia @ acceleration[..., None] - gyroscopic)[..., 0]


def link_motion(
    chain: Chain, q: FloatArray, dq: FloatArray, ddq: FloatArray, base_acceleration: FloatArray
) -> LinkMotion:
    """Return the velocities and accelerations of all links (eq. 2.50-2.53).

    Parameters
    ----------
    chain : Chain
    q, dq, ddq : (..., N) arrays
        Coordinates and their time derivatives.
    base_acceleration : (6,) array
        Acceleration of the base, which has zero velocity; ``(g·up, 0)`` for gravity.

    Returns
    -------
    LinkMotion
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
        :func:`spatial_inertia` of every link, base first.
    q, dq, ddq : (..., N) arrays
        Coordinates and their time derivatives.
    base_acceleration : (6,) array
        ``(g·up, 0)`` for gravity.
    applied : (..., n + 1, 6) array, optional
        Wrench of the surroundings other than the ground (such as a seat) on each link, in the link's frame. The thesis
        has the opposite sign: its Γ_E is the wrench of the body on the surroundings.

    Returns
    -------
    JointLoads
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
