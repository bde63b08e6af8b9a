"""How long a residual lasts and returns: known processes, repetitions that are alike, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from mocap_id.dynamics.independence import memory

STEP = 0.02
TIME = STEP * np.arange(20_000)
NONE = np.zeros((0, 2))


def autoregressive(rho: float, seed: int, count: int = len(TIME)) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=count)
    return np.asarray(lfilter([1.0], [1.0, -rho], noise))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_an_autoregressive_series_lasts_as_the_theory_says(rho: float) -> None:
    """Δt (1 + ρ) / (1 - ρ), for each component by itself."""
    series = np.column_stack([autoregressive(rho, 1), 7.0 * autoregressive(0.0, 2)])
    lasting = memory(TIME, series, NONE)
    assert lasting[0] == pytest.approx(STEP * (1 + rho) / (1 - rho), rel=0.15)
    assert lasting[1] == pytest.approx(STEP, rel=0.15)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_what_returns_in_every_repetition_counts_once(share: float) -> None:
    """Five repetitions: 1 + 4 ρ times as long, with ρ the share of the variance that they have in common."""
    spans = np.column_stack([np.arange(5), np.arange(5) + 0.8]) * 80.0
    alike = autoregressive(0.6, 3, 4000)[:3201]
    parts = [np.pad(alike, (0, 799)) for _ in range(5)]
    series = np.sqrt(share) * np.concatenate(parts) + np.sqrt(1 - share) * autoregressive(0.6, 4)
    once, counted = memory(TIME, series[:, None], spans[:1]), memory(TIME, series[:, None], spans)
    assert counted / once == pytest.approx(1 + 4 * share, rel=0.15)


def test_samples_that_are_left_out_change_little() -> None:
    series, some = autoregressive(0.8, 5), np.random.default_rng(6).random(len(TIME)) < 0.7
    whole, thinned = memory(TIME, series[:, None], NONE), memory(TIME[some], series[some, None], NONE)
    assert thinned == pytest.approx(whole, rel=0.2)


def test_no_residual_at_all_counts_by_the_sample() -> None:
    assert memory(TIME, np.zeros((len(TIME), 2)), NONE) == pytest.approx(STEP)
