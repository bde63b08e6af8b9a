"""Filtered, wandering and oscillating markers: what the residuals' spectrum shows, and whether intervals hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from simulated_chains import Moving, swinging
from test_state_errors import camera, told
from test_ukf_smooth_stage import NO_SEGMENTS, chain, planar

from mocap_id.arrays import FloatArray
from mocap_id.estimation.lasting_errors import (
    ResidualSpectrum,
    add_lasting_errors,
    compute_residual_spectrum,
)
from mocap_id.stages.base import Context
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.stages.ukf_smooth.checks import bridge_repeated, find_repeated_frames


def seen(moving: Moving) -> ResidualSpectrum:
    states = moving.smoothed()
    return compute_residual_spectrum(states, np.where(states.used[..., None], moving.markers, np.nan), moving.rate)


def filtered(moving: Moving, cut_off: float) -> Moving:
    through = butter(2, cut_off, fs=moving.rate, output="sos")
    return replace(moving, markers=sosfiltfilt(through, moving.markers, axis=0))


def wobbling(moving: Moving, size: float, hz: float = 4.0) -> Moving:
    """Return markers of the second segment that oscillate together by ``size`` (m rms)."""
    markers = moving.markers.copy()
    time = np.arange(len(markers)) / moving.rate
    markers[:, moving.segment == 2] += (np.sqrt(2) * size * np.sin(2 * np.pi * hz * time))[:, None, None] * (0.8, 0.6)
    return replace(moving, markers=markers)


@pytest.mark.parametrize("cut_off", [3.0, 6.0, 10.0])
def test_the_cut_off_of_a_filter_is_found(cut_off: float) -> None:
    assert seen(filtered(swinging(seconds=16), cut_off)).cut_off == pytest.approx(cut_off, rel=0.25)


@pytest.mark.parametrize("rate", [50.0, 100.0, 240.0])
def test_white_noise_shows_neither_filter_nor_oscillation(rate: float) -> None:
    spectrum = seen(swinging(seconds=12, rate=rate))
    assert spectrum.cut_off is None
    assert not spectrum.oscillations


def test_markers_without_noise_are_not_called_filtered() -> None:
    assert seen(swinging(seconds=12, noise=0.0)).cut_off is None


def test_an_oscillating_segment_is_named_with_its_frequency() -> None:
    found = seen(wobbling(swinging(seconds=16), 1e-3)).oscillations
    assert 2 in {segment for segment, _, _ in found}
    assert all(frequency == pytest.approx(4.0, abs=0.6) for _, frequency, _ in found)


def coverage(moving: Moving) -> FloatArray:
    """Return the shares (3,) of angles, velocities and accelerations within their 95 % intervals."""
    states = moving.smoothed()
    errors = told(states, moving)
    assert errors is not None
    off = states.mean - moving.truth
    off[..., 0] -= np.median(off[..., 0], axis=0)
    inside = np.abs(off) <= 1.96 * add_lasting_errors(states, moving.rate, *errors)
    return np.asarray(np.mean(inside, axis=(0, 1))[:3])


@pytest.mark.parametrize("fault", [lambda m: filtered(m, 8.0), lambda m: wobbling(m, 1e-3)], ids=["filter", "wobble"])
def test_intervals_hold_under_coloured_noise(fault: Any) -> None:
    shares = np.mean([coverage(fault(swinging(seconds=10, seed=seed))) for seed in range(3)], axis=0)
    assert np.all(shares > 0.88)


def test_camera_noise_is_small_in_filtered_markers() -> None:
    """The intervals would be too narrow with it alone."""
    moving = filtered(swinging(seconds=10), 6.0)
    assert camera(moving.smoothed(), moving) < 1e-4


def run(moving: Moving) -> Any:
    inputs: dict[str, Any] = {"planar.parquet": planar(moving, moving.markers), "chain.h5": chain(moving)}
    inputs["chain.h5"] = replace(inputs["chain.h5"], facts={"estimator": "bundle"})
    inputs["segments.parquet"] = NO_SEGMENTS
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    return STAGE.function(Context(trial, STAGE.settings(), inputs))[0]


def test_a_filter_below_the_movement_withdraws_the_intervals() -> None:
    strong, weak = (run(filtered(swinging(joints=2, seconds=12), hz)) for hz in (3.0, 8.0))
    assert [reason.code for reason in strong.reasons] == [reason.code for reason in weak.reasons] == ["prefiltered"]
    assert np.isnan(strong.columns["sd_ddtheta_1"]).all()
    assert np.isfinite(weak.columns["sd_ddtheta_1"]).all()


def test_repeated_frames_are_named_and_left_out() -> None:
    moving = swinging(joints=2, seconds=8)
    rng = np.random.default_rng(3)
    source = np.maximum.accumulate(
        np.where(rng.uniform(size=len(moving.markers)) < 0.3, 0, np.arange(len(moving.markers)))
    )
    table = run(replace(moving, markers=moving.markers[source]))
    assert [reason.code for reason in table.reasons] == ["repeated-frames"]
    assert table.reasons[0].value == pytest.approx(0.3, abs=0.05)
    clean = run(moving)
    wrong, right = (np.std(t.columns["ddtheta_1"] - moving.truth[:, 0, 2]) for t in (table, clean))
    assert wrong < 1.6 * right
    assert np.mean(table.columns["observed_1"]) > 0.99


def test_a_rest_without_noise_repeats_no_frame() -> None:
    still = np.repeat(swinging(seconds=1).markers[:1], 50, axis=0)
    assert not find_repeated_frames(still).any()
    one = swinging(seconds=1).markers.copy()
    one[40] = one[39]
    np.testing.assert_array_equal(np.flatnonzero(find_repeated_frames(one)), [40])


def test_only_short_runs_of_repeated_frames_count_as_observed() -> None:
    observed = np.ones((60, 1), dtype=np.bool_)
    repeated = np.zeros(60, dtype=np.bool_)
    repeated[[5, 6, *range(20, 50)]] = True
    observed[repeated] = False
    np.testing.assert_array_equal(np.flatnonzero(~bridge_repeated(observed, repeated, 100.0)), np.arange(20, 50))
