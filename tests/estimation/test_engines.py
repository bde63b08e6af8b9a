"""The compiled engine equals filterpy, for random chains, masks, outliers and starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from simulated_chains import Moving, kicked, rms, swinging

from mocap_id.estimation import filter_problem, filterpy_engine
from mocap_id.estimation.filter_problem import START_SD, FilterProblem, Track

EQUAL = 1e-9


def damaged(moving: Moving, seed: int) -> Moving:
    """Return markers with random gaps, long gaps, a late start, and outliers."""
    rng = np.random.default_rng(seed)
    markers = moving.markers.copy()
    markers[rng.random(markers.shape[:2]) < 0.15] = np.nan
    start, length = rng.integers(0, 80), rng.integers(2, 60)
    markers[start : start + length, moving.segment == rng.integers(1, len(moving.centres) + 1)] = np.nan
    markers[: rng.integers(0, 8)] = np.nan
    hit = rng.random(markers.shape[:2]) < 0.02
    markers[hit] += rng.normal(0, 0.05, (np.count_nonzero(hit), 2))
    return replace(moving, markers=markers)


def assert_same(one: Track, other: Track, *, deviation: float = EQUAL) -> None:
    """Check equality to 1e-9 of each state's size in the trial or of its initial standard deviation."""
    n = one.restarted.shape[1]
    scale = np.maximum(np.abs(other.mean).max(axis=0), np.repeat(START_SD, n))
    np.testing.assert_array_equal(one.used, other.used)
    np.testing.assert_array_equal(one.restarted, other.restarted)
    assert np.max(np.abs(one.mean - other.mean) / scale) <= EQUAL
    assert np.max(np.abs(one.sd - other.sd) / scale) <= deviation
    assert one.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-6)


def copied(track: Track) -> Track:
    return replace(track, mean=track.mean.copy(), covariance=track.covariance.copy())


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    joints=st.integers(1, 3),
    per_segment=st.integers(2, 4),
    seed=st.integers(0, 2**31),
    rate=st.sampled_from([25.0, 100.0, 480.0]),
)
def test_filter_and_smoother_equal_filterpy(joints: int, per_segment: int, seed: int, rate: float) -> None:
    moving = swinging(joints=joints, per_segment=per_segment, seconds=100 / rate, rate=rate, seed=seed)
    problem = damaged(moving, seed).problem(marker_sd=1e-3, sigma_v=3e5 / rate)
    ours, theirs = filter_problem.filter_forwards(problem), filterpy_engine.filter_slowly(problem)
    assert_same(ours, theirs)
    ours, theirs = filter_problem.smooth_backwards(problem, ours), filterpy_engine.smooth_slowly(problem, theirs)
    assert_same(ours, theirs)


def tracked() -> tuple[FilterProblem, Track]:
    problem = swinging(joints=2, seconds=1.0).problem(marker_sd=1e-3, sigma_v=3e3)
    return problem, filter_problem.filter_forwards(problem)


def test_the_smoother_equals_filterpys_without_restarts() -> None:
    problem, track = tracked()
    mean, covariance, _ = filterpy_engine._make_filter(problem).rts_smoother(track.mean, track.covariance)
    theirs = replace(track, mean=mean, covariance=covariance)
    # filterpy subtracts covariances, with cancellation at the first frames
    assert_same(filter_problem.smooth_backwards(problem, copied(track)), theirs, deviation=1e-7)


def test_a_marker_without_weight_changes_nothing() -> None:
    """Leaving out rows is equivalent to infinite noise."""
    moving = swinging(joints=2, seconds=1.0)
    problem = moving.problem(marker_sd=1e-3, sigma_v=3e3)
    markers, variance = moving.markers.copy(), problem.variance.copy()
    markers[:, 3] = np.nan
    variance[3] = 1e12
    without = filter_problem.filter_forwards(replace(problem, observed=markers))
    inflated = filter_problem.filter_forwards(replace(problem, variance=variance))
    np.testing.assert_allclose(inflated.mean, without.mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(inflated.sd, without.sd, rtol=1e-8)


def test_both_engines_can_be_selected_and_agree() -> None:
    moving = swinging(joints=2, seconds=0.8)
    ours, theirs = moving.smoothed(engine="compiled"), moving.smoothed(engine="filterpy")
    scale = np.maximum(rms(ours.mean), START_SD)
    assert np.max(np.abs(ours.mean - theirs.mean) / scale) <= EQUAL
    assert ours.marker_sd == theirs.marker_sd


def test_both_engines_follow_a_movement_that_outruns_the_process_noise() -> None:
    fast = kicked(seconds=1.5, noise=5e-4)
    problem = fast.problem(marker_sd=1e-3, sigma_v=1e3)
    ours, theirs = filter_problem.filter_forwards(problem), filterpy_engine.filter_slowly(problem)
    assert_same(ours, theirs)
    assert ours.used.mean() > 0.99
