"""Bodies that move by themselves: their wrench against Newton for points, Pinocchio, and the chain's regressor."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from dynamics_cases import CENTRES, random_chain, waves
from pose_cases import SHOULDER, moving

from mocap_id.dynamics.regressor import (
    PlanarMotion,
    move_chain,
    planar_torque_regressor,
    torque_regressor,
    wrench_regressor,
)
from mocap_id.geometry import planar

TIME = np.arange(40) / 20
seeds = pytest.mark.parametrize("seed", range(3))


def free_bodies(time: np.ndarray, seed: int, count: int = 3) -> PlanarMotion:
    """Bodies whose x, y and angle are sums of sines, each by itself."""
    value, _, rise = waves(time, 3 * count, seed)
    _, speed, _ = waves(time, 3 * count, seed)
    pose, rate, bend = (each.reshape(len(time), count, 3) for each in (value, speed, rise))
    nowhere = np.full((len(time), 1, 2), np.nan)
    beyond = np.ones((1, count), dtype=bool)
    return PlanarMotion(rate[..., 2], bend[..., 2], pose[..., :2], bend[..., :2], nowhere, beyond, pose[..., 2])


def clouds(seed: int, count: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point masses (count, 4), their places in the body's frame (count, 4, 2), and m, mx, my, Izz (count, 4)."""
    rng = np.random.default_rng(seed)
    mass, place = rng.uniform(0.5, 4.0, size=(count, 4)), rng.uniform(-0.4, 0.4, size=(count, 4, 2))
    first = np.einsum("kp,kpc->kc", mass, place)
    second = np.einsum("kp,kpc->k", mass, place**2)
    return mass, place, np.column_stack([mass.sum(axis=1), first, second])


@seeds
def test_the_wrench_is_newton_s_for_points(seed: int) -> None:
    """Accelerations by finite differences of where the points are."""
    mass, place, full = clouds(seed)
    step = 1e-3

    def points(time: np.ndarray) -> np.ndarray:
        motion = free_bodies(time, seed)
        return motion.origin[:, :, None] + planar.rotate(motion.angle[:, :, None], place)

    now = points(TIME)
    near, far = points(TIME - step) + points(TIME + step), points(TIME - 2 * step) + points(TIME + 2 * step)
    force = mass[..., None] * ((16 * near - far - 30 * now) / (12 * step**2) + [0.0, 9.81])
    moment = now[..., 0] * force[..., 1] - now[..., 1] * force[..., 0]
    expected = np.column_stack([force.sum(axis=(1, 2)), moment.sum(axis=(1, 2))])
    found = wrench_regressor(free_bodies(TIME, seed)) @ full.ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@seeds
def test_the_wrench_is_the_rate_of_momentum_and_angular_momentum(seed: int) -> None:
    """About the plane frame's origin, without gravity; velocities by the poses' own rates."""
    full, step = clouds(seed)[2], 1e-3

    def momentum(time: np.ndarray) -> np.ndarray:
        motion = free_bodies(time, seed)
        speed = (free_bodies(time + 1e-5, seed).origin - free_bodies(time - 1e-5, seed).origin) / 2e-5
        m, inertia = full[:, 0], full[:, 3]
        moment = planar.rotate(motion.angle, full[:, 1:3])  # Σ m (r - origin)
        turned = np.stack([-moment[..., 1], moment[..., 0]], axis=-1)
        linear = m[:, None] * speed + motion.omega[..., None] * turned
        x, y = motion.origin[..., 0], motion.origin[..., 1]
        spin = inertia * motion.omega + moment[..., 0] * speed[..., 1] - moment[..., 1] * speed[..., 0]
        spin = spin + x * linear[..., 1] - y * linear[..., 0]
        return np.concatenate([linear, spin[..., None]], axis=-1).sum(axis=1)

    rate = (
        momentum(TIME - 2 * step) - 8 * momentum(TIME - step) + 8 * momentum(TIME + step) - momentum(TIME + 2 * step)
    ) / (12 * step)
    found = wrench_regressor(free_bodies(TIME, seed), gravity=0.0) @ full.ravel()
    np.testing.assert_allclose(found, rate, rtol=0, atol=1e-6 * np.abs(rate).max())


