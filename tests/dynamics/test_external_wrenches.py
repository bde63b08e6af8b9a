"""External wrenches in the regressor's equation: against Pinocchio, in space and in the plane, one path for both."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from dynamics_cases import random_chain

from mocap_id.dynamics.regressor import (
    LINK_PARAMETERS,
    PLANAR_PARAMETERS,
    number_joints,
    planar_regressor,
    planar_torque_regressor,
    project_on_joints,
    spatial_regressor,
    spatial_torque_regressor,
    sum_external,
)
from mocap_id.geometry import Chain, Revolute, planar, se3, so3, spatial_jacobian

seeds = pytest.mark.parametrize("seed", range(6))
lengths = pytest.mark.parametrize("joints", [1, 2, 4])
IN_PLANE = [0, 1, 5]


def random_spatial_chain(rng: np.random.Generator, joints: int) -> Chain:
    placements = se3.exp_twist(rng.normal(size=(joints, 6)))
    return Chain(tuple(Revolute(tuple(rng.normal(size=3))) for _ in range(joints)), placements)


def random_bodies(rng: np.random.Generator, links: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses (L,), centres (L, 3) and inertias about them (L, 3, 3) of bodies that can exist."""
    mass, centre = rng.uniform(0.5, 5, size=links), rng.normal(size=(links, 3))
    arm = so3.hat(rng.normal(size=(links, 5, 3)))
    return mass, centre, -(mass[:, None, None] / 5) * (arm @ arm).sum(axis=1)


