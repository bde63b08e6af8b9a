"""Geometric regressor: the wrench and the joint torques as linear maps of the inertial parameters (thesis 4.2.1).

A link has ten parameters, in the order of eq. 4.4: m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz, all about the origin of
the link's frame. Ixy is the element of the inertia matrix, -∫ x y dm. A planar link has four of these parameters: m,
mx, my, Izz. The columns are ordered from the base to the tip. Gravity is modelled as an upward acceleration of the
base.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.motion import PlanarMotion, move_chain, point_acceleration
from mocap_id.geometry import Chain, link_motion, planar, se3, so3, spatial_jacobian

if TYPE_CHECKING:
    from mocap_id.dynamics.space.motion import SpatialMotion

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
    """Return the regressor Y_i (..., 6, 10) of the wrench on one link, in the link frame (eq. 4.17, 4.18).

    ``velocity`` and ``acceleration`` (..., 6) are the body velocity and its derivative, in the link frame.
    """
    return momentum_regressor(acceleration) - np.swapaxes(se3.ad(velocity), -1, -2) @ momentum_regressor(velocity)


def spatial_regressor(
    chain: Chain, q: FloatArray, dq: FloatArray, ddq: FloatArray, base_acceleration: FloatArray
) -> FloatArray:
    """Return the regressor Y (..., 6, 10(n + 1)) of the ground's wrench on the whole chain (eq. 4.19-4.22).

    The product of Y with the full parameters, base first, is the wrench (F, τ) of the ground on the chain about the
    origin of the world frame, in world axes.

    Parameters
    ----------
    q, dq, ddq : (..., N) arrays
        Coordinates of the joints and their time derivatives.
    base_acceleration : (6,) array
        Acceleration of the base; ``(g·up, 0)`` for gravity.
    """
    moving = link_motion(chain, q, dq, ddq, base_acceleration)
    return bodies_regressor(chain.poses(q), moving.velocity, moving.acceleration)


def bodies_regressor(poses: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor (..., 6, 10K) of the wrench on K bodies about the origin of the world frame (eq. 4.19).

    ``poses`` (..., K, 4, 4) are the poses of the bodies' frames in the world frame. ``velocity`` and ``acceleration``
    (..., K, 6) are the body velocities and their time derivatives, in the bodies' frames.
    """
    to_world = np.swapaxes(se3.Ad(se3.inverse(poses)), -1, -2)  # (..., K, 6, 6)
    blocks = to_world @ link_regressor(velocity, acceleration)
    return np.moveaxis(blocks, -3, -2).reshape(*poses.shape[:-3], 6, -1)


def project_on_joints(jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray) -> FloatArray:
    """Return the joint torques (..., N, P) due to wrenches on single segments, in space or in the plane.

    The wrench through joint j is the sum of the wrenches on the segments beyond it. The product of this wrench with the
    joint's spatial twist, a column of the spatial Jacobian (eq. 2.47), is the torque. The wrenches are columns of a
    regressor or external wrenches (:mod:`mocap_id.dynamics.external_wrenches`).

    Parameters
    ----------
    jacobian : (..., c, N) array
        Spatial Jacobian; c is 6 in space and 3 in the plane.
    joint : (N,) int array
        Joint, from 1, to which each coordinate belongs.
    wrenches : (..., c, P) array
        Wrenches about the origin of the world or plane frame, in the axes of this frame.
    segment : (P,) int array
        Segment, from 0, on which each wrench acts.
    """
    torque = np.swapaxes(jacobian, -1, -2) @ wrenches
    return np.where(segment >= joint[:, None], torque, 0.0)


def spatial_torque_regressor(chain: Chain, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (..., N, 10(n + 1)) of the joint torques, given that of the wrench (..., 6, 10(n + 1)).

    ``q`` (..., N) are the coordinates; ``regressor`` is the result of :func:`spatial_regressor`.
    """
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


def torque_regressor(motion: PlanarMotion | SpatialMotion, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, N, p K) of the joint torques, given that of the wrench (T, c, p K) on K bodies.

    A body has p parameters. A row gives the moment about a joint of the wrench on the bodies beyond it, N·m; NaN where
    a joint has no centre.
    """
    torque = np.swapaxes(motion.jacobian, -1, -2) @ regressor
    distal = np.repeat(motion.beyond, regressor.shape[-1] // motion.beyond.shape[1], axis=1)
    return np.where(distal, torque, np.where(np.isnan(torque), np.nan, 0.0))


def planar_regressor(
    centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, gravity: float = 9.81
) -> FloatArray:
    """Return the regressor (T, 3, 4(n + 1)) of the ground's wrench on a planar chain, with the segments base first.

    It equals :func:`spatial_regressor` for the same chain and is eighty times faster; a test compares the two.

    Parameters
    ----------
    centres : (n, 2) or (T, n, 2) array
        Centre of joint j in the frame of segment j - 1, m.
    gravity : float
        Gravitational acceleration along -y, m/s².
    """
    return wrench_regressor(move_chain(centres, q, dq, ddq), gravity)


def planar_torque_regressor(centres: FloatArray, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, n, 4(n + 1)) of the joint torques of a planar chain, given that of the wrench.

    tau_j is the torque of segment j - 1 on segment j, N·m: the moment about joint j of the wrench on the segments
    beyond it. ``centres`` and ``q`` are the arguments of :func:`planar_regressor`, and ``regressor`` is its result.
    """
    joints = np.arange(q.shape[1] + 1)
    jacobian = planar.spatial_jacobian(q, centres)
    return project_on_joints(jacobian, joints[1:], regressor, np.repeat(joints, len(PLANAR_PARAMETERS)))


def _cross_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z component of a × b for plane vectors (..., 2)."""
    product: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
