"""What another movement would be worth, and the search for the one that is worth most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES
from excitation_cases import EXACT, SLIDING, identified, recorded

from mocap_id.design.experiment import ExperimentDesign, design_experiment
from mocap_id.design.movement_limits import MovementLimits, derive_limits, resting_posture
from mocap_id.design.predicted_covariance import CovariancePredictor, IdentifiedBody
from mocap_id.design.proposal import OBJECTIVES, objective_value
from mocap_id.design.recommendation import change_movement
from mocap_id.design.trajectory import Trajectory, concatenate, recorded_trajectory, spline_trajectory
from mocap_id.design.wave_movement import balance, rest_movement, static_pressure
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import planar_regressor

SMALL = np.array([0.3, 0.3, 0.05])
JOINTS = ("ankle", "knee", "hip")
REST = np.zeros(3)
ROOM = MovementLimits(np.full(3, -1.0), np.full(3, 1.0), np.full(3, 4.0), np.full(3, 20.0), None)
FEET = replace(ROOM, support=(-0.3, 0.2))


def foreseen_from(error: KinematicError = EXACT) -> CovariancePredictor:
    prepared, found, _ = identified(recorded(SMALL, noise=(5.0, 5.0, 2.0)), error)
    own = recorded_trajectory(prepared.recorded, found.fit.in_fit)
    return CovariancePredictor.from_trial(IdentifiedBody(prepared, found), own, lambda q: error)


@pytest.fixture(scope="module")
def sight() -> CovariancePredictor:
    return foreseen_from()


@pytest.fixture(scope="module")
def designed(sight: CovariancePredictor) -> ExperimentDesign:
    return design_experiment(sight, FEET, REST, JOINTS, seconds=20.0)


def strain(sight: CovariancePredictor, limits: MovementLimits, course) -> float:
    return limits.usage(course, sight.body.wrench(course))


@pytest.mark.parametrize("error", [EXACT, SLIDING], ids=["noise", "noise and sliding skin"])
def test_the_trials_own_movement_is_foreseen_as_it_was_found(error: KinematicError) -> None:
    sight = foreseen_from(error)
    again = sight.predict(sight.own)
    found = sight.body.found
    np.testing.assert_allclose(again.sd, found.base_sd, rtol=1e-9)
    assert again.condition == found.fit.condition
    assert again.condition_scaled == found.fit.condition_scaled


def test_its_copy_is_filtered_to_the_same_condition_number(sight: CovariancePredictor) -> None:
    """Not the same object: the regressor is set up, filtered and gated anew."""
    copied = replace(sight.own)
    again = sight.predict(copied)
    fit = sight.body.found.fit
    assert again.condition == pytest.approx(fit.condition, rel=0.02)  # its cut-off is the rule's, the trial's was given
    np.testing.assert_allclose(again.sd, sight.body.found.base_sd, rtol=1e-9)


def test_twice_as_long_halves_the_variance_of_the_noise_alone() -> None:
    sight = foreseen_from(EXACT)
    seconds = sight.now.samples
    once, twice = (sight.predict(sight.own, seconds=k * seconds) for k in (1, 2))
    changing = np.diag(once.covariance) - once.fixed
    np.testing.assert_allclose(np.diag(twice.covariance) - once.fixed, changing / 2, rtol=1e-9)


def test_a_foreseen_movement_is_identified_as_well_as_was_foreseen() -> None:
    """Record it: the deviations and the condition number are those that were promised."""
    sight = foreseen_from(EXACT)
    best = design_experiment(sight, ROOM, REST, JOINTS, seconds=40.0).best
    assert best is not None
    course = best.trajectory
    wrench = planar_regressor(CENTRES, course.q, course.dq, course.ddq) @ BODY.ravel()
    wrench += np.random.default_rng(9).normal(size=wrench.shape) * (5.0, 5.0, 2.0)
    observed = np.ones(len(wrench), dtype=bool)
    made = TrialData(course.time, course.q, course.dq, course.ddq, np.zeros_like(course.q), observed, wrench, CENTRES)
    _, found, _ = identified(made)
    ratio = best.predicted.sd / found.base_sd
    assert np.median(np.abs(np.log(ratio))) < np.log(1.25)
    assert np.max(np.abs(np.log(ratio))) < np.log(2.0)
    assert best.predicted.condition == pytest.approx(found.fit.condition, rel=0.05)
    assert np.median(found.base_sd / sight.now.sd) < 0.5


def test_nothing_that_is_listed_is_better_than_the_best(designed: ExperimentDesign) -> None:
    assert designed.best is not None
    assert designed.helps
    assert designed.simple
    assert list(designed.simple) == sorted(designed.simple, key=lambda each: each.value)
    assert all(designed.best.value <= each.value for each in designed.proposals)


def test_every_proposal_keeps_the_limits(sight: CovariancePredictor, designed: ExperimentDesign) -> None:
    for each in designed.proposals:
        course, own = each.trajectory, len(sight.own.time) // 2
        if not each.own and not each.standalone:  # half of it is the trial's own
            course = replace(
                course, time=course.time[own:], q=course.q[own:], dq=course.dq[own:], ddq=course.ddq[own:], fitted=None
            )
        assert strain(sight, FEET, course) <= 1.02, each.words  # what is simple is looked at in part and thinned out
        if each.designed:
            assert strain(sight, FEET, course) <= 1.0 + 1e-9


def test_the_same_seed_gives_the_same_movement(sight: CovariancePredictor, designed: ExperimentDesign) -> None:
    again = design_experiment(sight, FEET, REST, JOINTS, seconds=20.0)
    assert [each.words for each in again.proposals] == [each.words for each in designed.proposals]
    assert designed.designed is not None and again.designed is not None
    np.testing.assert_array_equal(again.designed.trajectory.q, designed.designed.trajectory.q)


@pytest.mark.parametrize("objective", [each for each in OBJECTIVES if each != "condition-scaled"])
def test_what_is_asked_for_becomes_smaller(sight: CovariancePredictor, objective) -> None:
    found = design_experiment(sight, ROOM, REST, JOINTS, objective=objective, seconds=20.0)
    assert found.best is not None
    assert found.best.value < 0.5 * found.value
    assert found.best.value == objective_value(objective, found.best.predicted, found.size)


def test_where_nothing_may_move_nothing_helps(sight: CovariancePredictor) -> None:
    found = design_experiment(sight, replace(ROOM, low=REST, high=REST), REST, JOINTS, seconds=20.0)
    assert found.designed is None
    assert found.best is None
    assert not found.helps


def test_a_chairs_recording_is_not_shared(sight: CovariancePredictor) -> None:
    found = design_experiment(sight, FEET, REST, JOINTS, seconds=20.0, mixed=False)
    assert not any("half of the recording" in each.words for each in found.proposals)


def test_the_first_joint_brings_the_pressure_where_it_is_wanted(sight: CovariancePredictor) -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-0.5, 0.5, (50, 3))
    target = rng.uniform(-0.1, 0.1, 50)
    q[:, 0] = balance(sight.body, q, target, 0.0)
    np.testing.assert_allclose(static_pressure(sight.body, q), target, atol=1e-12)
    assert np.max(np.abs(q[:, 0])) < np.pi / 2


def test_beyond_reach_no_angle_does_it(sight: CovariancePredictor) -> None:
    assert np.isnan(balance(sight.body, np.zeros((1, 3)), np.array([5.0]), 0.0)).all()


def test_a_movement_starts_and_ends_at_rest(sight: CovariancePredictor) -> None:
    waves = replace(rest_movement(REST), amplitude=np.full((3, 2), 0.2), centre=np.full(3, 0.1))
    course = waves.trajectory(sight.body, 12.0, 100.0)
    for end in (0, -1):
        np.testing.assert_allclose([course.q[end], course.dq[end], course.ddq[end]], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.gradient(course.q, 0.01, axis=0)[2:-2], course.dq[2:-2], atol=2e-2)
    assert np.ptp(course.q) > 0.3


def test_limits_are_those_that_were_seen_and_somewhat_more() -> None:
    time = np.arange(0, 10, 0.01)
    course = spline_trajectory(time, np.column_stack([0.2 * np.sin(time), 0.1 + 0.0 * time]))
    wrench = np.column_stack([0 * time, 100.0 + 0 * time, 10.0 * np.sin(time)])
    asked = {"widened": 0.05, "speed": (0.1, 0.25), "acceleration": (0.1, np.inf), "at_rest": 0.0}
    limits = derive_limits(course, wrench, np.array([0.0, 0.3]), slack=0.03, **asked)
    np.testing.assert_allclose(limits.low, [-0.25, 0.05], atol=1e-5)
    np.testing.assert_allclose(limits.high, [0.25, 0.3], atol=1e-5)  # the posture at rest is always allowed
    np.testing.assert_allclose(limits.speed, [0.25, 0.1], rtol=1e-3)
    np.testing.assert_allclose(limits.acceleration, [0.45, 0.1], rtol=1e-2)
    np.testing.assert_allclose(limits.support, [-0.13, 0.13], atol=1e-5)
    assert limits.usage(course, wrench) <= 1.0
    assert limits.usage(course, 1.4 * wrench / [1.0, 1.4, 1.0]) > 1.0
    assert limits.usage(course, wrench, np.full(len(time), 6.0)) > 1.0


def test_those_who_stand_rest_where_they_stand_highest() -> None:
    time = np.arange(0, 10, 0.01)
    bent = 0.5 - 0.5 * np.cos(time)
    course = spline_trajectory(time, np.column_stack([0.3 * bent, -bent, 0.7 * bent]))
    assert np.max(np.abs(resting_posture(course, CENTRES, upright=True))) < 0.1
    assert resting_posture(course, CENTRES, upright=False)[1] == pytest.approx(-np.median(bent))


@pytest.mark.parametrize("rate", [100.0, 150.0, 240.0])
def test_a_whole_part_of_the_rate_is_that_part(rate: float) -> None:
    for count in range(600, 640):
        time = np.arange(count) / rate
        course, every = Trajectory(time, *np.zeros((3, count, 1))), int(rate / 20)
        assert len(course.thinned(course.rate / every).time) == -(-count // every)


def test_one_movement_after_the_other_is_their_information_together(sight: CovariancePredictor) -> None:
    """Two halves tell no less together than each by itself: what bias and clock hide of one the other may show."""
    small = sight.own.thinned(25.0)
    large = change_movement(small, "larger", None)
    half = np.arange(len(small.time)) % 2 == 0
    both = concatenate(replace(small, fitted=small.fitted & half), replace(large, fitted=large.fitted & ~half))

    def information(course) -> np.ndarray:
        foreseen = sight.predict(course, seconds=10.0, exactly=False)
        return np.linalg.inv((foreseen.covariance - np.diag(foreseen.fixed))[2:, 2:])

    apart = (information(small) + information(large)) / 2
    assert np.linalg.eigvals(np.linalg.solve(apart, information(both))).real.min() > 0.9
