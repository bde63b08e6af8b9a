"""Exact state and forces of a person of several bodies, by the same recursion as for the pinned chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import inverse_dynamics, link_motion, planar
from mocap_id.simulation.body import SimulatedBody
from mocap_id.simulation.forces import UP, BodiesState, SegmentPlacement, TrueState, share_load, true_state
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.multibody import LINKS, SLIDE, LooseBody
from mocap_id.simulation.multibody_motion import Looseness
from mocap_id.simulation.sit_to_stand import Performance, Plan, balance
from mocap_id.simulation.supports import Chair, Rail

_MOVES = np.array([1, 2, 3, 3, 4])  # first segment beyond ankle, knee, hip, lumbar joint and shoulder; 4: the arms
ROUNDS = 30
SETTLED = 1e-7  # rad


@dataclass(frozen=True)
class LoosePerson:
    """A person of several bodies, and the motion of their chain's coordinates."""

    body: LooseBody
    motion: JointMotion


def perform_loose(
    body: SimulatedBody, apart: LooseBody, plan: Plan, looseness: Looseness
) -> tuple[Performance, LoosePerson]:
    """Solve for the lean with which the separate bodies balance about the plan's point ``push``.

    The moment that they add to the chain's depends slightly on the lean, so both are updated in turn until they agree.

    Raises
    ------
    NumericalError
        No lean of the trunk balances the body.
    """
    played = balance(body, plan)
    duration = plan.chair.schedule.duration
    angles = played.motion.at(plan.time)[0]
    for _ in range(ROUNDS):
        loose = LoosePerson(apart, looseness.motion(plan.time, angles, duration))
        more = (
            true_loose_state(loose, None, plan.time).wrench_total
            - true_state(body, played.motion, None, plan.time).wrench_total
        )
        played = balance(body, plan, more[:, 2] - plan.push * more[:, 1])
        before, angles = angles, played.motion.at(plan.time)[0]
        if np.abs(angles - before).max() < SETTLED:
            break
    return played, LoosePerson(apart, looseness.motion(plan.time, angles, duration))


def true_loose_state(loose: LoosePerson, chair: Chair | None, time: FloatArray, rail: Rail | None = None) -> TrueState:
    """Return state and forces at times (T,), s."""
    body = loose.body
    moves = loose.motion.at(time)
    loads = inverse_dynamics(body.chain, body.inertias, *moves[:3], base_acceleration=UP)
    total, effort, gap = loads.base_wrench[:, [0, 1, 5]], loads.effort, moves[0][:, 3:5]
    fx, fy, about_pelvis = loads.joint_wrench[:, SLIDE - 1, [0, 1, 5]].T
    about_thigh = about_pelvis + gap[:, 0] * fy - gap[:, 1] * fx
    torques = np.column_stack([effort[:, 1], effort[:, 2], about_thigh, effort[:, 6], effort[:, 7]])
    pose, velocity, acceleration = _moving(body, *moves[:3])
    # foot plus ankle give the shank's angle; hip plus lumbar joint give the trunk's
    q, qd, qdd, qddd = (np.column_stack([c[:, 0] + c[:, 1], c[:, 2], c[:, 5] + c[:, 6]]) for c in moves)
    angle = np.cumsum(q, axis=1)
    joints = _joints(body, pose)
    still = np.zeros((len(time), 1))
    origin = np.concatenate([np.zeros((len(time), 1, 2)), joints[:, :3]], axis=1)
    placed = SegmentPlacement(np.column_stack([still, angle]), origin, joints, _MOVES)
    shared = share_load(placed, total, torques, time, chair=chair, rail=rail)
    masses = np.array([part.mass for part in body.parts])
    coms = pose[..., :2] + planar.rotate(pose[..., 2], np.array([part.com for part in body.parts]))
    return TrueState(
        time=time,
        q=q,
        qd=qd,
        qdd=qdd,
        qddd=qddd,
        seg_angle=angle,
        joint_xy=joints[:, :3],
        com=np.einsum("b,tbx->tx", masses / masses.sum(), coms),
        wrench_total=total,
        chair_force=shared.force,
        chair_point=shared.point,
        wrench=shared.ground,
        tau=shared.tau[:, :3],
        bodies=BodiesState(pose, velocity, acceleration, gap, shared.tau),
    )


def _joints(body: LooseBody, pose: FloatArray) -> FloatArray:
    """Return the centres of ankle, knee, hip, lumbar joint and shoulder in the proximal bodies, (T, 5, 2) m."""
    beyond = np.array([part.centre for part in body.parts[1:6]])
    return pose[:, :5, :2] + planar.rotate(pose[:, :5, 2], beyond)


def _moving(
    body: LooseBody, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pose, velocity and acceleration of every body's frame, (T, B, 3) each."""
    links, chain = body.links, body.chain
    moving = link_motion(chain, q, dq, ddq, np.zeros(6))
    origin = chain.poses(q)[..., :2, 3][:, links]
    # continuous angles: cumulative sums of all rotations
    turned = np.cumsum(q[:, [0, 1, 2, 5, 6, 7]], axis=1)
    angle = turned[:, [_TURNS.index(link) for link in links]]
    twist, change = moving.velocity[:, links], moving.acceleration[:, links]
    spin, spun = twist[..., 5], change[..., 5]
    velocity = planar.rotate(angle, twist[..., :2])
    # the derivative of a body velocity lacks the contribution of the frame's rotation
    acceleration = planar.rotate(angle, change[..., :2]) + spin[..., None] * _across(velocity)
    offset = planar.rotate(angle, body.offsets)
    return (
        np.concatenate([origin + offset, angle[..., None]], axis=-1),
        np.concatenate([velocity + spin[..., None] * _across(offset), spin[..., None]], axis=-1),
        np.concatenate(
            [acceleration + spun[..., None] * _across(offset) - spin[..., None] ** 2 * offset, spun[..., None]], axis=-1
        ),
    )


_TURNS = [LINKS[name] for name in ("foot", "shank", "thigh", "pelvis", "trunk", "arms")]


def _across(vector: FloatArray) -> FloatArray:
    """Return z × vectors (..., 2)."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
