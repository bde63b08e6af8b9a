"""The regressor in space: against Pinocchio, against the chain of screws, and under rotations of the laboratory."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from space_cases import random_base, random_bodies, random_chain

from mocap_id.dynamics.regressor import LINK_PARAMETERS, spatial_regressor, torque_regressor
from mocap_id.dynamics.space.consistency import change_of_frame
from mocap_id.dynamics.space.preparation import move_joints, move_segments, segment_regressor
from mocap_id.geometry import Ball, Chain, Revolute, se3, so3

TO_PINOCCHIO = [LINK_PARAMETERS.index(n) for n in ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")]
seeds = pytest.mark.parametrize("seed", range(4))
BALLS = ("ball", "ball", "ball")
MIXED = ("hinge", "ball", "two-axis", "hinge")


@seeds
def test_balls_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain, base = random_chain(rng, BALLS), random_base(rng)
    states = rng.normal(size=(3, 3, 9))
    motion = move_joints(chain, base, *states)
    wrench = segment_regressor(motion)
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0, -9.81, 0]), np.zeros(3))
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    placed = pin.SE3(base)
    for k, joint in enumerate(chain.joints):
        at = placed * pin.SE3(np.eye(3), joint.centre) if k == 0 else pin.SE3(np.eye(3), joint.centre)
        parent = model.addJoint(parent, pin.JointModelSpherical(), at, f"joint {k}")
    ball = Ball()
    for t, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        position, speed, change = [np.array([0, 0, 0, 0, 0, 0, 1.0])], [np.zeros(6)], [np.zeros(6)]
        for own in np.split(np.arange(9), 3):
            subspace = ball.subspace(q[own])[3:]
            position.append(Rotation.from_rotvec(q[own]).as_quat())
            speed.append(subspace @ dq[own])
            change.append(subspace @ ddq[own] + ball.subspace_rate(q[own], dq[own])[3:] @ dq[own])
        expected = pin.computeJointTorqueRegressor(
            model, model.createData(), *(np.concatenate(each) for each in (position, speed, change))
        ).reshape(15, 4, 10)
        ours = wrench[t].reshape(6, 4, 10)[..., TO_PINOCCHIO]
        np.testing.assert_allclose(ours[:, 1:], expected[:6, 1:], atol=1e-9)
        torque = torque_regressor(motion, wrench)[t].reshape(3, 3, 4, 10)[..., TO_PINOCCHIO]
        for k in range(3):  # Pinocchio's are about the axes of the child, ours about those of the parent
            turned = np.einsum("ij,jkp->ikp", so3.exp(q[3 * k : 3 * k + 3]).T, torque[k])
            np.testing.assert_allclose(turned[:, 1:], expected[6 + 3 * k : 9 + 3 * k, 1:], atol=1e-9)


@seeds
def test_it_is_that_of_the_chain_of_screws(seed: int) -> None:
    """Each joint of two axes is two revolute joints with a link without mass between them."""
    rng = np.random.default_rng(seed)
    chain, base = random_chain(rng, MIXED), random_base(rng)
    joints, placements, links, before = [], [], [], base
    for joint in chain.joints:
        here = before @ se3.pose(np.eye(3), joint.centre)
        joints.append(Ball() if joint.kind == "ball" else Revolute(tuple(joint.first_axis)))
        placements.append(here)
        before = np.eye(4) if joint.kind == "ball" else se3.pose(joint.offset, np.zeros(3))
        if joint.kind == "two-axis":
            joints.append(Revolute(tuple(joint.second_axis)))
            placements.append(before)
            before = np.eye(4)
        links.append((len(joints), before))
    q, dq, ddq = rng.normal(size=(3, 5, 7))
    full = spatial_regressor(Chain(tuple(joints), np.stack(placements)), q, dq, ddq, np.array([0, 9.81, 0, 0, 0, 0]))
    bodies = random_bodies(rng, 5)
    motion = move_joints(chain, base, q, dq, ddq)
    ours = segment_regressor(motion) @ np.concatenate([np.zeros(10), bodies[1:].ravel()])
    on_screws = np.zeros((len(joints) + 1, 10))
    for (link, frame), body in zip(links, bodies[1:], strict=True):
        on_screws[link] += change_of_frame(frame) @ body
    np.testing.assert_allclose(ours, full @ on_screws.ravel(), atol=1e-10)


@seeds
def test_accelerations_are_the_derivatives_of_the_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain, base, step = random_chain(rng, MIXED, parents=(0, 1, 0, 3)), random_base(rng), 1e-4
    q, dq, ddq = rng.normal(size=(3, 1, 7))
    time = step * np.arange(-1, 2)[:, None]
    moving = move_joints(chain, base, q + time * dq + time**2 / 2 * ddq, dq + time * ddq, ddq + 0 * time)
    acceleration = (moving.origin[0] - 2 * moving.origin[1] + moving.origin[2]) / step**2
    np.testing.assert_allclose(moving.acceleration[1], acceleration, atol=1e-4)
    change = (moving.rotation[2] - moving.rotation[0]) / (2 * step)
    omega = so3.vee(change @ np.swapaxes(moving.rotation[1], 1, 2))
    np.testing.assert_allclose(moving.omega[1], omega, atol=1e-6)
    np.testing.assert_allclose(moving.alpha[1], (moving.omega[2] - moving.omega[0]) / (2 * step), atol=1e-6)
    again = move_segments(chain, base, moving.rotation[:, 1:], moving.omega[:, 1:], moving.alpha[:, 1:])
    np.testing.assert_allclose(again.acceleration, moving.acceleration)


def test_a_turned_laboratory_turns_the_wrench() -> None:
    rng = np.random.default_rng(0)
    chain, base, bodies = random_chain(rng, MIXED), random_base(rng), random_bodies(rng, 5).ravel()
    states = rng.normal(size=(3, 4, 7))
    turn = so3.exp(np.array([0.0, 0.7, 0.0]))  # about the vertical
    motion = move_joints(chain, base, *states)
    turned = move_joints(chain, se3.pose(turn, np.zeros(3)) @ base, *states)
    np.testing.assert_allclose(motion.rotate(turn).jacobian, turned.jacobian, atol=1e-12)
    wrench, expected = segment_regressor(turned) @ bodies, segment_regressor(motion) @ bodies
    np.testing.assert_allclose(wrench.reshape(-1, 2, 3), expected.reshape(-1, 2, 3) @ turn.T, atol=1e-10)
    torques = [torque_regressor(each, segment_regressor(each)) @ bodies for each in (motion, turned)]
    np.testing.assert_allclose(*torques, atol=1e-10)


def test_power_of_the_joints_is_the_rate_of_energy() -> None:
    """The rate of kinetic and potential energy is that of the torques, for hinges."""
    rng = np.random.default_rng(1)
    chain, base, bodies = random_chain(rng, ("hinge",) * 3), random_base(rng), random_bodies(rng, 4)
    q, dq, ddq = rng.normal(size=(3, 1, 3))
    step = 1e-4
    time = step * np.arange(-2, 3)[:, None]
    motion = move_joints(chain, base, q + time * dq + time**2 / 2 * ddq, dq + time * ddq, ddq + 0 * time)
    energy = np.zeros(5)
    speed = np.gradient(motion.origin, step, axis=0)
    for k, body in enumerate(bodies):
        inertia = np.array([[body[4], body[7], body[8]], [body[7], body[5], body[9]], [body[8], body[9], body[6]]])
        local = np.einsum("tji,tj->ti", motion.rotation[:, k], motion.omega[:, k])
        first = motion.rotation[:, k] @ body[1:4]
        energy += np.einsum("ti,ij,tj->t", local, inertia, local) / 2 + body[0] * np.sum(speed[:, k] ** 2, axis=1) / 2
        energy += np.sum(speed[:, k] * np.cross(motion.omega[:, k], first), axis=1)
        energy += 9.81 * (body[0] * motion.origin[:, k, 1] + first[:, 1])
    torque = torque_regressor(motion, segment_regressor(motion)) @ bodies.ravel()
    assert (energy[3] - energy[1]) / (2 * step) == pytest.approx(torque[2] @ dq[0], rel=1e-5)
