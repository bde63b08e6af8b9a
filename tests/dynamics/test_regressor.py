"""The regressor: against Pinocchio, against the recursive dynamics, against itself in the plane, by hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from dynamics_cases import BODY, CENTRES, random_chain, waves

from mocap_id.dynamics.regressor import (
    LINK_PARAMETERS,
    PLANAR_PARAMETERS,
    planar_regressor,
    planar_torque_regressor,
    spatial_regressor,
    spatial_torque_regressor,
)
from mocap_id.geometry import Chain, Revolute, inverse_dynamics, planar, se3, so3, spatial_inertia

PINOCCHIO = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
TO_PINOCCHIO = [LINK_PARAMETERS.index(name) for name in PINOCCHIO]
seeds = pytest.mark.parametrize("seed", range(6))


def random_spatial_chain(rng: np.random.Generator, joints: int) -> Chain:
    placements = se3.exp_twist(rng.normal(size=(joints, 6)))
    return Chain(tuple(Revolute(tuple(rng.normal(size=3))) for _ in range(joints)), placements)


def pinocchio_model(chain: Chain, up: np.ndarray) -> pin.Model:
    """The chain on a free-flying base, so that the base's six efforts are the ground's wrench."""
    model = pin.Model()
    model.gravity = pin.Motion(-up, np.zeros(3))
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    for i, (joint, placement) in enumerate(zip(chain.joints, chain.placements, strict=True)):
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, pin.SE3(placement), f"joint {i}")
    return model


@seeds
@pytest.mark.parametrize("joints", [1, 3, 5])
def test_wrench_and_torque_regressors_are_pinocchios(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    chain, up = random_spatial_chain(rng, joints), rng.normal(size=3)
    q, dq, ddq = rng.normal(size=(3, 4, joints))
    wrench = spatial_regressor(chain, q, dq, ddq, np.concatenate([up, np.zeros(3)]))
    torque = spatial_torque_regressor(chain, q, wrench)
    model = pinocchio_model(chain, up)
    rest, still = np.array([0, 0, 0, 0, 0, 0, 1.0]), np.zeros(6)
    for k in range(len(q)):
        data = model.createData()
        expected = pin.computeJointTorqueRegressor(
            model, data, np.r_[rest, q[k]], np.r_[still, dq[k]], np.r_[still, ddq[k]]
        ).reshape(6 + joints, joints + 1, 10)
        ours = np.concatenate([wrench[k], torque[k]]).reshape(6 + joints, joints + 1, 10)[..., TO_PINOCCHIO]
        np.testing.assert_allclose(ours, expected, atol=1e-9, rtol=0)


@seeds
def test_regressor_times_parameters_is_the_recursive_dynamics(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = 1 + seed % 4
    chain, up = random_spatial_chain(rng, joints), rng.normal(size=3)
    q, dq, ddq = rng.normal(size=(3, 7, joints))
    mass, centre = rng.uniform(0.5, 5, size=joints + 1), rng.normal(size=(joints + 1, 3))
    root = rng.normal(size=(joints + 1, 3, 3))
    about = root @ np.swapaxes(root, 1, 2)
    cross = so3.hat(centre)
    inertia = about - mass[:, None, None] * (cross @ cross)
    parameters = np.concatenate(
        [
            np.r_[m, m * c, [j[0, 0], j[1, 1], j[2, 2], j[0, 1], j[0, 2], j[1, 2]]]
            for m, c, j in zip(mass, centre, inertia, strict=True)
        ]
    )
    gravity = np.concatenate([up, np.zeros(3)])
    loads = inverse_dynamics(chain, spatial_inertia(mass, centre, about), q, dq, ddq, base_acceleration=gravity)
    wrench = spatial_regressor(chain, q, dq, ddq, gravity)
    np.testing.assert_allclose(wrench @ parameters, loads.base_wrench, atol=1e-10)
    np.testing.assert_allclose(spatial_torque_regressor(chain, q, wrench) @ parameters, loads.effort, atol=1e-10)


@seeds
@pytest.mark.parametrize("joints", [1, 2, 4])
def test_planar_regressor_is_the_spatial_one_in_the_plane(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    centres = random_chain(rng, joints)
    q, dq, ddq = rng.normal(size=(3, 9, joints))
    rows = [0, 1, 5]
    columns = [
        len(LINK_PARAMETERS) * link + LINK_PARAMETERS.index(name)
        for link in range(joints + 1)
        for name in PLANAR_PARAMETERS
    ]
    chain = planar.spatial_chain(centres)
    spatial = spatial_regressor(chain, q, dq, ddq, np.array([0, 9.81, 0, 0, 0, 0]))
    ours = planar_regressor(centres, q, dq, ddq)
    np.testing.assert_allclose(ours, spatial[:, rows][:, :, columns], atol=1e-12, rtol=0)
    torque = spatial_torque_regressor(chain, q, spatial)[:, :, columns]
    np.testing.assert_allclose(planar_torque_regressor(centres, q, ours), torque, atol=1e-12, rtol=0)


def test_a_pendulum_by_hand() -> None:
    """A point mass on a rod about a joint, θ from upright, straight from Newton."""
    centre = np.array([[0.1, 0.5]])
    theta, omega, alpha, m, r, g = 0.4, -1.3, 2.1, 3.0, 0.7, 9.81
    x, y = -r * np.sin(theta), r * np.cos(theta)
    force = m * np.array([-alpha * y - omega**2 * x, alpha * x - omega**2 * y + g])
    torque = x * force[1] - y * force[0]
    states = (np.array([[value]]) for value in (theta, omega, alpha))
    regressor = planar_regressor(centre, *states, gravity=g)
    parameters = np.r_[np.zeros(4), m, 0.0, m * r, m * r**2]
    position = centre[0] + [x, y]
    expected = [*force, position[0] * force[1] - position[1] * force[0]]
    np.testing.assert_allclose(regressor[0] @ parameters, expected, atol=1e-12)
    found = planar_torque_regressor(centre, np.array([[theta]]), regressor)[0] @ parameters
    np.testing.assert_allclose(found, [torque], atol=1e-12)


def test_standing_still_the_ground_carries_the_weight() -> None:
    still = np.zeros((1, 3))
    wrench = planar_regressor(CENTRES, np.array([[0.1, -0.2, 0.3]]), still, still) @ BODY.ravel()
    np.testing.assert_allclose(wrench[0, :2], [0.0, 9.81 * BODY[:, 0].sum()], atol=1e-12)


def test_power_of_torques_and_gravity_is_the_rate_of_kinetic_energy() -> None:
    """The torques do what the energy needs: d/dt (kinetic + potential) = τ · θ̇."""
    step = 1e-4
    time = 1.0 + step * np.arange(-2, 3)
    q, dq, ddq = waves(time, 3)
    torque = planar_torque_regressor(CENTRES, q, planar_regressor(CENTRES, q, dq, ddq)) @ BODY.ravel()
    energy = [kinetic(a, b) + potential(a) for a, b in zip(q, dq, strict=True)]
    rate = (energy[0] - 8 * energy[1] + 8 * energy[3] - energy[4]) / (12 * step)
    assert torque[2] @ dq[2] == pytest.approx(rate, rel=1e-8)


def kinetic(q: np.ndarray, dq: np.ndarray) -> float:
    """½ Σ (m v² + 2 v·(ω × mc) + I ω²) with everything about the segments' origins."""
    angle, _ = planar.segment_poses(q, CENTRES)
    velocity, omega, total = np.zeros(2), 0.0, 0.0
    for k, (m, mx, my, inertia) in enumerate(BODY):
        if k:
            arm = planar.rotate(angle[k - 1], CENTRES[k - 1])
            velocity = velocity + omega * np.array([-arm[1], arm[0]])
            omega = omega + dq[k - 1]
        moment = planar.rotate(angle[k], np.array([mx, my]))
        total += 0.5 * (m * velocity @ velocity + inertia * omega**2)
        total += omega * (velocity @ np.array([-moment[1], moment[0]]))
    return float(total)


def potential(q: np.ndarray) -> float:
    angle, origin = planar.segment_poses(q, CENTRES)
    moments = planar.rotate(angle, BODY[:, 1:3])
    return float(9.81 * np.sum(BODY[:, 0] * origin[:, 1] + moments[:, 1]))