@seeds
def test_the_wrench_of_a_free_body_is_pinocchio_s(seed: int) -> None:
    m, mx, my, about = clouds(seed)[2][0]
    centre, motion = np.array([mx, my, 0.0]) / m, free_bodies(TIME, seed, 1)
    inertia = np.diag([1.0, 1.0, about - (mx**2 + my**2) / m])
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0, -9.81, 0.0]), np.zeros(3))
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(m, centre, inertia), pin.SE3.Identity())
    data, found = model.createData(), wrench_regressor(motion) @ [m, mx, my, about]
    speed = (free_bodies(TIME + 1e-5, seed, 1).origin - free_bodies(TIME - 1e-5, seed, 1).origin)[:, 0] / 2e-5
    for k, angle in enumerate(motion.angle[:, 0]):
        omega, alpha, place = motion.omega[k, 0], motion.alpha[k, 0], motion.origin[k, 0]
        v, a = planar.rotate(-angle, speed[k]), planar.rotate(-angle, motion.acceleration[k, 0])
        a = a - omega * np.array([-v[1], v[0]])  # the derivative of the components in the body
        q = np.array([*place, np.cos(angle), np.sin(angle)])
        local = pin.rnea(model, data, q, np.array([*v, omega]), np.array([*a, alpha]))
        force = planar.rotate(angle, local[:2])
        expected = [*force, local[2] + place[0] * force[1] - place[1] * force[0]]
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-6)


@seeds
def test_the_motion_of_a_chain_is_that_of_its_poses(seed: int) -> None:
    centres, step = random_chain(np.random.default_rng(seed), 4), 1e-3
    states = waves(TIME, 4, seed)
    motion = move_chain(centres, *states)
    moved = [move_chain(centres, *waves(TIME + k * step, 4, seed)) for k in (-2, -1, 1, 2)]

    def second(name: str) -> np.ndarray:
        back, before, after, ahead = (getattr(each, name) for each in moved)
        return (-back + 16 * before - 30 * getattr(motion, name) + 16 * after - ahead) / (12 * step**2)

    np.testing.assert_allclose(second("origin"), motion.acceleration, atol=1e-6)
    np.testing.assert_allclose(second("angle"), motion.alpha, atol=1e-6)
    before, after = moved[1], moved[2]
    np.testing.assert_allclose((after.angle - before.angle) / (2 * step), motion.omega, atol=1e-4)
    np.testing.assert_array_equal(motion.joint, motion.origin[:, 1:])
    np.testing.assert_array_equal(motion.beyond, np.tri(5, 4, -1, dtype=bool).T)


@seeds
def test_the_torques_of_a_chain_are_the_chain_s(seed: int) -> None:
    centres = random_chain(np.random.default_rng(seed), 3)
    states = waves(TIME, 3, seed)
    motion = move_chain(centres, *states)
    regressor = wrench_regressor(motion)
    expected = planar_torque_regressor(centres, states[0], regressor)
    np.testing.assert_allclose(torque_regressor(motion, regressor), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(motion.jacobian, planar.joint_twists(states[0], centres), rtol=0, atol=1e-12)


def test_a_joint_without_a_centre_has_no_torque_and_spoils_no_other() -> None:
    motion = moving(TIME)
    joint = motion.joint.copy()
    joint[:, 1] = np.nan
    whole = torque_regressor(motion, wrench_regressor(motion))
    lost = PlanarMotion(**{**motion.__dict__, "joint": joint})
    torque = torque_regressor(lost, wrench_regressor(lost))
    assert np.isnan(torque[:, 1]).all()
    np.testing.assert_array_equal(torque[:, [0, 2]], whole[:, [0, 2]])


def test_what_a_joint_carries_is_felt_there_alone() -> None:
    """The arm hangs on the torso: every joint carries it, and none carries what is before it."""
    motion = moving(TIME)
    torque = torque_regressor(motion, wrench_regressor(motion)).reshape(len(TIME), 3, 5, 4)
    for joint in range(3):
        assert (torque[:, joint, : joint + 1] == 0.0).all()
        assert (np.abs(torque[:, joint, joint + 1 :]).max(axis=(0, 2)) > 0.1).all()
    whole = move_chain(np.vstack([CENTRES, SHOULDER]), *waves(TIME, 4))
    assert whole.beyond[:, 4].all()
