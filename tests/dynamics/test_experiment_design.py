"""Predicted uncertainty of other movements, and the search for the best one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES
from excitation_cases import EXACT, SLIDING, identified, recorded

from mocap_id.design.experiment import (
    ExperimentDesign,
    balance,
    design_experiment,
    hold_posture,
    static_centre_of_pressure,
)
from mocap_id.design.proposal import (
    OBJECTIVES,
    CovariancePredictor,
    MovementLimits,
    Trajectory,
    change_movement,
    compute_objective,
    concatenate,
    derive_limits,
    find_resting_posture,
    fit_trajectory,
    get_recorded_trajectory,
)
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import planar_regressor

SMALL = np.array([0.3, 0.3, 0.05])
JOINTS = ("ankle", "knee", "hip")
REST = np.zeros(3)
ROOM = MovementLimits(np.full(3, -1.0), np.full(3, 1.0), np.full(3, 4.0), np.full(3, 20.0), None)
FEET = replace(ROOM, support=(-0.3, 0.2))


def build_predictor(error: KinematicError = EXACT) -> CovariancePredictor:
    prepared, found, _ = identified(recorded(SMALL, noise=(5.0, 5.0, 2.0)), error)
    own = get_recorded_trajectory(prepared.recorded, found.fit.in_fit)
    return CovariancePredictor(prepared, found, own, lambda q: error)


@pytest.fixture(scope="module")
def predictor() -> CovariancePredictor:
    return build_predictor()


@pytest.fixture(scope="module")
def designed(predictor: CovariancePredictor) -> ExperimentDesign:
    return design_experiment(predictor, FEET, REST, JOINTS, seconds=20.0)


def usage(predictor: CovariancePredictor, limits: MovementLimits, course) -> float:
    return limits.usage(course, predictor.wrench(course))


@pytest.mark.parametrize("error", [EXACT, SLIDING], ids=["noise", "noise and sliding skin"])
def test_prediction_for_the_trials_own_movement_is_exact(error: KinematicError) -> None:
    predictor = build_predictor(error)
    again = predictor.predict(predictor.own)
    found = predictor.result
    np.testing.assert_allclose(again.sd, found.base_sd, rtol=1e-9)
    assert again.condition == found.fit.condition
    assert again.condition_scaled == found.fit.condition_scaled


def test_a_copy_of_the_movement_has_the_same_condition_number(predictor: CovariancePredictor) -> None:
    """A new object, so that regressor, filter and gate are computed again."""
    copied = replace(predictor.own)
    again = predictor.predict(copied)
    fit = predictor.result.fit
    assert again.condition == pytest.approx(fit.condition, rel=0.02)  # its cut-off is the rule's, the trial's was given
    np.testing.assert_allclose(again.sd, predictor.result.base_sd, rtol=1e-9)


def test_twice_as_long_halves_the_variance_of_the_noise_alone() -> None:
    predictor = build_predictor(EXACT)
    seconds = predictor.now.samples
    once, twice = (predictor.predict(predictor.own, seconds=k * seconds) for k in (1, 2))
    changing = np.diag(once.covariance) - once.fixed
    np.testing.assert_allclose(np.diag(twice.covariance) - once.fixed, changing / 2, rtol=1e-9)


def test_a_recording_of_the_best_movement_has_the_predicted_uncertainty() -> None:
    """Deviations and condition number of the recorded movement agree with the prediction."""
    predictor = build_predictor(EXACT)
    best = design_experiment(predictor, ROOM, REST, JOINTS, seconds=40.0).best
    assert best is not None
    course = best.trajectory
    wrench = planar_regressor(CENTRES, course.q, course.dq, course.ddq) @ BODY.ravel()
    wrench += np.random.default_rng(9).normal(size=wrench.shape) * (5.0, 5.0, 2.0)
    observed = np.ones(len(wrench), dtype=bool)
    recording = TrialData(
        course.time, course.q, course.dq, course.ddq, np.zeros_like(course.q), observed, wrench, CENTRES
    )
    _, found, _ = identified(recording)
    ratio = best.predicted.sd / found.base_sd
    assert np.median(np.abs(np.log(ratio))) < np.log(1.25)
    assert np.max(np.abs(np.log(ratio))) < np.log(2.0)
    assert best.predicted.condition == pytest.approx(found.fit.condition, rel=0.05)
    assert np.median(found.base_sd / predictor.now.sd) < 0.5


def test_no_proposal_is_better_than_the_best(designed: ExperimentDesign) -> None:
    assert designed.best is not None
    assert designed.helps
    assert designed.simple
    assert list(designed.simple) == sorted(designed.simple, key=lambda each: each.value)
    assert all(designed.best.value <= each.value for each in designed.proposals)


def test_every_proposal_keeps_the_limits(predictor: CovariancePredictor, designed: ExperimentDesign) -> None:
    for each in designed.proposals:
        course, own = each.trajectory, len(predictor.own.time) // 2
        if not each.own and not each.standalone:  # half of it is the trial's own movement
            course = replace(
                course, time=course.time[own:], q=course.q[own:], dq=course.dq[own:], ddq=course.ddq[own:], fitted=None
            )
        assert usage(predictor, FEET, course) <= 1.02, each.words  # simple movements are checked on thinned samples
        if each.designed:
            assert usage(predictor, FEET, course) <= 1.0 + 1e-9


@pytest.mark.slow
def test_the_same_seed_gives_the_same_movement(predictor: CovariancePredictor, designed: ExperimentDesign) -> None:
    again = design_experiment(predictor, FEET, REST, JOINTS, seconds=20.0)
    assert [each.words for each in again.proposals] == [each.words for each in designed.proposals]
    assert designed.designed is not None and again.designed is not None
    np.testing.assert_array_equal(again.designed.trajectory.q, designed.designed.trajectory.q)


@pytest.mark.slow
@pytest.mark.parametrize("objective", [each for each in OBJECTIVES if each != "condition-scaled"])
def test_the_search_reduces_its_objective(predictor: CovariancePredictor, objective) -> None:
    found = design_experiment(predictor, ROOM, REST, JOINTS, objective=objective, seconds=20.0)
    assert found.best is not None
    assert found.best.value < 0.5 * found.value
    assert found.best.value == compute_objective(objective, found.best.predicted, found.size)


def test_without_freedom_to_move_nothing_helps(predictor: CovariancePredictor) -> None:
    found = design_experiment(predictor, replace(ROOM, low=REST, high=REST), REST, JOINTS, seconds=20.0)
    assert found.designed is None
    assert found.best is None
    assert not found.helps


def test_a_recording_with_a_chair_is_not_shared(predictor: CovariancePredictor) -> None:
    found = design_experiment(predictor, FEET, REST, JOINTS, seconds=20.0, mixed=False)
    assert not any("half of the recording" in each.words for each in found.proposals)


def test_balancing_reaches_the_target_pressure(predictor: CovariancePredictor) -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-0.5, 0.5, (50, 3))
    target = rng.uniform(-0.1, 0.1, 50)
    q[:, 0] = balance(predictor, q, target, 0.0)
    np.testing.assert_allclose(static_centre_of_pressure(predictor, q), target, atol=1e-12)
    assert np.max(np.abs(q[:, 0])) < np.pi / 2


def test_balancing_is_nan_for_unreachable_targets(predictor: CovariancePredictor) -> None:
    assert np.isnan(balance(predictor, np.zeros((1, 3)), np.array([5.0]), 0.0)).all()


def test_a_movement_starts_and_ends_at_rest(predictor: CovariancePredictor) -> None:
    waves = replace(hold_posture(REST), amplitude=np.full((3, 2), 0.2), centre=np.full(3, 0.1))
    course = waves.trajectory(predictor, 12.0, 100.0)
    for end in (0, -1):
        np.testing.assert_allclose([course.q[end], course.dq[end], course.ddq[end]], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.gradient(course.q, 0.01, axis=0)[2:-2], course.dq[2:-2], atol=2e-2)
    assert np.ptp(course.q) > 0.3


def test_limits_extend_the_observed_range() -> None:
    time = np.arange(0, 10, 0.01)
    course = fit_trajectory(time, np.column_stack([0.2 * np.sin(time), 0.1 + 0.0 * time]))
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


def test_a_standing_person_rests_in_the_highest_posture() -> None:
    time = np.arange(0, 10, 0.01)
    bent = 0.5 - 0.5 * np.cos(time)
    course = fit_trajectory(time, np.column_stack([0.3 * bent, -bent, 0.7 * bent]))
    assert np.max(np.abs(find_resting_posture(course, CENTRES, upright=True))) < 0.1
    assert find_resting_posture(course, CENTRES, upright=False)[1] == pytest.approx(-np.median(bent))


@pytest.mark.parametrize("rate", [100.0, 150.0, 240.0])
def test_thinning_by_a_whole_divisor_of_the_rate(rate: float) -> None:
    for count in range(600, 640):
        time = np.arange(count) / rate
        course, every = Trajectory(time, *np.zeros((3, count, 1))), int(rate / 20)
        assert len(course.thin(course.rate / every).time) == -(-count // every)


def test_information_of_consecutive_movements_adds_up(predictor: CovariancePredictor) -> None:
    """Bias and clock offset are common to both halves, so together they have at least the sum of the information."""
    small = predictor.own.thin(25.0)
    large = change_movement(small, "larger", None)
    half = np.arange(len(small.time)) % 2 == 0
    both = concatenate(replace(small, fitted=small.fitted & half), replace(large, fitted=large.fitted & ~half))

    def information(course) -> np.ndarray:
        predicted = predictor.predict(course, seconds=10.0, exactly=False)
        return np.linalg.inv((predicted.covariance - np.diag(predicted.fixed))[2:, 2:])

    apart = (information(small) + information(large)) / 2
    assert np.linalg.eigvals(np.linalg.solve(apart, information(both))).real.min() > 0.9
