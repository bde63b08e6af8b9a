"""The fit of a chain in space on simulated chains and arms with exact truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocap_id.errors import NumericalError
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.kinematics.space.bundle import segment_origins
from mocap_id.kinematics.space.chain_fit import SpatialFit, fit_spatial_chain, move_centre
from mocap_id_simulation import SpaceRobotOptions, generate_space_robot, simulate_arm, simulate_chain

_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_ARM: Any = {1: "ball", 2: "two-axis", 3: "two-axis"}


def _fit(trial: Any, **more: Any) -> SpatialFit:
    parents = range(int(trial.assignment.max()))
    return fit_spatial_chain(trial.positions @ _UP.T, trial.assignment, tuple(parents), **more)


def _centre_errors(fit: SpatialFit, trial: Any) -> np.ndarray:
    """Return the rms distance (n,), m, of the joint centres from the truth over the frames of the fit."""
    problem, points = fit.bundle.problem, trial.positions @ _UP.T
    frames = []
    for f, seen in enumerate(problem.weights > 0):
        marker = int(np.argmax(seen))
        off = np.abs(np.nan_to_num(points[:, marker], nan=9.0) - problem.points[f, marker]).sum(axis=1)
        frames.append(int(np.argmin(off)))
    off = segment_origins(problem, fit.bundle.state) - trial.origins[frames] @ _UP.T
    return np.asarray(np.sqrt((off**2).sum(axis=2).mean(axis=0))[1:])


@pytest.fixture(scope="module")
def reach() -> tuple[Any, SpatialFit]:
    trial = simulate_arm(1)
    return trial, _fit(trial)


def test_ball_joints_of_a_plain_chain() -> None:
    trial = simulate_chain(3, kinds="SS", arc_deg=40)
    fit = _fit(trial)
    assert [each.kind for each in fit.evidence] == ["ball", "ball"]
    assert _centre_errors(fit, trial).max() < 1e-3
    true = np.asarray(trial.document["lengths_m"])[0]
    assert abs(fit.lengths[0] - true) < 4 * fit.length_sd[0] < 3e-3
    assert all(joint.known for joint in fit.chain.joints)


def test_a_named_acromion_shows_the_glide_that_its_skin_hides() -> None:
    trial = simulate_arm(281003, preset="hard", cycles=1, severity=0.5)
    acromion = trial.labels.index("AC")
    hidden, shown = _fit(trial, kinds=_ARM), _fit(trial, kinds=_ARM, girdle=[acromion])
    assert not hidden.chain.on_glide.any()
    assert np.flatnonzero(shown.chain.on_glide).tolist() == [acromion]
    assert shown.chain.joints[0].glide[1] > 0.005
    assert _centre_errors(shown, trial)[0] < _centre_errors(hidden, trial)[0]


def test_skin_that_twists_as_a_whole_hides_no_hinge() -> None:
    trial = generate_space_robot(SpaceRobotOptions(seed=284018))
    fit = fit_spatial_chain(trial.points @ _UP.T, trial.robot.chain.segment, (0, 1))
    assert [each.kind for each in fit.evidence] == ["hinge", "hinge"]


def test_a_hinge_is_found_and_its_place_along_the_axis_is_open() -> None:
    fit = _fit(simulate_chain(3, kinds="SH", arc_deg=15))
    assert [each.kind for each in fit.evidence] == ["ball", "hinge"]
    joint = fit.chain.joints[1]
    along = np.sqrt(joint.first_axis @ joint.covariance @ joint.first_axis)
    assert along > 0.09
    assert joint.known
    assert np.allclose(joint.offset @ joint.second_axis, joint.first_axis, atol=1e-6)


def test_the_lab_does_not_matter() -> None:
    trial = simulate_chain(4, kinds="SS", arc_deg=40, sway_mm=20)
    points = trial.positions @ _UP.T
    turn = so3.exp(np.array([0.4, -1.1, 0.7]))
    one = fit_spatial_chain(points, trial.assignment, (0, 1))
    other = fit_spatial_chain(points @ turn.T + [3.0, -1, 2], trial.assignment, (0, 1), up=turn @ [0, 1, 0])
    assert np.allclose(one.lengths, other.lengths, atol=1e-5)
    assert np.allclose(one.chain.joints[1].centre @ turn.T, other.chain.joints[1].centre, atol=1e-5)


def test_centres_axes_and_glide_of_an_arm(reach: tuple[Any, SpatialFit]) -> None:
    trial, fit = reach
    assert [each.likely for each in fit.evidence] == ["ball", "two-axis", "two-axis"]
    shoulder, elbow, _ = _centre_errors(fit, trial)
    assert shoulder < 0.005
    assert elbow < 0.006
    riding = [trial.labels[m] for m in np.flatnonzero(fit.chain.on_glide)]
    assert riding == ["AC"]
    size = np.linalg.norm(fit.chain.joints[0].glide)
    assert 0.008 < size < 0.022
    assert all(joint.known for joint in fit.chain.joints)


def test_a_landmark_moves_the_centre_along_its_uncertain_direction(reach: tuple[Any, SpatialFit]) -> None:
    _, fit = reach
    joint = fit.chain.joints[1]
    target = joint.centre + np.array([0.004, -0.002, 0.005])
    moved = move_centre(fit, 2, target, 1e-10 * np.eye(3))
    own = fit.chain.segment == 1
    shift = np.nanmean(moved.chain.local[own] - fit.chain.local[own], axis=0)  # the origin is the shoulder's centre
    assert np.allclose(moved.chain.joints[1].centre - shift, target, atol=1e-5)
    assert np.linalg.eigvalsh(moved.centre_among_markers(2, 1))[-1] < 1e-9
    loose = move_centre(fit, 2, target, 100 * np.eye(3))
    assert np.allclose(loose.chain.joints[1].centre, joint.centre, atol=1e-5)


def test_curls_do_not_show_the_shoulder() -> None:
    trial = simulate_arm(5, movement="curl", subject=110, rate=60, repetitions=4)
    fit = _fit(trial, kinds=_ARM)
    assert not fit.chain.joints[0].known
    assert fit.chain.joints[1].known


def test_computed_markers_do_not_outweigh_measured_ones() -> None:
    trial = simulate_arm(1)
    points = trial.positions @ _UP.T
    here = np.flatnonzero(trial.assignment == 2)
    shape = np.nanmedian(points[:, here], axis=0)
    rotation, origin, _ = rigid_poses(points[:, here], shape)
    exact = np.einsum("fij,mj->fmi", rotation, shape) + origin[:, None]
    segment = np.concatenate([trial.assignment, np.full(len(here), 2)])
    fit = fit_spatial_chain(np.concatenate([points, exact], axis=1), segment, (0, 1, 2), kinds=_ARM)
    usual = np.median([np.sqrt(np.mean(fit.bundle.sd[segment == k] ** 2)) for k in range(4)])
    assert fit.bundle.sd.min() > 0.4 * usual
    assert _centre_errors(fit, trial)[:2].max() < 0.02


def test_a_firm_segment_has_no_skin(reach: tuple[Any, SpatialFit]) -> None:
    trial, free = reach
    firm = _fit(trial, kinds=_ARM, firm=(1,))
    assert np.abs(free.chain.skin[trial.assignment == 1]).max() > 0.1
    assert np.abs(firm.chain.skin[trial.assignment == 1]).max() < 0.01


def test_the_upper_arm_twists_from_the_hanging_arm(reach: tuple[Any, SpatialFit]) -> None:
    shoulder = reach[1].chain.joints[0]
    np.testing.assert_allclose(shoulder.untwisted @ shoulder.long_axis, shoulder.rest, atol=1e-9)
    assert abs(shoulder.twist(np.eye(3))) < 1e-9
    assert np.arccos(shoulder.long_axis @ shoulder.rest) > np.radians(10)


@pytest.mark.parametrize("estimator", ["score", "sphere", "helical"])
def test_other_estimators(estimator: Any) -> None:
    trial = simulate_chain(3, kinds="SS", arc_deg=40)
    fit = _fit(trial, estimator=estimator)
    assert _centre_errors(fit, trial).max() < 5e-3
    assert np.isnan(fit.chain.joints[0].covariance).all()
    assert fit.bundle.iterations == 0


def test_too_few_frames_are_refused() -> None:
    trial = simulate_chain(3, kinds="SS", arc_deg=40)
    points = trial.positions.copy()
    points[10:, trial.assignment == 1] = np.nan
    with pytest.raises(NumericalError, match="three markers of every segment"):
        fit_spatial_chain(points, trial.assignment, (0, 1))
