"""Exact state and forces of a simulated trial, by recursive dynamics of the chain in SE(3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import inverse_dynamics, planar
from mocap_id.simulation.body import GRAVITY, SimulatedBody
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.supports import POINT, TRUNK, Chair, Rail

UP = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
THIGH = 2  # the link that the chair pushes on


@dataclass(frozen=True)
class BodiesState:
    """True motion of a person's separate bodies at times (T,), in the plane frame, SI units.

    Parameters
    ----------
    pose, velocity, acceleration : (T, B, 3) arrays
        Position x, y of each body frame's origin and angle of the frame, with their time derivatives.
    gap : (T, 2) array
        Displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y.
    tau : (T, 5) array
        Torques of ankle, knee, hip, lumbar joint and shoulder: moment about the joint centre in the proximal body of
        the wrench that the proximal body exerts on all distal bodies.
    """

    pose: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    gap: FloatArray
    tau: FloatArray


@dataclass(frozen=True)
class TrueState:
    """True state and forces at times (T,), in the plane frame, SI units.

    Parameters
    ----------
    time : (T,) array
    q, qd, qdd, qddd : (T, n) arrays
        Joint angles and their derivatives.
    seg_angle : (T, n) array
        Angle of segments 1…n from the plane frame.
    joint_xy : (T, n, 2) array
        Joint centres.
    com : (T, 2) array
        Centre of mass of the whole body, including the base.
    wrench_total : (T, 3) array
        (Fx, Fy, tauz) of ground, chair and rail together on the body.
    chair_force, chair_point : (T, 2) arrays
        Force of the chair on the thigh and its point of application, NaN without a chair.
    wrench : (T, 3) array
        Wrench of the ground alone, which the plate carries.
    tau : (T, n) array
        Torque of segment j - 1 on segment j.
    bodies : BodiesState or None
        Separate bodies of a person who differs from the chain. The angles are then those of shank, thigh and trunk, and
        the joint centres are those in foot, shank and thigh.
    """

    time: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    qddd: FloatArray
    seg_angle: FloatArray
    joint_xy: FloatArray
    com: FloatArray
    wrench_total: FloatArray
    chair_force: FloatArray
    chair_point: FloatArray
    wrench: FloatArray
    tau: FloatArray
    bodies: BodiesState | None = None

    @property
    def cop_x(self) -> FloatArray:
        """Centre of pressure on the ground, (T,) m."""
        cop: FloatArray = self.wrench[:, 2] / self.wrench[:, 1]
        return cop


@dataclass(frozen=True)
class SegmentPlacement:
    """Poses of the chain's segments, and the joint centres.

    Parameters
    ----------
    angle : (T, n + 1) array
        Angles of the segments, base first, rad.
    origin : (T, n + 1, 2) array
        Origins of the segments' frames, m.
    joints : (T, J, 2) array
        Joint centres, m.
    moves : (J,) int array
        First segment beyond each joint.
    """

    angle: FloatArray
    origin: FloatArray
    joints: FloatArray
    moves: IntArray


@dataclass(frozen=True)
class LoadShares:
    """Force and point of the chair (T, 2), wrench of the ground (T, 3) and joint torques ``tau`` (T, J)."""

    force: FloatArray
    point: FloatArray
    ground: FloatArray
    tau: FloatArray


def true_state(
    body: SimulatedBody, motion: JointMotion, chair: Chair | None, time: FloatArray, rail: Rail | None = None
) -> TrueState:
    """Return state and forces at times (T,), s."""
    q, qd, qdd, qddd = motion.at(time)
    centres = body.centres
    angle, origin = planar.segment_poses(q, centres)
    loads = inverse_dynamics(planar.spatial_chain(centres), body.inertias, q, qd, qdd, base_acceleration=UP)
    total, tau = loads.base_wrench[:, [0, 1, 5]], loads.effort
    placed = SegmentPlacement(angle, origin, origin[:, 1:], np.arange(1, len(centres) + 1))
    shared = share_load(placed, total, tau, time, chair=chair, rail=rail)
    coms = planar.marker_positions(q, centres, np.arange(len(body.links)), body.coms)
    return TrueState(
        time=time,
        q=q,
        qd=qd,
        qdd=qdd,
        qddd=qddd,
        seg_angle=angle[:, 1:],
        joint_xy=origin[:, 1:],
        com=np.einsum("l,tlx->tx", body.masses / body.mass, coms),
        wrench_total=total,
        chair_force=shared.force,
        chair_point=shared.point,
        wrench=shared.ground,
        tau=shared.tau,
    )


def share_load(
    placed: SegmentPlacement,
    total: FloatArray,
    tau: FloatArray,
    time: FloatArray,
    *,
    chair: Chair | None,
    rail: Rail | None,
) -> LoadShares:
    """Divide the total wrench (T, 3) between ground, chair and rail, and correct the joint torques (T, J)."""
    angle, origin, joints = placed.angle, placed.origin, placed.joints
    force, point = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    ground = total
    if chair is not None:
        point = origin[:, THIGH] + planar.rotate(angle[:, THIGH], np.array(chair.point))
        vertical = chair.load(time) * total[:, 1]
        force = np.column_stack([chair.friction * vertical, vertical])
        # the joints below the point of contact and the plate do not carry the chair's share
        tau = tau - np.where(placed.moves <= THIGH, _moment(point[:, None] - joints, force), 0)
        ground = total - np.column_stack([force, _moment(point[:, None], force)])
    if rail is not None:
        hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(POINT))
        carried = np.column_stack([np.zeros(len(time)), rail.load(time) * total[:, 1]])
        tau = tau - np.where(placed.moves <= TRUNK, _moment(hand[:, None] - joints, carried), 0)
        ground = ground - np.column_stack([carried, _moment(hand[:, None], carried)])
    return LoadShares(force, point, ground, tau)


def _moment(arm: FloatArray, force: FloatArray) -> FloatArray:
    """Return the moments about z (T, k) of forces (T, 2) with lever arms (T, k, 2)."""
    return arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]
