"""The reference term: each parameter in its own unit, as a prior exactly what Bayes says, else silent on the data."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from dynamics_cases import BODY, moving_body
from grid_cases import GRID, NO_REFERENCE, M, problem

from mocap_id.dynamics.consistency import fit_consistent
from mocap_id.dynamics.identification import identify
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.preparation import FitSettings, prepare
from mocap_id.dynamics.priors import ReferencePrior, compute_reference_sd

NO_ERROR = KinematicError.none(3)
NOISE = (0.5, 0.5, 0.15)


def test_deviations_are_a_share_of_each_segment_s_own_size() -> None:
    found = compute_reference_sd(BODY.ravel(), 0.1).reshape(-1, 4)
    np.testing.assert_allclose(found[:, 0], 0.1 * BODY[:, 0])
    np.testing.assert_allclose(found[:, 1], 0.1 * np.hypot(BODY[:, 1], BODY[:, 2]))
    np.testing.assert_allclose(found[:, 2], found[:, 1])  # mx may be zero: the pair has a size
    np.testing.assert_allclose(found[:, 3], 0.1 * BODY[:, 3])
    assert np.isnan(compute_reference_sd(NO_REFERENCE, 0.1)).all()
    assert (compute_reference_sd(np.zeros(16), 0.1) > 0).all()


def known(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Base parameters and their covariance, correlated."""
    small = problem(seed, 1.0)
    return small.free_solution(), 30 * np.linalg.inv(small.factor.T @ small.factor)


def test_the_problem_with_a_prior_is_its_two_sums_of_squares() -> None:
    rng, (base, covariance) = np.random.default_rng(0), known()
    prior = ReferencePrior(BODY.ravel(), compute_reference_sd(BODY.ravel(), 0.15))
    both = prior.add_to(base, covariance, M, 7.0)
    for _ in range(20):
        full = BODY.ravel() * rng.uniform(0.5, 1.5, 16)
        off = M @ full - base
        expected = off @ np.linalg.solve(covariance, off) + np.sum(((full - prior.mean) / prior.sd) ** 2) + 7.0
        assert both.cost(full) == pytest.approx(expected, rel=1e-9)


def test_gain_and_covariance_are_those_of_bayes() -> None:
    """Against the sum of both sides' information matrices; the least cost is at the posterior's mean."""
    base, covariance = known()
    prior = ReferencePrior(1.1 * BODY.ravel(), compute_reference_sd(BODY.ravel(), 0.15))
    gain = prior.gain(covariance, M)
    of_prior = M @ np.diag(prior.sd**2) @ M.T
    expected = np.linalg.inv(np.linalg.inv(covariance) + np.linalg.inv(of_prior))
    np.testing.assert_allclose(prior.covariance(gain, M, covariance), expected, rtol=1e-6, atol=1e-12)
    mean = gain @ base + (np.eye(11) - gain) @ M @ prior.mean
    np.testing.assert_allclose(M @ prior.add_to(base, covariance, M, 0.0).free_solution(), mean, rtol=1e-7)


def test_units_do_not_matter_to_a_prior() -> None:
    """One lambda for kg, kg·m and kg·m² would give another answer in another unit of length; this does not."""
    unit = np.tile([1.0, 10.0, 10.0, 100.0], 4)
    base, covariance = known()
    own = unit[np.argmax(M == 1.0, axis=1)]
    mean, sd = 1.2 * BODY.ravel(), compute_reference_sd(1.2 * BODY.ravel(), 0.15)
    here = ReferencePrior(mean, sd).add_to(base, covariance, M, 0.0).free_solution()
    there = ReferencePrior(mean * unit, sd * unit).add_to(
        base * own, covariance * np.outer(own, own), M * own[:, None] / unit, 0.0
    )
    np.testing.assert_allclose(there.free_solution() / unit, here, rtol=1e-6, atol=1e-8)


def identified(noise: float = 1.0, **changes: object):
    prepared = prepare(moving_body(noise=tuple(noise * np.array(NOISE))), FitSettings())
    gate = np.ones(len(prepared.recorded.time), dtype=bool)
    reference = BODY.ravel() * np.repeat([1.3, 0.8, 1.2, 0.95], 4)
    return prepared, reference, identify(prepared, gate, GRID, reference, NO_ERROR, **changes)


@pytest.mark.parametrize("consistency", ["grid", "cone", "bounded-cone"])
def test_by_default_the_reference_leaves_the_base_parameters_alone(consistency: str) -> None:
    prepared, reference, found = identified(consistency=consistency)
    gate = np.ones(len(prepared.recorded.time), dtype=bool)
    without = identify(prepared, gate, GRID, NO_REFERENCE, NO_ERROR, consistency=consistency)
    np.testing.assert_allclose(found.base, without.base, rtol=1e-9)
    np.testing.assert_allclose(found.base_sd, without.base_sd, rtol=1e-9)
    np.testing.assert_allclose(M @ found.full, found.base, atol=1e-5)
    assert not found.uses_reference
    distance = [
        np.sum(((one.full - reference) / compute_reference_sd(reference, 0.15)) ** 2) for one in (found, without)
    ]
    assert distance[0] < distance[1]


@pytest.mark.parametrize("consistency", ["grid", "bounded-cone"])
def test_a_pulling_reference_takes_its_share(consistency: str) -> None:
    """The tighter, the nearer; and what is known better from the data moves less."""
    _, reference, alone = identified(100.0, consistency=consistency)
    unit, misfit, sd = compute_reference_sd(reference, 1.0), [], []
    for relative in (0.5, 0.1, 0.01):
        _, _, found = identified(100.0, consistency=consistency, reference_sd=relative, reference_pulls=True)
        assert found.uses_reference
        assert found.solution.answer.optimality.proven
        np.testing.assert_allclose(M @ found.full, found.base, atol=1e-5)
        misfit.append(np.sum(((found.full - reference) / unit) ** 2))
        sd.append(found.base_sd)
    assert all(near < far for far, near in pairwise(misfit))
    assert misfit[-1] < 0.1 * misfit[0]
    assert all((tight < 1.05 * loose).all() for loose, tight in pairwise([alone.base_sd, *sd]))
    assert (sd[-1] < 0.9 * alone.base_sd).sum() >= 5


def test_a_prior_needs_a_reference() -> None:
    prepared = prepare(moving_body(noise=NOISE), FitSettings())
    gate = np.ones(len(prepared.recorded.time), dtype=bool)
    found = identify(prepared, gate, GRID, NO_REFERENCE, NO_ERROR, reference_pulls=True)
    assert not found.uses_reference
    assert np.isfinite(found.base).all()


def test_full_parameters_without_data_are_the_reference() -> None:
    prior = ReferencePrior(BODY.ravel(), compute_reference_sd(BODY.ravel(), 0.15))
    nothing = prior.add_to(np.zeros(11), 1e12 * np.eye(11), M, 0.0)
    found = fit_consistent(nothing, np.eye(16), GRID, BODY.ravel(), consistency="cone", relative_sd=0.15)
    np.testing.assert_allclose(found.full, BODY.ravel(), rtol=1e-6)
