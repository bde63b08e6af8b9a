"""Downsampled curves keep their peaks and gaps and contain only original samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocap_id.arrays import find_runs
from mocap_id.reporting.figure import find_shaded_spans, thin_band, thin_curve

BINS = 10
curves = arrays(
    np.float64, st.integers(0, 300), elements=st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")))
)  # fmt: skip


@given(curves)
def test_envelope_is_a_subset_that_keeps_the_extremes(values: np.ndarray) -> None:
    time = np.arange(len(values), dtype=float)
    t, v = thin_curve(time, values, BINS)
    assert len(t) <= max(3 * BINS, 0) or len(values) <= 3 * BINS
    assert np.all(np.diff(t) > 0)
    np.testing.assert_array_equal(v, values[t.astype(int)])
    if np.isfinite(values).any():
        assert np.nanmin(v) == np.nanmin(values) and np.nanmax(v) == np.nanmax(values)
    assert np.isnan(v).any() == np.isnan(values).any()


@given(curves)
def test_band_contains_every_sample(values: np.ndarray) -> None:
    time = np.arange(len(values), dtype=float)
    t, low, high = thin_band(time, values - 1.0, values + 1.0, BINS)
    assert len(t) == len(low) == len(high) <= max(BINS, 0) or len(values) <= BINS
    if np.isfinite(values).any():
        assert np.nanmin(low) == np.nanmin(values - 1.0) and np.nanmax(high) == np.nanmax(values + 1.0)
    assert np.array_equal(np.isnan(low), np.isnan(high))


@given(arrays(np.bool_, st.integers(0, 60)))
def test_runs_rebuild_the_mask(mask: np.ndarray) -> None:
    rebuilt = np.zeros_like(mask)
    for run in find_runs(mask):
        rebuilt[run] = True
    np.testing.assert_array_equal(rebuilt, mask)


def test_spans_with_invisible_gaps_are_joined() -> None:
    time = np.arange(1000) / 100.0
    mask = np.zeros(1000, dtype=bool)
    mask[100:200], mask[201:300], mask[600:650] = True, True, True
    assert find_shaded_spans(time, mask, bins=100) == [(1.0, pytest.approx(2.0)), (6.0, pytest.approx(0.5))]
    assert find_shaded_spans(time, np.zeros(1000, dtype=bool)) == []
