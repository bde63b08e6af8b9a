"""How samples count against the prior: the one-standard-error rule, folds against fits from scratch, few folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pose_cases import BODIES, moving, recorded_of

from mocap_id.dynamics.fit import (
    MEMORIES,
    REFERENCE,
    Fit,
    choose_memory,
    estimate_memory,
    fit,
    number_parts,
    score_memories,
    select_samples,
)
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, prepare
from mocap_id.dynamics.priors import BodyPrior, build_table_prior

TIME = np.arange(3000) / 100
EVERYTHING = np.ones(len(TIME), dtype=bool)
SPANS = np.array([[0.5, 6.0], [6.5, 12.0], [12.5, 18.0], [18.5, 24.0], [24.5, 29.5]])
PRIOR = build_table_prior((BODIES * [1.2, 0.9, 1.1, 1.3]).ravel(), "a table", others=True)


def made(prior: BodyPrior, spans: np.ndarray = SPANS) -> PreparedTrial:
    recorded = recorded_of(TIME, moving(TIME), noise=(2.0, 2.0, 0.6))
    return prepare(recorded, FitSettings(), replace(prior, spans=spans))


def counted(found: Fit, prepared: PreparedTrial) -> np.ndarray:
    """Seconds that one independent sample of each component stands for, from the weighted residuals."""
    rows = found.design[..., :-1].reshape(found.target.size, -1)
    residual = found.target - (rows @ found.problem.free_solution()).reshape(found.target.shape)
    return np.asarray(prepared.lowpass.step / prepared.recorded.rate / residual.var(axis=0))


def test_the_longest_memory_within_one_standard_error_of_the_least() -> None:
    spread = np.array([-1.0, 0.0, 1.0])[:, None]  # standard error 1 / √3 = 0.577
    mean = np.array([5.0, 4.0, 4.5, 4.57, 4.59, 9.0])
    assert choose_memory(mean + spread) == MEMORIES[3]
    assert choose_memory(mean + 1e-6 * spread) == MEMORIES[1]
    assert choose_memory(mean + 100 * spread) == MEMORIES[-1]


def test_the_error_is_that_of_fits_from_scratch_to_the_rest() -> None:
    rng = np.random.default_rng(0)
    rows, target = rng.normal(size=(300, 3, 5)), rng.normal(size=(300, 3))
    prior = np.pad(np.diag([1.0, 2.0, 3.0, 4.0]), ((0, 0), (0, 1))), rng.normal(size=4)
    fitted, predicted = np.arange(300) > 120, np.arange(300) < 100
    errors = score_memories(rows, target, prior, apart=0.3, fitted=fitted, predicted=predicted)
    for seconds, error in zip(MEMORIES, errors, strict=True):
        size = np.sqrt(min(1.0, 0.3 / seconds))
        both = np.concatenate([size * rows[fitted].reshape(-1, 5), prior[0]])
        right = np.concatenate([size * target[fitted].reshape(-1), prior[1]])
        found = np.linalg.lstsq(both, right, rcond=None)[0]
        assert error == pytest.approx(np.mean((rows[predicted] @ found - target[predicted]) ** 2), rel=1e-9)


def test_a_part_that_is_left_out_is_not_seen_through_the_filter() -> None:
    prepared = made(PRIOR)
    part = number_parts(TIME, SPANS)
    for k in range(5):
        seen = select_samples(prepared, EVERYTHING & (part != k))
        away = np.abs(np.flatnonzero(seen)[:, None] - np.flatnonzero(part == k)).min()
        assert away > prepared.lowpass.reach_samples


def test_the_fit_counts_its_samples_by_what_is_chosen() -> None:
    prepared = made(PRIOR)
    found = fit(prepared, EVERYTHING)
    seconds = counted(found, prepared)
    np.testing.assert_allclose(seconds, seconds[0], rtol=0.1)  # all components alike
    design = found.design[..., :-1] / found.weights[:, None]
    spread = found.weights * np.sqrt(seconds.mean() * prepared.recorded.rate / prepared.lowpass.step)
    assert found.prior is not None
    chosen = estimate_memory(
        prepared,
        EVERYTHING,
        found.samples,
        rows=design * spread[:, None],
        target=found.target / found.weights * spread,
        prior=found.prior,
    )
    assert chosen in MEMORIES
    assert seconds.mean() == pytest.approx(chosen, rel=0.1)


def test_a_prior_that_helps_counts_for_much_and_one_that_is_far_off_for_little() -> None:
    good = replace(PRIOR, mean=BODIES.ravel())
    off = replace(PRIOR, mean=PRIOR.mean + 2.0 * np.sqrt(np.diag(PRIOR.covariance)), covariance=PRIOR.covariance / 25)
    seconds = [float(counted(fit(each, EVERYTHING), each).mean()) for each in (made(good), made(off))]
    assert seconds[0] == pytest.approx(MEMORIES[-1], rel=0.1)
    assert seconds[1] < MEMORIES[1]


@pytest.mark.parametrize("repetitions", [0, 1, 2])
def test_few_repetitions_leave_the_reference(repetitions: int) -> None:
    prepared = made(PRIOR, SPANS[:repetitions])
    np.testing.assert_allclose(counted(fit(prepared, EVERYTHING), prepared), REFERENCE, rtol=0.1)


def test_parts_without_a_second_of_rest_do_not_count() -> None:
    """Three repetitions of which the gate leaves little beside the last: two folds have nothing to fit to."""
    prepared = made(PRIOR, SPANS[:3])
    gate = TIME > 11.0
    samples = np.flatnonzero(prepared.usable & gate)[:: prepared.lowpass.step]
    rows = np.ones((len(samples), 3, 20))
    prior = PRIOR.rows(20)
    assert estimate_memory(prepared, gate, samples, rows=rows, target=rows[..., 0], prior=prior) == REFERENCE


def test_the_reference_is_one_of_those_tried() -> None:
    assert REFERENCE in MEMORIES
    assert np.all(np.diff(MEMORIES) > 0)
