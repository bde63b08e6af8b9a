"""The low-pass: linear, without lag, blind across gaps; what the erosion leaves is clean."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import moving_body
from scipy.signal import butter, sosfiltfilt

from mocap_id.arrays import find_runs
from mocap_id.dynamics.preparation import LowPass, choose_cutoff, erode
from mocap_id.dynamics.regressor import planar_regressor

RATE = 100.0
TIME = np.arange(0, 20, 1 / RATE)


def test_regressor_and_wrench_stay_equal() -> None:
    """Filter(Y φ) = Filter(Y) φ, gaps included: the filter cannot bias the parameters."""
    recorded = moving_body()
    regressor = planar_regressor(recorded.centres, recorded.q, recorded.dq, recorded.ddq)
    regressor[300:320] = np.nan
    parameters = np.random.default_rng(0).normal(size=16)
    filtered = LowPass(4.0, recorded.rate)(regressor)
    np.testing.assert_allclose(filtered @ parameters, LowPass(4.0, recorded.rate)(regressor @ parameters), atol=1e-9)
    assert np.isnan(filtered[300:320]).all()
    assert np.isfinite(filtered[:300]).all()


@pytest.mark.parametrize("frequency", [0.3, 1.0])
def test_slow_movement_passes_without_lag(frequency: float) -> None:
    wave = np.sin(2 * np.pi * frequency * TIME)[:, None]
    inner = slice(200, -200)
    # a double pass through a second-order Butterworth: gain 1 / (1 + (f / fc)^4)
    gain = 1 / (1 + (frequency / 5.0) ** 4)
    np.testing.assert_allclose(LowPass(5.0, RATE)(wave)[inner], gain * wave[inner], atol=3e-4)


def test_noise_above_the_cutoff_is_gone() -> None:
    wave = np.sin(2 * np.pi * 30 * TIME)[:, None]
    assert np.abs(LowPass(4.0, RATE)(wave)[200:-200]).max() < 1e-3


def test_beyond_its_reach_an_impulse_is_hardly_felt() -> None:
    impulse = np.zeros((len(TIME), 1))
    impulse[1000] = 1.0
    lowpass = LowPass(4.0, RATE)
    response = np.abs(lowpass(impulse)[:, 0])
    far = np.abs(np.arange(len(TIME)) - 1000) > lowpass.reach_samples
    assert response[far].sum() < 0.035 * response.sum()


def test_a_gap_separates() -> None:
    signal = np.ones((400, 1))
    signal[200:210] = np.nan
    signal[210:] = 50.0
    out = LowPass(4.0, RATE)(signal)
    np.testing.assert_allclose(out[:200], 1.0, atol=1e-9)
    np.testing.assert_allclose(out[210:], 50.0, atol=1e-9)


def test_a_stretch_shorter_than_the_reach_is_left_out() -> None:
    signal = np.full((100, 1), np.nan)
    signal[10:30] = 1.0
    assert np.isnan(LowPass(4.0, RATE)(signal)).all()


def test_cutoff_follows_the_fastest_joint() -> None:
    slow, fast = np.sin(2 * np.pi * 0.5 * TIME), 0.2 * np.sin(2 * np.pi * 2.0 * TIME)
    assert choose_cutoff(np.column_stack([slow, fast]), RATE) == pytest.approx(4.0, abs=0.3)
    assert choose_cutoff(slow[:, None], RATE) == 3.0
    assert choose_cutoff(np.sin(2 * np.pi * 9 * TIME)[:, None], RATE) == 10.0
    assert choose_cutoff(np.sin(2 * np.pi * 20 * TIME)[:, None], 40.0) == 8.0


def test_cutoff_of_nothing_is_the_lowest() -> None:
    assert choose_cutoff(np.full((50, 2), np.nan), RATE) == 3.0
    assert choose_cutoff(np.zeros((50, 2)), RATE) == 3.0


def test_runs_and_erosion() -> None:
    mask = np.array([1, 1, 1, 0, 0, 1, 1, 1, 1, 1, 0, 1], dtype=bool)
    assert find_runs(mask) == [slice(0, 3), slice(5, 10), slice(11, 12)]
    np.testing.assert_array_equal(np.flatnonzero(erode(mask, 1)), [1, 6, 7, 8])
    np.testing.assert_array_equal(erode(mask, 0), mask)
    assert not erode(mask, 3).any()


@pytest.mark.parametrize(("cutoff", "rate"), [(3.0, 100.0), (5.0, 567.0), (10.0, 50.0)])
def test_it_is_butterworth_s_filter_forwards_and_backwards(cutoff: float, rate: float) -> None:
    """As scipy runs it over the reflected signal; at the very ends scipy's reflection is shorter."""
    signal = np.cumsum(np.random.default_rng(2).normal(size=(1500, 2)), axis=0)
    lowpass = LowPass(cutoff, rate)
    sections = butter(2, cutoff, fs=rate, output="sos")
    theirs = sosfiltfilt(sections, signal, axis=0, padlen=2 * lowpass.reach_samples)
    off = np.abs(lowpass(signal) - theirs) / signal.std(axis=0)
    reach = lowpass.reach_samples
    assert off.max() < 3e-3
    assert off[reach:-reach].max() < 3e-5


@pytest.mark.parametrize(("cutoff", "rate"), [(10.0, 5.0), (10.0, 8.0), (60.0, 100.0), (3.0, 1.0)])
def test_a_cutoff_above_the_frequencies_of_the_samples_passes_them(cutoff: float, rate: float) -> None:
    filter_ = LowPass(cutoff, rate)
    time = np.arange(200) / rate
    wave = np.sin(2 * np.pi * 0.1 * rate * time)[:, None]
    assert filter_.reach_samples >= 1
    np.testing.assert_allclose(filter_(wave)[60:-60], wave[60:-60], atol=2e-3)
