"""Unusual recordings: no movement, low and high frame rates, markers that appear late."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from simulated_chains import Moving, measured, rms, swinging
from test_ukf_smooth_stage import NO_SEGMENTS, STAGE, Context, Files, Path, TrialKeys, chain, planar

from mocap_id.estimation import States
from mocap_id.estimation.lasting_errors import (
    add_lasting_errors,
    compute_residual_spectrum,
    estimate_camera_sd,
)
from mocap_id.stages.ukf_smooth.plane import estimate_lasting_errors, estimate_skin
from mocap_id.store.parquet import conform_table

FLOOR = 5e-5


def deviations(states: States, moving: Moving) -> np.ndarray:
    """Return the standard deviations (F, n, 4) with lasting errors."""
    rested = np.where(states.used[..., None], moving.markers, np.nan)
    camera = estimate_camera_sd(rested, states, FLOOR)
    skin = estimate_skin(states, rested, camera)
    assert skin is not None
    spectrum = compute_residual_spectrum(states, rested, moving.rate)
    return add_lasting_errors(
        states, moving.rate, camera, *estimate_lasting_errors(states, rested, skin, camera, spectrum)
    )


@pytest.mark.parametrize("noise", [0.0, 5e-4])
def test_a_chain_at_rest_has_an_angle_and_no_velocity(noise: float) -> None:
    truth = np.zeros((600, 3, 4))
    truth[..., 0] = [0.3, -0.8, 1.2]
    moving = measured(truth, 100.0, noise, np.random.default_rng(3))
    states = moving.smoothed()
    sd = deviations(states, moving)
    assert np.isfinite(states.mean).all()
    assert np.isfinite(sd).all()
    off = np.abs(states.mean - truth)
    assert np.all(off <= 6 * sd + 1e-9)
    assert off[..., 1].max() < 0.05


@pytest.mark.parametrize(("rate", "seconds"), [(25.0, 20.0), (2000.0, 3.0)])
def test_slow_and_fast_cameras(rate: float, seconds: float) -> None:
    moving = swinging(joints=3, seconds=seconds, rate=rate, seed=8)
    states = moving.smoothed()
    sd = deviations(states, moving)
    assert np.isfinite(states.mean).all()
    error = states.mean - moving.truth
    assert np.all(rms(error)[:, :3] < [0.003, 0.02, 0.3])
    inside = np.mean(np.abs(error) <= 1.96 * sd, axis=(0, 1))
    assert np.all(inside[:3] > 0.88)


def test_a_first_frame_without_markers_is_filled_from_the_next() -> None:
    moving = swinging(joints=2, seconds=3.0, seed=1)
    markers = moving.markers.copy()
    markers[0] = np.nan
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    inputs = {"planar.parquet": planar(moving, markers), "chain.h5": chain(moving), "segments.parquet": NO_SEGMENTS}
    states, predicted, *_ = STAGE.function(Context(trial, STAGE.settings(), inputs))
    conform_table(states)
    conform_table(predicted)
    assert not states.reasons
    assert states.frame["observed_2"].to_numpy().nonzero()[0].tolist() == list(range(1, 300))
    np.testing.assert_allclose(states.frame["theta_2"][0], moving.truth[0, 1, 0], atol=0.01)


def memory(moving: Moving, frames: int) -> int:
    """Return the peak memory of the stage above the input for the first frames, bytes."""
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    fitted = replace(chain(moving), facts={"estimator": "bundle"})
    inputs = {
        "planar.parquet": planar(moving, moving.markers[:frames]),
        "chain.h5": fitted,
        "segments.parquet": NO_SEGMENTS,
    }
    context = Context(trial, STAGE.settings(), inputs)
    tracemalloc.start()
    STAGE.function(context)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.slow
def test_twenty_minutes_of_40_markers_take_350_megabytes_above_the_input() -> None:
    moving = swinging(joints=4, per_segment=10, seconds=120.0, rate=100.0)
    gone = np.random.default_rng(0).random((len(moving.markers) // 50, 40)) < 0.05
    moving.markers[np.repeat(gone, 50, axis=0)] = np.nan
    memory(moving, 100)
    few, many = memory(moving, 6000), memory(moving, 12_000)
    assert (many - few) / 6000 < 350e6 / (20 * 60 * 100)
