"""States of simulated arms: accuracy, intervals, gaps, outliers, and independence of the laboratory's axes."""

from __future__ import annotations

import numpy as np
import pytest
from spatial_cases import UP, arm, true_chain

from mocap_id.arrays import FloatArray
from mocap_id.estimation.space import SpatialStates, smooth_in_space
from mocap_id.geometry import so3
from mocap_id_simulation import SimulatedSpaceTrial, SpaceRobotOptions, generate_space_robot
from mocap_id_simulation.space_robot import FRAME

GAP = slice(900, 1080)  # 1.5 s


@pytest.fixture(scope="module")
def trial() -> SimulatedSpaceTrial:
    return arm(23)


@pytest.fixture(scope="module")
def points(trial: SimulatedSpaceTrial) -> FloatArray:
    return np.ascontiguousarray(trial.positions @ UP.T)


@pytest.fixture(scope="module")
def states(trial: SimulatedSpaceTrial, points: FloatArray) -> SpatialStates:
    return smooth_in_space(points, trial.rate, true_chain(trial))


def rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))


def test_accuracy_and_intervals(trial: SimulatedSpaceTrial, states: SpatialStates) -> None:
    later = trial.time > trial.still + 0.5
    omega, alpha = states.omega - trial.omega @ UP.T, states.alpha - trial.alpha @ UP.T
    assert rms(omega[later, 2]) < 0.1
    assert rms(alpha[later, 2]) < 0.8
    assert rms((states.origins - trial.origins @ UP.T)[later, 2]) < 4e-3
    for error, sd in ((omega, states.sd_omega), (alpha, states.sd_alpha)):
        held = np.mean(np.abs(error[later]) < 1.96 * sd[later][..., None], axis=(0, 2))
        assert np.all(held > 0.85)
        assert np.all(sd[later].mean(axis=0)[1:] < 3 * np.sqrt(np.mean(error[later, 1:] ** 2, axis=(0, 2))))
    assert states.observed.all()


def test_the_laboratorys_axes_do_not_matter(
    trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates
) -> None:
    turn = so3.exp(np.array([0.4, -1.1, 0.7]))
    turned = smooth_in_space(points @ turn.T, trial.rate, true_chain(trial))
    np.testing.assert_allclose(turned.omega, states.omega @ turn.T, atol=1e-3)
    np.testing.assert_allclose(turned.alpha, states.alpha @ turn.T, atol=2e-2)
    np.testing.assert_allclose(turned.sd_alpha, states.sd_alpha, rtol=2e-2)


def test_a_gap_is_bridged_or_not_given(trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates) -> None:
    hidden = points.copy()
    hidden[GAP, np.asarray(trial.assignment) >= 2] = np.nan  # forearm and hand
    found = smooth_in_space(hidden, trial.rate, true_chain(trial))
    inside = slice(GAP.start + 15, GAP.stop - 15)
    assert not found.observed[inside, 2:].any()
    assert found.observed[inside, :2].all()
    lost = np.isnan(found.omega[:, 2, 0])
    assert lost[GAP].any()
    assert not lost[: GAP.start].any()
    assert not lost[GAP.stop + 5 :].any()
    given = np.flatnonzero(~lost[GAP]) + GAP.start
    off = np.linalg.norm(so3.log(np.swapaxes(found.rotations[given, 2], 1, 2) @ states.rotations[given, 2]), axis=1)
    assert np.mean(off < 3 * np.sqrt(3) * found.sd_rotation[given, 2]) > 0.9
    np.testing.assert_allclose(found.omega[GAP.stop + 120 :, 2], states.omega[GAP.stop + 120 :, 2], atol=0.05)


def test_outliers_are_left_out(trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates) -> None:
    rng = np.random.default_rng(0)
    hit = rng.random(points.shape[:2]) < 0.01
    wild = points + np.where(hit[..., None], rng.normal(0, 0.3, points.shape), 0.0)
    found = smooth_in_space(wild, trial.rate, true_chain(trial))
    assert np.mean(found.used[hit]) < 0.1
    assert rms(found.omega[:, 2] - states.omega[:, 2]) < 0.03


def test_a_movement_that_outruns_the_process_noise_is_followed(
    trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates
) -> None:
    """For a sixth of a second the reach is 15 times as fast as before and after, and no marker is wrong."""
    fast = np.concatenate([np.arange(700), np.arange(700, 1000, 15), np.arange(1000, 1500)])
    found = smooth_in_space(points[fast], trial.rate, true_chain(trial))
    assert found.used[690:740].mean() > 0.9
    assert found.observed.all()
    turned = so3.log(np.swapaxes(found.rotations, 2, 3) @ states.rotations[fast])
    assert np.degrees(np.linalg.norm(turned, axis=-1)).max() < 10


def test_the_pose_is_found_again_after_exchanged_markers(
    trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates
) -> None:
    """Half of the forearm's markers are exchanged with those of the hand; the hand would stay turned by 180°."""
    forearm, hand = (np.flatnonzero(np.asarray(trial.assignment) == s)[:3] for s in (2, 3))
    wrong, at = points.copy(), slice(700, 720)
    wrong[at, forearm], wrong[at, hand] = points[at, hand], points[at, forearm]
    found = smooth_in_space(wrong, trial.rate, true_chain(trial))
    turned = so3.log(np.swapaxes(found.rotations, 2, 3) @ states.rotations)
    off = np.degrees(np.linalg.norm(turned, axis=-1))
    assert np.nanmax(np.delete(off, np.r_[at], axis=0)) < 5
    assert not found.observed[at, 3].any()
    assert found.observed[at.stop :].all()
    assert not found.used[at, forearm].any()
    assert not found.used[at, hand].any()


def test_exact_markers_are_followed_where_the_movement_begins() -> None:
    trial = generate_space_robot(SpaceRobotOptions(seed=655, preset="clean", duration=12, analog_rate=120))
    found = smooth_in_space(FRAME.to_plane(trial.points), trial.options.rate, trial.robot.chain)
    assert found.used.all()
    np.testing.assert_allclose(found.alpha[120:-120], trial.motion.alpha[120:-120], atol=0.02)


def test_a_vanishing_marker_makes_no_step(
    trial: SimulatedSpaceTrial, points: FloatArray, states: SpatialStates
) -> None:
    hidden = points.copy()
    column = trial.names.index("EM")
    hidden[GAP.start : GAP.start + 60, column] = np.nan
    found = smooth_in_space(hidden, trial.rate, true_chain(trial))
    assert rms((found.alpha - states.alpha)[GAP, 1]) < 0.5
    assert found.observed.all()


def test_joints_and_segments_agree(states: SpatialStates) -> None:
    turns = np.swapaxes(states.rotations[:, 1], 1, 2) @ states.rotations[:, 2]
    np.testing.assert_allclose(turns, states.joint_rotations[:, 1], atol=1e-9)
    relative = np.einsum("fji,fj->fi", states.rotations[:, 2], states.omega[:, 2] - states.omega[:, 1])
    np.testing.assert_allclose(relative, states.velocity[:, 1], atol=1e-9)
    assert np.isnan(states.coordinates[:, 0]).all()
    assert np.all(np.linalg.eigvalsh(states.joint_covariance[::50])[..., 0] > -1e-9)
