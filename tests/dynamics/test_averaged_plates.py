"""Plates' samples are means over a frame: what that takes off the filtered wrench is put back, and no noise with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, moving_body, waves

from mocap_id.dynamics.fit import fit
from mocap_id.dynamics.preparation import FitSettings, LowPass, TrialData, prepare, undo_averaging
from mocap_id.dynamics.regressor import planar_regressor

RATE = 100.0
TIME = np.arange(0, 20, 1 / RATE)
INNER = slice(300, -300)


@pytest.mark.parametrize("width", [0.5, 1.0, 1.2])
@pytest.mark.parametrize("frequency", [1.0, 3.0])
def test_a_mean_is_undone(width: float, frequency: float) -> None:
    """A mean over W makes a sine sinc(f W) times as large; nineteen in twenty parts of that are put back."""
    wave, lowpass = np.sin(2 * np.pi * frequency * TIME)[:, None], LowPass(10.0, RATE)
    lost = 1.0 - np.sinc(frequency * width / RATE)
    exact = lowpass(wave)[INNER]
    left = undo_averaging(lowpass((1.0 - lost) * wave), width)[INNER] - exact
    assert np.abs(left).max() < 0.05 * lost * np.abs(exact).max()


def test_without_averaging_nothing_changes() -> None:
    signal = np.random.default_rng(0).normal(size=(100, 3))
    np.testing.assert_array_equal(undo_averaging(signal, 0.0), signal)


def test_gaps_stay_as_large_as_they_are() -> None:
    signal = np.random.default_rng(0).normal(size=(100, 2))
    signal[40:50] = np.nan
    found = undo_averaging(signal, 1.0)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(signal))
    for end in (0, 39, 50, 99):
        np.testing.assert_array_equal(found[end], signal[end])


@pytest.mark.parametrize("cutoff", [3.0, 10.0])
def test_noise_hardly_grows(cutoff: float) -> None:
    noise = LowPass(cutoff, RATE)(np.random.default_rng(1).normal(size=(50_000, 1)))
    assert 1.0 < undo_averaging(noise, 1.0).std() / noise.std() < 1.006


def test_the_parameters_lose_their_bias() -> None:
    """The wrench of a moving body as means over each frame, taken of its exact course."""
    recorded, fine = moving_body(seconds=20.0), 20
    course = np.arange(-fine, fine * (len(recorded.time) + 1)) / (fine * RATE)
    exact = planar_regressor(CENTRES, *waves(course, len(CENTRES))) @ BODY.ravel()
    means = [
        np.average(exact[fine * k + fine // 2 : fine * (k + 1) + fine // 2 + 1], axis=0, weights=trapezoid(fine))
        for k in range(len(recorded.time))
    ]
    averaged = replace(recorded, wrench=np.array(means))

    def worst(case: TrialData) -> float:
        prepared = prepare(case, FitSettings())
        solution = fit(prepared, np.ones(len(case.time), dtype=bool)).problem.free_solution()
        true = prepared.base.regrouping @ BODY.ravel()
        return float(np.max(np.abs(solution[: len(true)] - true)))

    as_they_are, put_back = worst(averaged), worst(replace(averaged, averaged=1 / RATE))
    assert as_they_are > 1e-3
    assert put_back < 0.1 * as_they_are


def trapezoid(intervals: int) -> np.ndarray:
    """Weights of the trapezoidal rule."""
    return np.concatenate([[0.5], np.ones(intervals - 1), [0.5]])
