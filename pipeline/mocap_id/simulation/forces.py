"""Exact state and forces of a simulated trial at any time, by the recursive dynamics of the chain in SE(3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import inverse_dynamics, planar
from mocap_id.simulation.body import GRAVITY, Body
from mocap_id.simulation.motion import Motion
from mocap_id.simulation.rail import POINT, TRUNK, Rail
from mocap_id.simulation.sit_to_stand import Chair

UP = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
THIGH = 2  # the link that the chair pushes on


@dataclass(frozen=True)
class BodiesState:
    """The true bodies of a person who is more than the chain, at times (T,): plane frame, SI units.

    Parameters
    ----------
    pose, velocity, acceleration : (T, B, 3) arrays
        x and y of the origin of each body's frame and the frame's angle, and their time derivatives.
    gap : (T, 2) array
        Displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y.
    tau : (T, 5) array
        Torques of ankle, knee, hip, lumbar joint and shoulder: moment about the joint's place in the nearer body of all
        that the nearer body puts on those beyond.
    """

    pose: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    gap: FloatArray
    tau: FloatArray


@dataclass(frozen=True)
class Exact:
    """The truth at times (T,): plane frame, SI units.

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
        Centre of mass of everything, the base included.
    wrench_total : (T, 3) array
        (Fx, Fy, tauz) of ground, chair and rail together on the body.
    chair_force, chair_point : (T, 2) arrays
        Force of the chair on the thigh, and where; the point is NaN without a chair.
    wrench : (T, 3) array
        Of the ground alone, through the plate.
    tau : (T, n) array
        Torque of segment j - 1 on segment j.
    bodies : BodiesState or None
        Of a person of several bodies. The angles are then those of shank, thigh and trunk, as of a chain on the ground,
        and the joint centres are those of the foot, the shank and the thigh.
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
        """Centre of pressure of the ground's force, (T,) m."""
        cop: FloatArray = self.wrench[:, 2] / self.wrench[:, 1]
        return cop


@dataclass(frozen=True)
class Placed:
    """Where the chain's segments and the joints are.

    Parameters
    ----------
    angle : (T, n + 1) array
        Of the segments, base first, rad.
    origin : (T, n + 1, 2) array
        Of the segments' frames, m.
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
class Shared:
    """The chair's ``force`` and its ``point`` (T, 2), the ``ground``'s wrench (T, 3) and the torques ``tau`` (T, J)."""

    force: FloatArray
    point: FloatArray
    ground: FloatArray
    tau: FloatArray


def exact(body: Body, motion: Motion, chair: Chair | None, time: FloatArray, rail: Rail | None = None) -> Exact:
    """State and forces at times (T,), s."""
    q, qd, qdd, qddd = motion.at(time)
    centres = body.centres
    angle, origin = planar.segment_poses(q, centres)
    loads = inverse_dynamics(planar.spatial_chain(centres), body.inertias, q, qd, qdd, base_acceleration=UP)
    total, tau = loads.base_wrench[:, [0, 1, 5]], loads.effort
    placed = Placed(angle, origin, origin[:, 1:], np.arange(1, len(centres) + 1))
    shared = share(placed, total, tau, time, chair=chair, rail=rail)
    coms = planar.marker_positions(q, centres, np.arange(len(body.links)), body.coms)
    return Exact(
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


def share(
    placed: Placed, total: FloatArray, tau: FloatArray, time: FloatArray, *, chair: Chair | None, rail: Rail | None
) -> Shared:
    """What ground, chair and rail each carry of the total wrench (T, 3), and the torques (T, J) that are left."""
    angle, origin, joints = placed.angle, placed.origin, placed.joints
    force, point = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    ground = total
    if chair is not None:
        point = origin[:, THIGH] + planar.rotate(angle[:, THIGH], np.array(chair.point))
        vertical = chair.load(time) * total[:, 1]
        force = np.column_stack([chair.friction * vertical, vertical])
        # what the chair carries, no joint below its point of contact and no plate has to
        tau = tau - np.where(placed.moves <= THIGH, _moment(point[:, None] - joints, force), 0)
        ground = total - np.column_stack([force, _moment(point[:, None], force)])
    if rail is not None:
        hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(POINT))
        held = np.column_stack([np.zeros(len(time)), rail.load(time) * total[:, 1]])
        tau = tau - np.where(placed.moves <= TRUNK, _moment(hand[:, None] - joints, held), 0)
        ground = ground - np.column_stack([held, _moment(hand[:, None], held)])
    return Shared(force, point, ground, tau)


def _moment(arm: FloatArray, force: FloatArray) -> FloatArray:
    """Moments (T, k) of forces (T, 2) at arms (T, k, 2), about z."""
    return arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]
