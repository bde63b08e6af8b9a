"""Resampling of analog signals to marker times, without lag for any ratio of the rates."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.recording import Plate, ThinnedFrames, compute_averaging_width, decimate


def plate(values: np.ndarray, rate: float, start: float = 0.0, ok: np.ndarray | None = None) -> Plate:
    three = np.repeat(values[:, None], 3, axis=1)
    good = np.ones(len(values), bool) if ok is None else ok
    return Plate(1, "type 2", None, three, 2 * three, good, rate, start)


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 10.0, 12.5, 20.0, 1000 / 60])
@pytest.mark.parametrize("start", [0.0, 3.41])
def test_a_ramp_is_reproduced_without_a_lag(ratio: float, start: float) -> None:
    rate = 100.0
    count = int(200 * ratio)
    times = start + np.arange(150) / rate
    analog = start + np.arange(count) / (ratio * rate)
    found = decimate(plate(7 * analog, ratio * rate, start), times, rate)
    assert found.ok.all()
    np.testing.assert_allclose(found.force[:, 0], 7 * times, atol=1e-6)
    np.testing.assert_allclose(found.moment[:, 2], 14 * times, atol=1e-6)


@pytest.mark.parametrize("ratio", [2, 3, 4, 5, 8])
def test_a_sine_keeps_its_phase(ratio: int) -> None:
    rate, hertz = 100.0, 3.0
    times = np.arange(300) / rate
    analog = np.arange(301 * ratio) / (rate * ratio)
    found = decimate(plate(np.sin(2 * np.pi * hertz * analog), rate * ratio), times, rate).force[20:280, 0]
    inner = times[20:280]
    sine, cosine = np.sin(2 * np.pi * hertz * inner), np.cos(2 * np.pi * hertz * inner)
    in_phase, quadrature = np.linalg.lstsq(np.column_stack([sine, cosine]), found, rcond=None)[0]
    assert abs(np.arctan2(quadrature, in_phase) / (2 * np.pi * hertz)) < 1e-6  # s of lag
    assert in_phase == pytest.approx(np.sinc(hertz / rate), abs=2e-3)


@pytest.mark.parametrize("ratio", [1, 2, 3, 4, 5, 10, 16])
def test_a_parabola_is_flattened_as_by_a_mean_over_the_stated_width(ratio: int) -> None:
    rate = 100.0
    times = np.arange(1, 150) / rate
    analog = np.arange(200 * ratio) / (ratio * rate)
    found = decimate(plate(analog**2, ratio * rate), times, rate).force[:, 0]
    width = compute_averaging_width(ratio * rate, rate)
    np.testing.assert_allclose(found - times**2, width**2 / 12, atol=1e-12)
    assert (width > 1 / rate) == (ratio > 1)


def test_without_plates_nothing_is_averaged() -> None:
    assert compute_averaging_width(None, 100.0) == 0.0


@pytest.mark.parametrize("ratio", [2, 5, 10])
def test_noise_is_averaged(ratio: int) -> None:
    noise = np.random.default_rng(0).normal(size=5000 * ratio)
    found = decimate(plate(noise, 100.0 * ratio), np.arange(10, 4900) / 100, 100.0)
    assert found.force[:, 0].std() == pytest.approx(1 / np.sqrt(ratio), rel=0.15)


def test_equal_rates_change_nothing() -> None:
    values = np.random.default_rng(0).normal(size=50)
    np.testing.assert_allclose(decimate(plate(values, 100.0), np.arange(50) / 100, 100.0).force[:, 0], values)


def test_bad_samples_affect_only_frames_whose_interval_contains_them() -> None:
    ok = np.ones(500, bool)
    ok[250] = False
    values = np.where(ok, 1.0, np.nan)
    found = decimate(plate(values, 500.0, ok=ok), np.arange(100) / 100, 100.0)
    assert np.flatnonzero(~found.ok).tolist() == [50]
    assert np.isnan(found.force[50]).all()
    np.testing.assert_allclose(found.force[np.arange(100) != 50], 1.0)


def test_times_outside_the_plate_are_not_ok() -> None:
    found = decimate(plate(np.ones(100), 100.0, start=1.0), np.array([0.5, 1.0, 1.99, 2.0, 3.0]), 100.0)
    assert found.ok.tolist() == [False, True, True, False, False]
    assert np.isnan(found.force[[0, 3, 4]]).all()


@pytest.mark.parametrize("hertz", [50.0, 60.0])
def test_mains_hum_is_averaged_in_thinned_frames(hertz: float) -> None:
    """A 60 Hz signal sampled at 60 Hz would be constant."""
    analog = np.arange(9600) / 960
    plates = [plate(700 + 5 * np.sin(2 * np.pi * hertz * analog + 1), 960.0)]
    thinned = ThinnedFrames.of(np.zeros((4800, 1, 3)), np.arange(4800) / 480, 480.0, plates)
    assert (thinned.step, thinned.rate, len(thinned.positions)) == (8, 60.0, 600)
    assert np.mean(thinned.samples[0].force[1:-1, 2]) == pytest.approx(700, abs=0.02)


@pytest.mark.parametrize("rate", [30.0, 50.0, 100.0, 119.88])
def test_a_slow_recording_is_not_thinned(rate: float) -> None:
    plates, time = [plate(np.sin(np.arange(5000) / 7), 10 * rate)], np.arange(400) / rate
    positions = np.random.default_rng(0).normal(size=(400, 3, 3))
    thinned = ThinnedFrames.of(positions, time, rate, plates)
    np.testing.assert_array_equal(thinned.positions, positions)
    np.testing.assert_array_equal(thinned.time, time)
    np.testing.assert_array_equal(thinned.samples[0].force, decimate(plates[0], time, rate).force)
