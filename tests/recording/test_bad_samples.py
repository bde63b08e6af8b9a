"""Non-finite analog samples and spikes make samples or a plate unusable, never the recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_cases import CORNERS, body, build_c3d, plate_parameters, save, signals, standing_wrench

from mocap_id import recording
from mocap_id.recording.lab_plates import is_force_on_plate
from mocap_id.workflows.recording_trial import describe_recording

FRAMES, PER_FRAME = 60, 5
SAMPLES = FRAMES * PER_FRAME
FORCE, MOMENT = standing_wrench(SAMPLES, CORNERS)
CHANNELS = signals(FORCE, MOMENT, CORNERS, 500.0).channels * [1, 1, 1, 1e3, 1e3, 1e3]
UNITS = {"ANALOG:UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"]}
ZERO = {"FORCE_PLATFORM:ZERO": np.array([1, 10])}
BASELINE = slice(0, 10 * PER_FRAME)
OFFSET = np.array([3.0, -2.0, 20.0, 900.0, 300.0, 50.0])


def read(folder: Path, analog: np.ndarray, zero: bool = False) -> recording.Recording:
    parameters = UNITS | plate_parameters(2, range(1, 7)) | (ZERO if zero else {})
    return recording.read(save(folder, build_c3d(body(FRAMES) * 1e3, analog=analog, parameters=parameters)))


def unloaded_first() -> np.ndarray:
    analog = CHANNELS.copy()
    analog[BASELINE] = np.random.default_rng(6).normal(scale=1e-3, size=(10 * PER_FRAME, 6))
    return analog + OFFSET


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_samples_of_a_baseline_are_not_used(tmp_path: Path, bad: float) -> None:
    analog = unloaded_first()
    analog[7, 2] = analog[20:24, 4] = bad
    (plate,) = read(tmp_path, analog, zero=True).plates
    assert plate.usable
    assert np.flatnonzero(~plate.ok).tolist() == [7, 20, 21, 22, 23]
    np.testing.assert_allclose(plate.force[50:], FORCE[50:], atol=2e-3)
    np.testing.assert_allclose(plate.force[:50][plate.ok[:50]], 0, atol=1e-2)


def test_a_baseline_of_too_few_good_samples_is_not_subtracted(tmp_path: Path) -> None:
    analog = unloaded_first()
    analog[:40, 2] = np.nan
    found = read(tmp_path, analog, zero=True)
    assert any("only 10 of 50 samples of the baseline" in oddity for oddity in found.oddities)
    offset = signals(FORCE, MOMENT, CORNERS, 500.0).channels[50:, :3] + OFFSET[:3]
    np.testing.assert_allclose(np.abs(found.plates[0].force[50:, 2]), np.abs(offset[:, 2]), atol=1e-3)


def test_a_spike_does_not_make_a_loaded_baseline_an_offset(tmp_path: Path) -> None:
    analog = CHANNELS.copy()
    analog[200, 2] = 20e3
    found = read(tmp_path, analog, zero=True)
    assert any("(ZERO) are loaded" in oddity for oddity in found.oddities)
    np.testing.assert_allclose(found.plates[0].force[:200], FORCE[:200], atol=1e-3)


@pytest.mark.parametrize("zero", [False, True])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_many_bad_samples_do_not_make_the_plate_unusable(tmp_path: Path, share: float, zero: bool) -> None:
    analog = CHANNELS.copy()
    analog[np.random.default_rng(4).random(SAMPLES) < share] = np.nan
    (plate,) = read(tmp_path, analog, zero).plates
    np.testing.assert_array_equal(plate.ok, np.isfinite(analog).all(axis=1))
    np.testing.assert_allclose(plate.force[plate.ok], FORCE[plate.ok], atol=1e-3)


@pytest.mark.parametrize("channel", [0, 2, 5, slice(None)])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_dead_channel_makes_the_plate_unusable(tmp_path: Path, channel: int | slice, bad: float) -> None:
    analog = CHANNELS.copy()
    analog[:, channel] = bad
    found = read(tmp_path, analog, zero=True)
    assert "numbers" in found.plates[0].problem
    assert describe_recording(found)["plates"][0]["mean_fz_N"] is None


@pytest.mark.parametrize("spike", [20e3, 200e3])
def test_spikes_do_not_reverse_a_plate(tmp_path: Path, spike: float) -> None:
    analog = CHANNELS.copy()
    analog[[10, 40, 80, 120], 2] = spike  # the plate's z points down: a load on the body's side is negative
    found = read(tmp_path, analog)
    good = np.ones(SAMPLES, bool)
    good[[10, 40, 80, 120]] = False
    np.testing.assert_allclose(found.plates[0].force[good], FORCE[good], atol=1e-3)
    assert not any("reversed" in oddity for oddity in found.oddities)


@pytest.mark.parametrize(
    ("spikes", "offset", "contact"), [(0, 0.0, 300), (20, 0.0, 300), (0, 30.0, 100), (2, 25.0, 100), (0, 0.0, 3)]
)
def test_the_load_decides_the_sign(spikes: int, offset: float, contact: int) -> None:
    """Spikes of the opposite sign and the offset of the unloaded plate do not decide."""
    vertical = np.full(300, -offset)
    vertical[:contact] = 700.0
    vertical[:spikes] = -20e3
    assert not is_force_on_plate(vertical)
    assert is_force_on_plate(-vertical)


def test_an_unloaded_plate_is_not_reversed() -> None:
    assert not is_force_on_plate(np.full(100, -19.0))
    assert not is_force_on_plate(np.empty(0))
