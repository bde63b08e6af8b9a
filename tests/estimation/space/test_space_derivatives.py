"""Jacobians of markers, joints and segments equal finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from spatial_cases import mixed_chain, positions

from mocap_id.arrays import FloatArray
from mocap_id.estimation.space.frame_poses import degrees_of_freedom, group_columns, make_chain_model, make_track
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, locate_markers
from mocap_id.estimation.space.space_smoothing import compute_chain_rates, compute_rate_jacobians
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain

STEP = 1e-6


def random_pose(chain: SpatialChain, model: ChainModel, rng: np.random.Generator) -> Pose:
    pose = make_track(model, 1)
    pose.origin[:] = rng.normal(0, 1, 3)
    pose.rate[:] = rng.normal(0, 2, pose.rate.shape)
    return moved(chain, model, pose, rng.normal(0, 1, degrees_of_freedom(model)))


def moved(chain: SpatialChain, model: ChainModel, pose: Pose, by: FloatArray) -> Pose:
    """Move a pose by a tangent vector, from the definition."""
    new = Pose(*(each.copy() for each in pose))
    new.origin[0] += by[:3]
    new.turn[0, 0] = new.turn[0, 0] @ so3.exp(by[3:6])
    for k, (joint, own) in enumerate(zip(chain.joints, group_columns(model)[1:], strict=True)):
        if joint.kind == "ball":
            new.turn[0, k + 1] = new.turn[0, k + 1] @ so3.exp(by[own])
        else:
            new.angle[0, k, : joint.dimension] += by[own]
            new.turn[0, k + 1] = joint.rotation(new.angle[0, k, : joint.dimension])
    return new


@pytest.mark.parametrize("seed", range(3))
def test_markers_and_their_jacobian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = mixed_chain(rng)
    model = make_chain_model(chain)
    pose, d = random_pose(chain, model, rng), degrees_of_freedom(model)
    found, jacobian = np.empty((1, len(chain.segment), 3)), np.zeros((1, len(chain.segment), 3, d))
    locate_markers(model, pose, found, jacobian)

    def at(by: FloatArray) -> FloatArray:
        new = moved(chain, model, pose, by)
        return positions(chain, new.origin, new.turn[:, 0], new.turn[:, 1:])[0]

    np.testing.assert_allclose(found[0], at(np.zeros(d)), atol=1e-12)
    for c in range(d):
        by = STEP * np.eye(d)[c]
        np.testing.assert_allclose(jacobian[0, :, :, c], (at(by) - at(-by)) / (2 * STEP), atol=1e-8)


def test_rates_are_derivatives_along_a_movement() -> None:
    rng = np.random.default_rng(5)
    chain = mixed_chain(rng)
    model = make_chain_model(chain)
    speed = rng.normal(0, 1, degrees_of_freedom(model))
    dt = 1e-3
    poses = [random_pose(chain, model, np.random.default_rng(1))]
    poses += [moved(chain, model, poses[0], (k * dt + 0.5 * (k * dt) ** 2) * speed) for k in range(1, 7)]
    track = Pose(*(np.concatenate([getattr(each, name) for each in poses]) for name in Pose._fields))
    u = 1 + np.arange(7) * dt
    track.rate[:, 0], track.rate[:, 1] = u[:, None] * speed, speed  # constant axes: the rates are parallel
    turns = chain.place(track.origin, track.turn[:, 0], track.turn[:, 1:])[1]
    rates = compute_chain_rates(chain, model, track, turns)
    steps = so3.log(turns[1:] @ np.swapaxes(turns[:-1], -1, -2)) / dt
    np.testing.assert_allclose(rates.omega[2], (steps[1] + steps[2]) / 2, atol=1e-4)
    np.testing.assert_allclose(rates.alpha[2], (steps[2] - steps[1]) / dt, atol=5e-3)


def test_jacobians_of_the_rates() -> None:
    rng = np.random.default_rng(7)
    chain = mixed_chain(rng)
    model = make_chain_model(chain)
    pose, d = random_pose(chain, model, rng), degrees_of_freedom(model)

    def at(by: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        new = moved(chain, model, pose, by[:d])
        new.rate[0, 0] += by[d : 2 * d]
        new.rate[0, 1] += by[2 * d :]
        turns = chain.place(new.origin, new.turn[:, 0], new.turn[:, 1:])[1]
        found = compute_chain_rates(chain, model, new, turns)
        return turns[0], found.omega[0], found.alpha[0]

    middle = at(np.zeros(3 * d))
    rates = compute_chain_rates(chain, model, pose, middle[0][None])
    spin, omega, alpha = (each[0] for each in compute_rate_jacobians(chain, model, middle[0][None], rates))
    for c in range(3 * d):
        by = STEP * np.eye(3 * d)[c]
        up, down = at(by), at(-by)
        turned = so3.log(up[0] @ np.swapaxes(down[0], -1, -2)) / (2 * STEP)
        np.testing.assert_allclose(spin[:, :, c], turned, atol=1e-7)
        np.testing.assert_allclose(omega[:, :, c], (up[1] - down[1]) / (2 * STEP), atol=1e-6)
        np.testing.assert_allclose(alpha[:, :, c], (up[2] - down[2]) / (2 * STEP), atol=1e-5)
