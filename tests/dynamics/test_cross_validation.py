"""Repetitions predicted by fits that did not see them: as if each fold were run from scratch, and nothing leaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, moving_body

from mocap_id.dynamics.consistency import build_grid, fit_consistent, fit_quickly
from mocap_id.dynamics.fit import Fit, fit, number_parts
from mocap_id.dynamics.identification import LeftOutPrediction, identify, predict_left_out
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare
from mocap_id.dynamics.regressor import CompressedProblem, planar_regressor

GRID = build_grid(
    CENTRES, np.repeat([0, 1, 2, 3], 2), np.array([[-0.25, 0.0], [0.08, 0.1], *3 * [[-0.12, 0.1], [0.12, 0.85]]])
)
NO_ERROR = KinematicError.none(3)
NOISE = (0.5, 0.5, 0.15)
SPANS = np.array([[0.5, 9.0], [11.0, 19.0], [21.0, 29.5]])


def with_(recorded: TrialData, **changes: np.ndarray) -> TrialData:
    return TrialData(**{**recorded.__dict__, **changes})


def trial(noise: tuple[float, float, float] = NOISE, **settings: object) -> tuple[PreparedTrial, np.ndarray]:
    recorded = moving_body(seconds=30.0, noise=noise)
    return prepare(recorded, FitSettings(**settings)), np.ones(len(recorded.time), dtype=bool)  # type: ignore[arg-type]


def free(problem: CompressedProblem) -> np.ndarray:
    return problem.free_solution()


def held(prepared: PreparedTrial, gate: np.ndarray) -> LeftOutPrediction:
    found = predict_left_out(prepared, gate, fit(prepared, gate), number_parts(prepared.recorded.time, SPANS), free)
    assert found is not None
    return found


def test_parts_meet_halfway_between_repetitions() -> None:
    time = np.array([0.0, 9.9, 10.1, 19.9, 20.1, 40.0])
    np.testing.assert_array_equal(number_parts(time, SPANS), [0, 0, 1, 1, 2, 2])
    assert (number_parts(time, SPANS[:1]) == 0).all()
    assert (number_parts(time, np.zeros((0, 2))) == 0).all()


@pytest.mark.parametrize("repetitions", [5, 6, 12, 28])
def test_many_repetitions_make_five_parts_of_neighbours(repetitions: int) -> None:
    starts = 6.0 * np.arange(repetitions)
    time = starts + 2.5
    part = number_parts(time, np.column_stack([starts, starts + 5.0]))
    assert sorted(set(part)) == [0, 1, 2, 3, 4]
    assert (np.diff(part) >= 0).all()
    assert np.ptp(np.bincount(part)) <= 1


def reweighed(found: Fit, weights: np.ndarray) -> Fit:
    """The same fit with other weights of the components: a fold keeps those of the whole trial."""
    scale = weights / found.weights
    design, target = found.design * scale[:, None], found.target * scale
    problem = CompressedProblem.of(design[..., :-1].reshape(target.size, -1), target.reshape(-1))
    return replace(found, weights=weights, design=design, target=target, problem=problem)


def test_a_fold_is_a_fit_to_the_rest() -> None:
    """Against the long way: gate the part out, erode, thin, filter, search the offset and fit, from scratch."""
    prepared, gate = trial(cutoff=10.0)
    assert prepared.lowpass.step == 1  # so that both fit the same samples
    part, found, weights = (
        number_parts(prepared.recorded.time, SPANS),
        held(prepared, gate),
        fit(prepared, gate).weights,
    )
    for k in range(3):
        alone = reweighed(fit(prepared, gate & (part != k)), weights)
        expected, sd = alone.problem.free_solution()[: alone.base], np.sqrt(np.diag(alone.covariance))[: alone.base]
        assert found.offset[k] == pytest.approx(alone.offset, abs=1e-6)
        assert (np.abs(found.base[k] - expected) < 0.02 * sd).all()


def test_what_is_left_out_has_no_part_in_its_prediction() -> None:
    """Spoil the forces of one repetition: its own fold's parameters do not move, the other folds' do."""
    recorded = moving_body(seconds=30.0, noise=NOISE)
    gate = np.ones(len(recorded.time), dtype=bool)
    part = number_parts(recorded.time, SPANS)
    wrench = recorded.wrench.copy()
    wrench[part == 1] *= 1.3
    settings = FitSettings(apply_offset=False)
    sound, spoilt = (prepare(with_(recorded, wrench=values), settings) for values in (recorded.wrench, wrench))
    whole = fit(sound, gate)
    one = predict_left_out(sound, gate, whole, part, free)
    other = predict_left_out(spoilt, gate, reweighed(fit(spoilt, gate), whole.weights), part, free)
    assert one is not None and other is not None
    # what is felt beyond the reach of the filter is 3 % of its area, and shows here as less than a thousandth
    np.testing.assert_allclose(one.base[1], other.base[1], rtol=1e-3, atol=5e-3)
    for k in (0, 2):
        assert abs(other.base[k, 0] / one.base[k, 0] - 1) > 0.05


def test_every_sample_of_the_fit_is_predicted_once() -> None:
    prepared, gate = trial()
    gate[1200:1300] = False  # a chair
    found, whole = held(prepared, gate), fit(prepared, gate)
    np.testing.assert_array_equal(found.samples, whole.in_fit)
    np.testing.assert_array_equal(np.isfinite(found.wrench).all(axis=1), whole.in_fit)
    np.testing.assert_array_equal(np.isfinite(found.measured).all(axis=1), whole.in_fit)
    error = (found.wrench - found.measured)[found.samples]
    np.testing.assert_allclose(error.std(axis=0), NOISE, rtol=0.1)


def test_clock_and_bias_come_from_the_others() -> None:
    recorded = moving_body(seconds=30.0, noise=NOISE)
    wrong = np.roll(recorded.wrench, -2, axis=0) + np.array([4.0, 0.0, 0.0])  # stamped 20 ms too early
    late = with_(recorded, wrench=wrong)
    late.wrench[-2:] = np.nan
    found = held(prepare(late, FitSettings()), np.ones(len(recorded.time), dtype=bool))
    np.testing.assert_allclose(found.offset, 0.02, atol=1e-4)
    np.testing.assert_allclose(found.measured[300:2500], recorded.wrench[300:2500], atol=0.5)
    unmoved = held(prepare(late, FitSettings(apply_offset=False)), np.ones(len(recorded.time), dtype=bool))
    np.testing.assert_array_equal(unmoved.offset, 0.0)


def test_a_repetition_without_which_nothing_is_determined_is_not_held_out() -> None:
    """The hip moves in the second part only: without it the torso cannot be told from the thigh."""
    recorded = moving_body(seconds=30.0)
    part = number_parts(recorded.time, SPANS)
    q, dq, ddq = recorded.q.copy(), recorded.dq.copy(), recorded.ddq.copy()
    for values in (q, dq, ddq):
        values[part != 1, 2] = 0.0
    wrench = planar_regressor(CENTRES, q, dq, ddq) @ BODY.ravel()
    wrench += np.random.default_rng(2).normal(size=wrench.shape) * NOISE
    prepared = prepare(with_(recorded, q=q, dq=dq, ddq=ddq, wrench=wrench), FitSettings(offset_limit=0.02))
    gate = np.ones(len(part), dtype=bool)
    edge = np.flatnonzero(np.diff(part))
    for place in edge:  # the jump of the states between the parts is no movement
        gate[place - 20 : place + 20] = False
    found = predict_left_out(prepared, gate, fit(prepared, gate), part, free)
    assert found is not None
    assert len(found.base) == 2
    assert not found.samples[part == 1].any()
    assert found.samples[part != 1].any()


def test_with_one_part_there_is_nothing_to_hold_out() -> None:
    prepared, gate = trial()
    assert predict_left_out(prepared, gate, fit(prepared, gate), np.zeros(len(gate), dtype=np.int64), free) is None


@pytest.mark.parametrize("consistency", ["grid", "cone", "bounded-cone"])
def test_the_quick_solution_is_the_whole_one(consistency: str) -> None:
    prepared, gate = trial(noise=(20.0, 20.0, 6.0))
    problem, regrouping = fit(prepared, gate).problem, prepared.base.regrouping
    nowhere = np.full(16, np.nan)
    whole = fit_consistent(problem, regrouping, GRID, nowhere, consistency=consistency)  # type: ignore[arg-type]
    quick = fit_quickly(problem, regrouping, GRID, consistency)  # type: ignore[arg-type]
    assert problem.cost(quick) == pytest.approx(problem.cost(whole.parameters), rel=1e-5)
    np.testing.assert_allclose(quick, whole.parameters, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("pulls", [False, True])
def test_refitting_the_whole_trial_gives_the_whole_trials_parameters(pulls: bool) -> None:
    prepared, gate = trial(noise=(5.0, 5.0, 1.5))
    reference = 1.2 * BODY.ravel()
    found = identify(prepared, gate, GRID, reference, NO_ERROR, reference_pulls=pulls)
    assert found.uses_reference == pulls
    again = found.refit(found.fit.problem)
    np.testing.assert_allclose(again[:-1], found.base, rtol=1e-3, atol=1e-3)
    assert again[-1] == pytest.approx(found.plate_bias, abs=1e-3)
