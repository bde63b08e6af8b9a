"""Torques of a simulated person with a loose hip, identified with measured poses, compared with exact truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.config import load
from mocap_id.runner import run_to
from mocap_id.store import Folder
from mocap_id_simulation import Options, PersonOptions, simulate

OPTIONS = Options(seed=4, repetitions=3, rate=100.0, analog_rate=500.0, people=PersonOptions(hip_gap_mm=10))
JOINTS = (1, 2, 3)
BOUNDS = {"ankle": 1.1, "knee": 1.5, "hip": 2.4}
"""Limits of the rms error off the seat, N·m; measured: 0.61, 0.82 and 1.68."""

EXACT = dict.fromkeys(
    ("plate_gain_sd", "plate_moments_sd", "plate_position_sd_m", "camera_scale_sd", "camera_tilt_sd_deg"), 0
)
"""The simulated instruments have no error of calibration."""

Identified = tuple[dict[str, Any], np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Identified]:
    """Run the trial with some settings; return facts, errors and standard deviations (T, 3) off the seat."""
    folder = tmp_path_factory.mktemp("loose")
    trial = Path(simulate("sit-to-stand", folder, OPTIONS))
    return cache(lambda motion: identify(trial, motion))


def identify(trial: Path, motion: str = "chosen") -> Identified:
    """Run a simulated trial; return facts, errors and standard deviations (T, 3) off the seat."""
    folder, chosen = trial.parent, EXACT if motion == "chosen" else EXACT | {"motion": motion}
    truth, asked = json.loads((folder / "truth.json").read_text()), folder / f"{motion}.yaml"
    asked.write_text(f"{trial.read_text()}identify-dim: {json.dumps(chosen)}\nout: {folder / motion}\n")
    run = run_to(load(asked), "identify-dim").folder
    frame = pd.read_parquet(run / "dynamics.parquet")
    time = frame["time"].to_numpy()
    with np.load(folder / "truth.npz") as arrays:
        true = CubicSpline(arrays["t"], arrays["tau"])(time)
    error = frame[[f"tau_{j}" for j in JOINTS]].to_numpy() - true
    off = np.any([(time >= rep["seat_off"]) & (time <= rep["seat_on"]) for rep in truth["reps"]], axis=0)
    off &= np.isfinite(error).all(axis=1)
    sd = frame[[f"sd_tau_{j}" for j in JOINTS]].to_numpy()
    return dict(Folder(run).read("dynamics.h5").facts), error[off], sd[off]


def rms(values: np.ndarray) -> np.ndarray:
    """Return the rms of every column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


@pytest.mark.parametrize(("seed", "rate", "noise"), [(2000006, 100.0, 5e-4), (2000013, 50.0, 2e-3)])
def test_a_slow_stand_of_joints_that_hold_keeps_its_pins(tmp_path: Path, seed: int, rate: float, noise: float) -> None:
    """Camera noise and skin open no joint, and the torques are as far off as they say."""
    options = Options(seed=seed, repetitions=3, strategy="stable", rate=rate, analog_rate=10 * rate, marker_noise=noise)
    facts, error, sd = identify(Path(simulate("sit-to-stand", tmp_path, options)))
    assert facts["motion"]["source"] == "chain"
    assert all(gap["pinned"] for gap in facts["motion"]["joints"].values())
    assert (np.mean(np.abs(error) <= 1.96 * sd, axis=0) >= 0.85).all()
    if noise < 1e-3:
        assert (rms(error)[1:] < [1.1, 0.6]).all()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "gap"), [(1420001, 6), (1420003, 8)])
def test_a_hip_that_gives_way_a_little_is_open_although_the_forces_do_not_show_it(
    tmp_path: Path, seed: int, gap: float
) -> None:
    """On the pinned chain, the hip's intervals held 4 and 69 % of the samples."""
    options = Options(seed=seed, people=PersonOptions(hip_gap_mm=gap))
    facts, error, sd = identify(Path(simulate("sit-to-stand", tmp_path, options)))
    assert [name for name, each in facts["motion"]["joints"].items() if not each["pinned"]] == ["hip"]
    assert (np.mean(np.abs(error) <= 1.96 * sd, axis=0) >= 0.9).all()


def test_torques_off_the_seat_equal_the_simulators(identified: Callable[..., Identified]) -> None:
    facts, error, _ = identified("chosen")
    assert facts["motion"]["source"] == "segments"
    assert len(error) > 900
    found = dict(zip(BOUNDS, rms(error), strict=True))
    assert {joint: value for joint, value in found.items() if value > BOUNDS[joint]} == {}


def test_their_standard_deviations_cover_the_errors(identified: Callable[..., Identified]) -> None:
    _, error, sd = identified("chosen")
    assert (rms(error / sd) < 1.5).all()
    assert (rms(sd) < 3.0).all(), "and are no larger than a hip needs whose centre is known to a few millimetres"


def test_a_joint_that_gives_way_is_no_error_of_scale(identified: Callable[..., Identified]) -> None:
    """With five repetitions, a gain of Fy of 2 to 7 % would lower the residual of nearly all such people."""
    scales = identified("chosen")[0]["scales"]
    assert scales["suspects"] == []
    assert scales["causes"]["vertical gain"]["limit"] > 0.1, "people in whom nothing is wrong differ by as much"


def test_the_pinned_chain_is_worse_at_every_joint(identified: Callable[..., Identified]) -> None:
    """Measured for the same recording with the pinned chain: 6.9, 2.6 and 3.2 N·m."""
    facts, error, _ = identified("chain")
    assert facts["motion"]["source"] == "chain"
    assert (rms(error) > 1.5 * rms(identified("chosen")[1])).all()
    assert rms(error)[0] > 4.0
