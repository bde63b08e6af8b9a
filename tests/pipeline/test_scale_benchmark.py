"""benchmarks/scale.py at tiny sizes, and its tables."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.recording import read

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim", "report")


@pytest.fixture(scope="module")
def modules():
    """The modules of the benchmark, which import each other by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        names = ("scale", "scale_parts")
        yield {name: importlib.import_module(name) for name in names}


def part(sizes: list[int], power: float) -> list[dict[str, Any]]:
    """Results with times as a power of the number of frames, and memory on a line."""
    found = []
    for frames in sizes:
        seconds = 1e-4 * frames**power
        stage = {"wall": seconds, "cpu": seconds, "computing": seconds, "peak": 300.0, "growth": 10.0}
        peak = 400.0 + 40.0 * frames * 50 / 1e6
        found.append(
            {
                "wanted": {"frames": frames, "rate": 100.0, "analog": 1000.0, "markers": 50, "joints": None},
                "stages": dict.fromkeys(STAGES, stage),
                "whole": {"wall": seconds, "cpu": seconds, "peak": peak},
                "floor": {"numpy": 0.1, "parquet": 0.1, "hdf5": 0.1},
                "segments": 4,
                "verdict": "ok",
            }
        )
    return found


@pytest.mark.parametrize(("power", "held"), [(1.0, True), (1.3, False)])
def test_powers_and_memory_are_found_and_compared_with_the_limits(modules, power: float, held: bool) -> None:
    frames = part([3_000, 12_000, 60_000, 120_000], power)
    grown = modules["scale"].fit_time(frames, "frames", "report")
    assert grown.all == pytest.approx(power)
    assert grown.larger == pytest.approx(power)
    assert modules["scale"].fit_memory(frames) == pytest.approx((40.0, 400.0, 0.0), abs=1e-6)
    found = {"frames": {"found": frames, "seconds": 60.0, "load": [0.1, 1.0], "cores": 2}}
    text = "\n".join(modules["scale"].make_sections(found).values())
    assert "400 MB + 40.0 MB per million" in text
    assert ("not met" in text) != held
    assert text.count("Not measured in this run.") == 7
    found["frames"]["load"] = [3.0, 3.0]
    assert "no time here is reliable" not in text
    assert "no time here is reliable" in modules["scale"].describe_machine(found)


def test_a_recording_has_the_frames_markers_and_joints_that_are_wanted(modules, tmp_path) -> None:
    made = modules["scale_parts"]
    for wanted in (
        made.Wanted(5_000, markers=20),
        made.Wanted(700, markers=80, rate=120.0, analog=240.0),
        made.Wanted(400, joints=5),
    ):
        recording = read(made.make(wanted, tmp_path).with_suffix(".c3d"))
        assert recording.positions.shape == (wanted.frames, wanted.markers, 3)
        assert recording.rate == pytest.approx(wanted.rate)


def test_backwards_frames_and_samples_stay_together(modules) -> None:
    """Sample k of a frame has the same delay when the trial is played backwards."""
    to_and_fro, per_frame = modules["scale_parts"].count_to_and_fro, 4
    frames, samples = to_and_fro(10, 40), to_and_fro(9 * per_frame + 1, 40 * per_frame)
    np.testing.assert_array_equal(samples[::per_frame], per_frame * frames)
    assert set(np.abs(np.diff(samples))) == {1}


def test_memory_is_that_of_the_measured_process(modules, tmp_path) -> None:
    processes = modules["scale_parts"]
    small, large = processes.spend_together(
        [[sys.executable, "-c", "pass"], [sys.executable, "-c", "x = b'1' * 200_000_000"]], tmp_path
    )
    assert small.peak < 60
    assert 200 < large.peak < 260
    with pytest.raises(RuntimeError, match="ended with 3"):
        processes.spend([sys.executable, "-c", "raise SystemExit(3)"], tmp_path)


@pytest.mark.slow
def test_one_part_of_it_at_tiny_sizes(tmp_path) -> None:
    command = [sys.executable, str(BENCHMARKS / "scale.py"), "--small", "--only", "markers", "--work", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "| 20 |" in done.stdout
    assert all(f"| {name} |" in done.stdout for name in STAGES)