def parameters(mass: np.ndarray, centre: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Ten a link, about the link's origin."""
    cross = so3.hat(centre)
    j = about - mass[:, None, None] * (cross @ cross)
    rows = [mass[:, None], mass[:, None] * centre, j[:, [0, 1, 2], [0, 1, 2]], j[:, [0, 0, 1], [1, 2, 2]]]
    return np.concatenate(rows, axis=1).ravel()


class Pinocchio:
    """The chain on a free-flying base: the base's six efforts are the ground's wrench on it."""

    def __init__(self, chain: Chain, bodies: tuple[np.ndarray, np.ndarray, np.ndarray], up: np.ndarray) -> None:
        mass, centre, about = bodies
        self.model = pin.Model()
        self.model.gravity = pin.Motion(-up, np.zeros(3))
        parent = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        self.model.appendBodyToJoint(parent, pin.Inertia(mass[0], centre[0], about[0]), pin.SE3.Identity())
        for i, (joint, placement) in enumerate(zip(chain.joints, chain.placements, strict=True), start=1):
            kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
            parent = self.model.addJoint(parent, kind, pin.SE3(placement), f"joint {i}")
            self.model.appendBodyToJoint(parent, pin.Inertia(mass[i], centre[i], about[i]), pin.SE3.Identity())

    def efforts(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, wrenches: np.ndarray, segment: np.ndarray
    ) -> np.ndarray:
        """rnea with wrenches (6, K), world frame about its origin, on these segments; (6 + N,)."""
        data = self.model.createData()
        at_rest = np.r_[0, 0, 0, 0, 0, 0, 1.0, q]
        pin.forwardKinematics(self.model, data, at_rest)
        total = [pin.Force(np.zeros(6)) for _ in range(self.model.njoints)]
        for wrench, on in zip(wrenches.T, segment, strict=True):
            total[on + 1] += data.oMi[int(on) + 1].actInv(pin.Force(wrench))  # Pinocchio's forces are local
        external = pin.StdVec_Force()
        external.extend(total)
        still = np.zeros(6)
        return np.asarray(pin.rnea(self.model, data, at_rest, np.r_[still, dq], np.r_[still, ddq], external))


def in_space(
    chain: Chain, up: np.ndarray, states: np.ndarray, phi: np.ndarray, loads: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Ground's wrench and torques (T, 6 + N) by the spatial ten-parameter form; loads (T, 6, K) on segments (K,)."""
    q, (wrenches, segment) = states[0], loads
    regressor = spatial_regressor(chain, *states, np.concatenate([up, np.zeros(3)]))
    ground, torque = sum_external(spatial_jacobian(chain, q), number_joints(chain), wrenches, segment)
    return np.hstack([regressor @ phi - ground, spatial_torque_regressor(chain, q, regressor) @ phi - torque])


def in_plane(
    centres: np.ndarray, states: np.ndarray, phi: np.ndarray, wrenches: np.ndarray, segment: np.ndarray
) -> np.ndarray:
    """Ground's wrench and torques (T, 3 + n) by the planar form; wrenches (T, 3, K)."""
    q = states[0]
    regressor = planar_regressor(centres, *states)
    joints = np.arange(1, len(centres) + 1)
    ground, torque = sum_external(planar.joint_twists(q, centres), joints, wrenches, segment)
    return np.hstack([regressor @ phi - ground, planar_torque_regressor(centres, q, regressor) @ phi - torque])


@seeds
@lengths
def test_ground_and_torques_in_space_are_pinocchios(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    chain, bodies, up = random_spatial_chain(rng, joints), random_bodies(rng, joints + 1), 9.81 * rng.normal(size=3)
    states = rng.normal(size=(3, 4, joints))
    wrenches, segment = rng.normal(size=(4, 6, 3)) * 50, rng.integers(0, joints + 1, size=3)
    oracle = Pinocchio(chain, bodies, up)
    expected = [oracle.efforts(*state, each, segment) for *state, each in zip(*states, wrenches, strict=True)]
    found = in_space(chain, up, states, parameters(*bodies), (wrenches, segment))
    np.testing.assert_allclose(found, expected, atol=1e-9, rtol=1e-12)
    assert np.abs(found - in_space(chain, up, states, parameters(*bodies), (0 * wrenches, segment))).max() > 1.0


@seeds
@lengths
def test_ground_and_torques_in_the_plane_are_pinocchios(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    centres, states = random_chain(rng, joints), rng.normal(size=(3, 4, joints))
    bodies = random_bodies(rng, joints + 1)
    four = parameters(*bodies).reshape(joints + 1, 10)[:, [LINK_PARAMETERS.index(name) for name in PLANAR_PARAMETERS]]
    wrenches, segment = rng.normal(size=(4, 3, 3)) * 50, rng.integers(0, joints + 1, size=3)
    oracle = Pinocchio(planar.spatial_chain(centres), bodies, np.array([0, 9.81, 0]))
    whole = np.zeros((4, 6, 3))
    whole[:, IN_PLANE] = wrenches
    expected = np.array([oracle.efforts(*state, each, segment) for *state, each in zip(*states, whole, strict=True)])
    found = in_plane(centres, states, four.ravel(), wrenches, segment)
    np.testing.assert_allclose(found, expected[:, [*IN_PLANE, *range(6, 6 + joints)]], atol=1e-9, rtol=1e-12)


@seeds
@lengths
def test_the_plane_is_a_selection_of_space(seed: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    centres, q = random_chain(rng, joints), rng.normal(size=(9, joints))
    chain = planar.spatial_chain(centres)
    flat = planar.joint_twists(q, centres)
    np.testing.assert_allclose(flat, spatial_jacobian(chain, q)[:, IN_PLANE], atol=1e-12, rtol=0)
    wrenches, segment = rng.normal(size=(9, 6, 5)), rng.integers(0, joints + 1, size=5)
    joint = np.arange(1, joints + 1)
    ours = sum_external(flat, joint, wrenches[:, IN_PLANE], segment)
    wrenches[:, [2, 3, 4]] = 0.0
    whole = sum_external(spatial_jacobian(chain, q), number_joints(chain), wrenches, segment)
    np.testing.assert_allclose(ours[0], whole[0][:, IN_PLANE], atol=1e-12, rtol=0)
    np.testing.assert_allclose(ours[1], whole[1], atol=1e-12, rtol=0)


@seeds
def test_a_weight_hung_on_a_segment_is_that_segments_own_weight(seed: int) -> None:
    """At rest, a mass taken off a segment and its weight put on as an external wrench change nothing anywhere."""
    rng = np.random.default_rng(seed)
    centres, on, mass, place = random_chain(rng, 3), int(rng.integers(0, 4)), 7.0, rng.normal(size=2)
    states = np.zeros((3, 5, 3))
    states[0] = rng.normal(size=(5, 3))
    body = np.zeros((4, 4))
    body[on] = [mass, *(mass * place), mass * place @ place]
    carried = in_plane(centres, states, body.ravel(), np.zeros((5, 3, 0)), np.zeros(0, dtype=int))
    x = planar.marker_positions(states[0], centres, np.array([on]), place[None])[:, 0, 0]
    weight = -9.81 * mass * np.stack([0 * x, 1 + 0 * x, x], axis=1)[:, :, None]
    hung = in_plane(centres, states, 0 * body.ravel(), weight, np.array([on]))
    np.testing.assert_allclose(hung, carried, atol=1e-12)


def test_a_wrench_passes_through_the_joints_below_it_only() -> None:
    rng = np.random.default_rng(3)
    jacobian = planar.joint_twists(rng.normal(size=(2, 3)), random_chain(rng, 3))
    joint, wrench = np.arange(1, 4), rng.normal(size=(2, 3, 4))
    torque = project_on_joints(jacobian, joint, wrench, np.arange(4))
    np.testing.assert_array_equal(torque[0] != 0, joint[:, None] <= np.arange(4))
