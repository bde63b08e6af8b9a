"""Exact state and forces of a person of several bodies, by the same recursion as for the pinned chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import inverse_dynamics, link_motion, planar
from mocap_id.simulation.body import SimulatedBody
from mocap_id.simulation.forces import (
    UP,
    BodiesState,
    Chair,
    Rail,
    SegmentPoses,
    TrueState,
    compute_state,
    share_load,
)
from mocap_id.simulation.joint_motion import JointMotion
from mocap_id.simulation.multibody import LINKS, SLIDE, DividedBody
from mocap_id.simulation.multibody_motion import AdditionalMotion
from mocap_id.simulation.sit_to_stand import BalancedMotion, Plan, balance

_DISTAL = np.array([1, 2, 3, 3, 4])  # first segment distal to ankle, knee, hip, lumbar joint, shoulder; 4: the arms
_ROTATING = [LINKS[name] for name in ("foot", "shank", "thigh", "pelvis", "trunk", "arms")]
ROUNDS = 30
SETTLED = 1e-7  # rad


@dataclass(frozen=True)
class DividedPerson:
    """A person of several bodies, and the motion of their chain's coordinates."""

    body: DividedBody
    motion: JointMotion


def balance_divided(
    body: SimulatedBody, divided: DividedBody, plan: Plan, additional: AdditionalMotion
) -> tuple[BalancedMotion, DividedPerson]:
    """Return the balanced motion of the chain, and the person whose separate bodies balance about the plan's ``push``.

    The difference between the moments of the bodies and of the chain depends slightly on the lean. The difference and
    the lean are therefore computed in turn until the angles settle.

    NumericalError is raised if no lean of the trunk balances the body.
    """
    balanced = balance(body, plan)
    duration = plan.chair.schedule.duration
    angles = balanced.motion.at(plan.time)[0]
    for _ in range(ROUNDS):
        person = DividedPerson(divided, additional.motion(plan.time, angles, duration))
        difference = (
            compute_divided_state(person, None, plan.time).wrench_total
            - compute_state(body, balanced.motion, None, plan.time).wrench_total
        )
        balanced = balance(body, plan, difference[:, 2] - plan.push * difference[:, 1])
        before, angles = angles, balanced.motion.at(plan.time)[0]
        if np.abs(angles - before).max() < SETTLED:
            break
    return balanced, DividedPerson(divided, additional.motion(plan.time, angles, duration))


def compute_divided_state(
    person: DividedPerson, chair: Chair | None, time: FloatArray, rail: Rail | None = None
) -> TrueState:
    """Return state and forces of a person of several bodies at times (T,), s."""
    body = person.body
    coordinates = person.motion.at(time)
    loads = inverse_dynamics(body.chain, body.inertias, *coordinates[:3], base_acceleration=UP)
    total, effort, gap = loads.base_wrench[:, [0, 1, 5]], loads.effort, coordinates[0][:, 3:5]
    fx, fy, about_pelvis = loads.joint_wrench[:, SLIDE - 1, [0, 1, 5]].T
    about_thigh = about_pelvis + gap[:, 0] * fy - gap[:, 1] * fx
    torques = np.column_stack([effort[:, 1], effort[:, 2], about_thigh, effort[:, 6], effort[:, 7]])
    pose, velocity, acceleration = _body_motion(body, *coordinates[:3])
    # the shank's angle is the sum of foot and ankle; the trunk's angle from the thigh the sum of hip and lumbar joint
    q, qd, qdd, qddd = (np.column_stack([c[:, 0] + c[:, 1], c[:, 2], c[:, 5] + c[:, 6]]) for c in coordinates)
    angle = np.cumsum(q, axis=1)
    joints = _joint_centres(body, pose)
    still = np.zeros((len(time), 1))
    origin = np.concatenate([np.zeros((len(time), 1, 2)), joints[:, :3]], axis=1)
    poses = SegmentPoses(np.column_stack([still, angle]), origin, joints, _DISTAL)
    shared = share_load(poses, total, torques, time, chair=chair, rail=rail)
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


def _joint_centres(body: DividedBody, pose: FloatArray) -> FloatArray:
    """Return the positions (T, 5, 2) of ankle, knee, hip, lumbar joint and shoulder in the proximal bodies, m."""
    centres = np.array([part.centre for part in body.parts[1:6]])
    return pose[:, :5, :2] + planar.rotate(pose[:, :5, 2], centres)


def _body_motion(
    body: DividedBody, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pose, velocity and acceleration of every body's frame, (T, B, 3) each."""
    links, chain = body.links, body.chain
    motion = link_motion(chain, q, dq, ddq, np.zeros(6))
    origin = chain.poses(q)[..., :2, 3][:, links]
    # continuous angles: cumulative sums of all rotations
    rotation = np.cumsum(q[:, [0, 1, 2, 5, 6, 7]], axis=1)
    angle = rotation[:, [_ROTATING.index(link) for link in links]]
    twist, change = motion.velocity[:, links], motion.acceleration[:, links]
    spin, spin_rate = twist[..., 5], change[..., 5]
    velocity = planar.rotate(angle, twist[..., :2])
    # the derivative of a body velocity lacks the contribution of the frame's rotation
    acceleration = planar.rotate(angle, change[..., :2]) + spin[..., None] * _cross_z(velocity)
    offset = planar.rotate(angle, body.offsets)
    return (
        np.concatenate([origin + offset, angle[..., None]], axis=-1),
        np.concatenate([velocity + spin[..., None] * _cross_z(offset), spin[..., None]], axis=-1),
        np.concatenate(
            [
                acceleration + spin_rate[..., None] * _cross_z(offset) - spin[..., None] ** 2 * offset,
                spin_rate[..., None],
            ],
            axis=-1,
        ),
    )


def _cross_z(vector: FloatArray) -> FloatArray:
    """Return z × vectors (..., 2)."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
