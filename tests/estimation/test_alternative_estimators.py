"""Alternative estimators: their definitions, and no wrong number in a gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_chains import Moving, measured, rms, swinging

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.estimation import BRIDGE_LIMIT, FRAMEWISE, filter_problem, filterpy_engine
from mocap_id.estimation.filter_problem import START_SD, Anchors, noise_shape, transition
from mocap_id.estimation.smoothing import LEAST_SAMPLES, average_two_passes, smooth_butterworth

SIGNS = np.array([1.0, -1.0, 1.0, -1.0])
RIVALS = ("two-filter", *FRAMEWISE)


@pytest.fixture(scope="module")
def moving() -> Moving:
    return swinging(joints=2, seconds=4.0, seed=3)


def backwards(moving: Moving) -> Moving:
    return replace(moving, markers=moving.markers[::-1].copy())


def of_one(angle: FloatArray, seen: FloatArray | None = None) -> Anchors:
    """Return an angle (F,) as measured in single frames."""
    observed = np.ones((len(angle), 1), dtype=np.bool_) if seen is None else np.asarray(seen, dtype=np.bool_)[:, None]
    return Anchors(angle[:, None], np.full((len(angle), 1, 1), 1e-6), observed, observed)


def test_two_filter_is_the_average_of_filterpys_two_passes() -> None:
    moving = swinging(joints=2, per_segment=3, seconds=0.8, seed=5)
    noise = {"marker_sd": 5e-4, "sigma_v": 3e3}
    ahead, back = (
        filterpy_engine.filter_slowly(each.problem(**noise)).by_joint() for each in (moving, backwards(moving))
    )
    states = moving.smoothed(method="two-filter", **noise)
    scale = np.maximum(rms(ahead[0]), START_SD)
    expected = 0.5 * (ahead[0] + SIGNS * back[0][::-1])
    assert np.max(np.abs(states.mean - expected) / scale) <= 1e-9
    assert np.max(np.abs(states.sd - 0.5 * (ahead[1] + back[1][::-1])) / scale) <= 1e-9


def test_two_filter_is_symmetric_in_time(moving: Moving) -> None:
    noise = {"marker_sd": 5e-4, "sigma_v": 3e3}
    forwards, reversed_ = (each.smoothed(method="two-filter", **noise) for each in (moving, backwards(moving)))
    off = reversed_.mean[::-1] * SIGNS - forwards.mean
    assert np.max(np.abs(off) / np.maximum(rms(forwards.mean), START_SD)) <= 1e-8
    np.testing.assert_allclose(reversed_.sd[::-1], forwards.sd, rtol=1e-6)


def test_two_filter_standard_deviations_bound_its_errors() -> None:
    """The bound holds for any correlation of the passes; the noise is the true one."""
    off = np.concatenate([off_by_stated(seed) for seed in range(10)])
    assert np.all(rms(off) <= 1.0)
    assert np.all(rms(off) >= 0.5)


def off_by_stated(seed: int) -> FloatArray:
    """Return errors (F, 1, 4) of the two-filter over its standard deviations, for motion that follows the model."""
    rng, frames, dt = np.random.default_rng(seed), 300, 0.01
    truth = np.zeros((frames, 1, 4))
    for k in range(1, frames):
        truth[k, 0] = transition(dt) @ truth[k - 1, 0]
        truth[k, 0] += np.linalg.cholesky(noise_shape(dt)) @ rng.standard_normal(4) * 10.0 * np.sqrt(dt)
    problem = measured(truth, 1.0 / dt, 1e-3, rng).problem(marker_sd=1e-3, sigma_v=10.0)
    mean, sd, _, _ = average_two_passes(problem, filter_problem.filter_forwards)
    return np.asarray((mean - truth) / sd)


def test_two_filter_never_averages_two_turns() -> None:
    """A joint keeps turning in a gap: the passes may leave the gap in different turns."""
    moving = swinging(joints=1, seconds=4.0)
    truth = np.zeros_like(moving.truth)
    truth[:, 0, 0], truth[:, 0, 1] = 5.0 * np.arange(len(truth)) / moving.rate, 5.0
    turning = measured(truth, 100.0, 1e-4, np.random.default_rng(0))
    markers = turning.markers.copy()
    markers[120:270] = np.nan
    states = turning.smoothed_from(markers, method="two-filter")
    given = np.isfinite(states.mean[:, 0, 0])
    assert given[:110].all()
    assert given[280:].all()
    off = np.angle(np.exp(1j * (states.mean[given, 0, 0] - truth[given, 0, 0])))
    assert np.all(np.abs(off) <= 6.0 * states.sd[given, 0, 0] + 1e-4)


def test_every_method_finds_the_truth_without_noise() -> None:
    moving = swinging(joints=3, noise=0.0, seed=4)
    inside = slice(50, -50)
    size = np.abs(moving.truth).max(axis=(0, 1))
    for method, share in (("two-filter", 0.1), ("butterworth", 0.003), ("spline", 1e-6), ("rts", 1e-4)):
        found = moving.smoothed(method=method, butterworth_hz=12.0)
        error = np.abs(found.mean - moving.truth)[inside]
        assert np.all(error.max(axis=(0, 1)) <= share * size), method  # the accelerations of the averaged passes lag
        assert found.observed.all()


def test_the_low_pass_halves_its_cutoff_without_a_phase_shift() -> None:
    dt, time = 0.01, 0.01 * np.arange(2000)
    for hertz, gain in ((0.5, 1.0), (6.0, 0.5)):
        wave = np.sin(2 * np.pi * hertz * time)
        found = smooth_butterworth(of_one(wave), dt, 6.0)[300:-300, 0, 0]
        # the prewarped filter has exactly half its power at the cutoff, in each of the two passes
        np.testing.assert_allclose(found, gain * wave[300:-300], atol=2e-4 if hertz < 1 else 1e-6)


def test_derivatives_of_the_low_pass_are_central_differences() -> None:
    time = 0.01 * np.arange(1000)
    found = smooth_butterworth(of_one(0.3 * time**2), 0.01, 6.0)[200:-200, 0]
    np.testing.assert_allclose(found[:, 1], 0.6 * time[200:-200], atol=1e-4)
    np.testing.assert_allclose(found[:, 2], 0.6, atol=1e-3)


def test_a_cutoff_beyond_half_the_frame_rate_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"butterworth_hz is 15, expected less than half the frame rate, 12\.5 Hz"):
        smooth_butterworth(of_one(np.zeros(100)), 0.04, 15.0)


@pytest.mark.parametrize("method", FRAMEWISE)
def test_a_short_gap_is_bridged_and_a_long_one_left_open(moving: Moving, method: str) -> None:
    markers = moving.markers.copy()
    short, long = slice(100, 115), slice(200, 260)
    markers[short, moving.segment == 2] = np.nan
    markers[long, moving.segment == 2] = np.nan
    states = moving.smoothed_from(markers, method=method)
    assert np.isfinite(states.mean[short]).all()
    assert not states.observed[short, 1].any()
    np.testing.assert_allclose(states.mean[short, 1, 0], moving.truth[short, 1, 0], atol=0.05)
    assert np.isnan(states.mean[long, 1]).all()
    assert not states.observed[long, 1].any()
    assert np.isfinite(states.mean[:, 0]).all()
    assert states.observed[:, 0].all()
    given = np.ones(len(markers), dtype=np.bool_)
    given[long] = False
    assert np.isfinite(states.mean[given]).all()
    assert 15 < BRIDGE_LIMIT * moving.rate < 60


@pytest.mark.parametrize("method", FRAMEWISE)
def test_unknown_quantities_are_nan(moving: Moving, method: str) -> None:
    states = moving.smoothed(method=method)
    assert np.isnan(states.sd).all()
    assert np.isnan(states.log_likelihood)
    assert states.marker_sd == pytest.approx(5e-4, rel=0.1)


@pytest.mark.parametrize("method", RIVALS)
def test_without_markers_there_are_no_states(moving: Moving, method: str) -> None:
    states = moving.smoothed_from(np.full_like(moving.markers, np.nan), method=method)
    assert np.isnan(states.mean).all()
    assert not states.observed.any()


@pytest.mark.parametrize("method", FRAMEWISE)
@pytest.mark.parametrize("kept", [LEAST_SAMPLES - 1, LEAST_SAMPLES])
def test_a_stretch_needs_a_minimum_of_samples(moving: Moving, method: str, kept: int) -> None:
    markers = np.full_like(moving.markers, np.nan)
    markers[50 : 50 + kept] = moving.markers[50 : 50 + kept]
    given = np.isfinite(moving.smoothed_from(markers, method=method).mean[:, 0, 0])
    assert np.count_nonzero(given) == (kept if kept >= LEAST_SAMPLES else 0)


@pytest.mark.parametrize("method", RIVALS)
def test_angles_start_in_the_first_turn_and_do_not_jump(method: str) -> None:
    moving = swinging(joints=1, seconds=4.0)
    truth = np.zeros_like(moving.truth)
    truth[:, 0, 0], truth[:, 0, 1] = 3.0 + np.pi * np.arange(len(truth)) / moving.rate, np.pi
    turning = measured(truth, 100.0, 1e-4, np.random.default_rng(0))
    states = turning.smoothed(method=method)
    np.testing.assert_allclose(states.mean[30:-30, 0, 0], truth[30:-30, 0, 0], atol=2e-3)
