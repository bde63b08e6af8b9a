"""Exact state and forces of a simulated trial at any time, by the recursive dynamics of the chain in SE(3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import inverse_dynamics, planar
from mocap_id.workflows.simulate.body import GRAVITY, Body
from mocap_id.workflows.simulate.motion import Motion
from mocap_id.workflows.simulate.rail import POINT, TRUNK, Rail
from mocap_id.workflows.simulate.sit_to_stand import Chair

UP = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
THIGH = 2  # the link that the chair pushes on


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

    @property
    def cop_x(self) -> FloatArray:
        """Centre of pressure of the ground's force, (T,) m."""
        cop: FloatArray = self.wrench[:, 2] / self.wrench[:, 1]
        return cop


def exact(body: Body, motion: Motion, chair: Chair | None, time: FloatArray, rail: Rail | None = None) -> Exact:
    """State and forces at times (T,), s."""
    q, qd, qdd, qddd = motion.at(time)
    centres = body.centres
    angle, origin = planar.segment_poses(q, centres)
    loads = inverse_dynamics(planar.spatial_chain(centres), body.inertias, q, qd, qdd, base_acceleration=UP)
    total, tau = loads.base_wrench[:, [0, 1, 5]], loads.effort
    force, point = np.zeros((len(time), 2)), np.full((len(time), 2), np.nan)
    ground = total
    if chair is not None:
        point = origin[:, THIGH] + planar.rotate(angle[:, THIGH], np.array(chair.point))
        vertical = chair.load(time) * total[:, 1]
        force = np.column_stack([chair.friction * vertical, vertical])
        # what the chair carries, no joint below its point of contact and no plate has to
        tau = tau - np.where(np.arange(1, len(centres) + 1) <= THIGH, _moment(point[:, None] - origin[:, 1:], force), 0)
        ground = total - np.column_stack([force, _moment(point[:, None], force)])
    if rail is not None:
        hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(POINT))
        held = np.column_stack([np.zeros(len(time)), rail.load(time) * total[:, 1]])
        tau = tau - _moment(hand[:, None] - origin[:, 1:], held)
        ground = ground - np.column_stack([held, _moment(hand[:, None], held)])
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
        chair_force=force,
        chair_point=point,
        wrench=ground,
        tau=tau,
    )


def _moment(arm: FloatArray, force: FloatArray) -> FloatArray:
    """Moments (T, k) of forces (T, 2) at arms (T, k, 2), about z."""
    return arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]
