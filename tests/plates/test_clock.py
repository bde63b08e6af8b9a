"""The coarse search for the clock offset: found within ± 5 s, or said, before forces and markers are used together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mocap_id import recording
from mocap_id.plates.clock import ClockSearch, find_clock_offset
from mocap_id.recording import Plate
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import Table
from mocap_id_simulation import Options, SimulatedTrial, generate

RATE = 100.0
GRAVITY = 9.81


@cache
def simulated(kind: str, **options: float) -> SimulatedTrial:
    return generate(kind, Options(seed=31, repetitions=3, **options))


def planarised(folder: Path, made: SimulatedTrial, offset: float, protocol: str) -> Table:
    """Return wrench.parquet of a trial whose forces are stamped ``offset`` too early, over the time of the markers.

    The samples beyond the end stand at the beginning, as after a buffer that wraps: no frame may use them.
    """
    plates = [each for each in (made.signals, made.seat_signals) if each is not None]
    moved = [replace(each, channels=np.roll(each.channels, -round(offset * each.rate), axis=0)) for each in plates]
    labels = list(made.labels)
    recording.write_c3d(folder / "t.c3d", labels, made.points, RATE, plates=moved)
    trial = TrialKeys(trial="t", recording=Files(markers=folder / "t.c3d"), protocol=protocol)
    _, wrench = STAGE.function(Context(trial, PlanariseSettings(), {}))
    assert isinstance(wrench, Table)
    return wrench


@pytest.mark.parametrize("seat", [False, True])
def test_everything_uses_the_corrected_clock(tmp_path: Path, seat: bool) -> None:
    """Use of the plates, mass and drop-outs are those of the synchronous trial."""
    made = simulated("sit-to-stand", seat_plate=seat)
    right = planarised(tmp_path, made, 0.0, "sit-to-stand")
    clock = right.facts["clock"]
    assert clock == {"offset_s": 0.0, "peak_s": clock["peak_s"], "rivals_s": [], "why": None}
    for offset in (-1.5, 0.7) if seat else (-0.2, 1.5):
        assert_same(planarised(tmp_path, made, offset, "sit-to-stand"), right, offset)


def assert_same(late: Table, right: Table, offset: float) -> None:
    assert late.facts["clock"]["offset_s"] == pytest.approx(offset, abs=0.05)
    assert late.facts["clock"]["why"] is None
    assert late.facts["mass_kg"] == pytest.approx(right.facts["mass_kg"], abs=0.05)
    assert [each["use"] for each in late.facts["plates"]] == [each["use"] for each in right.facts["plates"]]
    assert {reason.code for reason in late.reasons} - {"plate-short"} == {reason.code for reason in right.reasons}
    residual = round((late.facts["clock"]["offset_s"] - offset) * RATE)
    both = late["plate_ok"] & np.roll(right["plate_ok"], residual)
    assert both.mean() > 1 - (abs(offset) + 0.2) / right["time"][-1]
    assert np.quantile(np.abs(late["Fy"] - np.roll(right["Fy"], residual))[both], 0.99) < 1e-3


@pytest.mark.parametrize("offset", [-1.1, 0.25])
def test_a_robot(tmp_path: Path, offset: float) -> None:
    wrench = planarised(tmp_path, simulated("robot"), offset, "robot-joint")
    assert wrench.facts["clock"]["offset_s"] == pytest.approx(offset, abs=0.05)


def search(height: np.ndarray, force: np.ndarray, travel: float = 0.0) -> ClockSearch:
    """Return the result for three markers, one at rest and two that move up and down, and a plate (T,)."""
    time = np.arange(len(height)) / RATE
    positions = np.tile([[0.0, 0.0, 0.0], [0.2, 0.0, 0.5], [0.0, 0.1, 1.0]], (len(time), 1, 1))
    positions[:, :, 0] += travel * time[:, None]
    positions[:, 1:, 2] += height[:, None]
    load = np.column_stack([np.zeros((len(force), 2)), force])
    plate = Plate(1, "type 2", None, load, 0.0 * load, np.ones(len(force), bool), RATE, 0.0)
    return find_clock_offset([plate], positions, time, RATE, frame_s=1.0 / RATE)


def load_of(height: np.ndarray) -> np.ndarray:
    return 40.0 * (2 * GRAVITY + np.gradient(np.gradient(height)) * RATE**2)


def test_a_movement_that_repeats_exactly_is_said() -> None:
    """Nothing shows which of the periods is the right one."""
    height = 0.1 * np.sin(2 * np.pi * np.arange(0, 20, 1 / RATE) / 1.6)
    for shift in (0, 80):
        found = search(height, np.roll(load_of(height), shift))
        assert found.why is not None
        assert "repeats" in found.why
        periods = np.diff(sorted([found.peak_s, *found.rivals_s]))
        np.testing.assert_allclose(periods, 1.6, atol=0.05)


def test_a_rest_shows_the_period() -> None:
    """The same movement between two rests, shifted by exactly one period."""
    time = np.arange(0, 20, 1 / RATE)
    height = np.where((time > 4) & (time < 16), 0.1 * (1 - np.cos(2 * np.pi * (time - 4) / 1.5)), 0.0)
    found = search(height, np.roll(load_of(height), 150))
    assert found.why is None
    assert found.offset_s == pytest.approx(-1.5, abs=0.03)


def test_forces_of_another_movement_are_said() -> None:
    rng = np.random.default_rng(4)
    one, other = (np.cumsum(np.cumsum(np.convolve(rng.normal(size=2000), np.hanning(60), "same"))) for _ in range(2))
    at = np.arange(2000)
    one, other = (0.3 * (each - np.polyval(np.polyfit(at, each, 5), at)) for each in (one, other))
    found = search(one / np.ptp(one), load_of(other / np.ptp(other)))
    assert found.offset_s == 0.0
    assert found.why is not None


def test_where_nothing_can_be_seen_nothing_is_said() -> None:
    """A person who stands still, or who walks over the plates."""
    time = np.arange(0, 10, 1 / RATE)
    noise = np.random.default_rng(1).normal(size=(2, len(time)))
    assert search(2e-4 * noise[0], 785.0 + noise[1]) == ClockSearch()
    height = 0.05 * np.sin(2 * np.pi * time)
    assert search(height, load_of(np.roll(height, 30)), travel=1.2) == ClockSearch()
