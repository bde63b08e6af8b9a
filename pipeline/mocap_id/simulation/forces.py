"""Exact state and forces of a simulated trial, by recursive dynamics of the chain in SE(3), with chair and rail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import inverse_dynamics, planar
from mocap_id.simulation.body import GRAVITY, SimulatedBody
from mocap_id.simulation.joint_motion import JointMotion, smoothstep
from mocap_id.simulation.schedule import Schedule

UP = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
THIGH = 2  # the link that the chair pushes on
TRUNK = 3  # the link of the hand on the rail
HAND = (-0.30, 0.30)  # position of that hand in the trunk's frame, in front of the person, m


@dataclass(frozen=True)
class Chair:
    """A chair that pushes on a point of the thigh and carries a fraction of the total vertical force."""

    point: tuple[float, float]  # point on the underside of the thigh, near the hip, in the thigh's frame, m
    share: float  # fraction of the total vertical force while the person sits still
    friction: float  # horizontal force divided by vertical force
    schedule: Schedule

    def load(self, time: FloatArray) -> FloatArray:
        """Return the fraction (T,) of the total vertical force that the chair carries at times (T,)."""
        return self.share * self.schedule.chair_load(time)


@dataclass(frozen=True)
class Rail:
    """A rail that carries a fraction of the vertical force while the person rises; no plate measures its force."""

    share: float  # largest fraction of the total vertical force
    schedule: Schedule

    def load(self, time: FloatArray) -> FloatArray:
        """Return the fraction (T,) of the total vertical force that the rail carries at times (T,).

        The rail is loaded from the start of each rise until shortly before its end.
        """
        level = np.zeros_like(time)
        for each in self.schedule.repetitions:
            length = each.rise_end - each.rise_start
            level += smoothstep((time - each.rise_start) / (0.4 * length))
            level -= smoothstep((time - each.rise_start - 0.75 * length) / (0.25 * length))
        return self.share * level


@dataclass(frozen=True)
class BodiesState:
    """True motion of a person's separate bodies at times (T,), in the plane frame, SI units."""

    pose: FloatArray  # (T, B, 3) position x, y of each body frame's origin, and angle of the frame
    velocity: FloatArray  # (T, B, 3) first derivative of the pose
    acceleration: FloatArray  # (T, B, 3) second derivative of the pose
    gap: FloatArray  # (T, 2) displacement of the pelvis's hip centre from the thigh's, along the thigh's x and y
    # (T, 5) torques of ankle, knee, hip, lumbar joint and shoulder: the moment that the proximal body exerts on all
    # distal bodies, about the joint centre in the proximal body
    tau: FloatArray


@dataclass(frozen=True)
class TrueState:
    """True state and forces at times (T,), in the plane frame, SI units."""

    time: FloatArray  # (T,)
    q: FloatArray  # (T, n) joint angles
    qd: FloatArray  # (T, n) their derivatives, of order one to three
    qdd: FloatArray
    qddd: FloatArray
    seg_angle: FloatArray  # (T, n) angles of segments 1…n from the plane frame
    joint_xy: FloatArray  # (T, n, 2) joint centres
    com: FloatArray  # (T, 2) centre of mass of the whole body, including the base
    wrench_total: FloatArray  # (T, 3) Fx, Fy, tauz of ground, chair and rail together on the body
    chair_force: FloatArray  # (T, 2) force of the chair on the thigh
    chair_point: FloatArray  # (T, 2) its point of application; NaN without a chair
    wrench: FloatArray  # (T, 3) wrench of the ground alone, which the plate carries
    tau: FloatArray  # (T, n) torque of segment j - 1 on segment j
    # Separate bodies of a person who differs from the pinned chain. The angles are then those of shank, thigh and
    # trunk, and the joint centres are those in foot, shank and thigh.
    bodies: BodiesState | None = None

    @property
    def cop_x(self) -> FloatArray:
        """Centre of pressure on the ground, (T,) m."""
        return np.asarray(self.wrench[:, 2] / self.wrench[:, 1])


@dataclass(frozen=True)
class SegmentPoses:
    """Poses of the chain's segments, and the joint centres."""

    angle: FloatArray  # (T, n + 1) angles of the segments, base first, rad
    origin: FloatArray  # (T, n + 1, 2) origins of the segments' frames, m
    joints: FloatArray  # (T, J, 2) joint centres, m
    distal: IntArray  # (J,) first segment distal to each joint


@dataclass(frozen=True)
class LoadShares:
    """Loads after the division of the total wrench between ground, chair and rail."""

    force: FloatArray  # (T, 2) force of the chair, N
    point: FloatArray  # (T, 2) its point of application, m
    ground: FloatArray  # (T, 3) wrench of the ground, N and N·m
    tau: FloatArray  # (T, J) joint torques, N·m


def compute_state(
    body: SimulatedBody, motion: JointMotion, chair: Chair | None, time: FloatArray, rail: Rail | None = None
) -> TrueState:
    """Return state and forces of the pinned chain at times (T,), s."""
    q, qd, qdd, qddd = motion.at(time)
    centres = body.centres
    angle, origin = planar.segment_poses(q, centres)
    loads = inverse_dynamics(planar.spatial_chain(centres), body.inertias, q, qd, qdd, base_acceleration=UP)
    total, tau = loads.base_wrench[:, [0, 1, 5]], loads.effort
    poses = SegmentPoses(angle, origin, origin[:, 1:], np.arange(1, len(centres) + 1))
    shared = share_load(poses, total, tau, time, chair=chair, rail=rail)
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
    poses: SegmentPoses,
    total: FloatArray,
    tau: FloatArray,
    time: FloatArray,
    *,
    chair: Chair | None,
    rail: Rail | None,
) -> LoadShares:
    """Return ``total`` (T, 3) divided between ground, chair and rail, and ``tau`` (T, J) corrected for the division."""
    angle, origin, joints = poses.angle, poses.origin, poses.joints
    force, point = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    ground = total
    if chair is not None:
        point = origin[:, THIGH] + planar.rotate(angle[:, THIGH], np.array(chair.point))
        vertical = chair.load(time) * total[:, 1]
        force = np.column_stack([chair.friction * vertical, vertical])
        # the plate and the joints below the point of contact do not carry the chair's part of the load
        tau = tau - np.where(poses.distal <= THIGH, _moment(point[:, None] - joints, force), 0)
        ground = total - np.column_stack([force, _moment(point[:, None], force)])
    if rail is not None:
        hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(HAND))
        on_rail = np.column_stack([np.zeros(len(time)), rail.load(time) * total[:, 1]])
        tau = tau - np.where(poses.distal <= TRUNK, _moment(hand[:, None] - joints, on_rail), 0)
        ground = ground - np.column_stack([on_rail, _moment(hand[:, None], on_rail)])
    return LoadShares(force, point, ground, tau)


def _moment(arm: FloatArray, force: FloatArray) -> FloatArray:
    """Return the moments about z (T, k) of forces (T, 2) with lever arms (T, k, 2)."""
    return arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]
