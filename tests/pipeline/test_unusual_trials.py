"""Simulated trials with unusual rises, compared with the options of the simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mocap_id.config import load
from mocap_id.protocols.repetitions import compute_posture
from mocap_id.protocols.sit_to_stand import find_sit_to_stand_repetitions
from mocap_id.runner import run
from mocap_id_simulation import Options, simulate

REPETITIONS = 3


def done(folder: Path, *, after: float | None = None, **options: Any) -> tuple[pd.DataFrame, dict[str, Any], Any]:
    """Return events, summary and truth of a new trial; ``after`` removes everything before this time after seat-off."""
    file = simulate("sit-to-stand", folder, Options(repetitions=REPETITIONS, **options))
    truth = json.loads((folder / "truth.json").read_text())
    if after is not None:
        window = [round(truth["seat_off_s"][0] + after, 2), round(truth["reps"][-1]["sit_end"] + 0.5, 2)]
        file.write_text(f"{file.read_text()}window: {window}\n")
    outcome = run(load(file))
    return pd.read_parquet(outcome.folder / "events.parquet"), dict(outcome.summary()), truth


def codes(summary: dict[str, Any]) -> set[str]:
    verdict = summary["verdict"]
    return {reason["code"] for reason in (*verdict["reasons"], *verdict["notes"])}


UNUSUAL = {"attempt-failed", "rise-partial", "rise-paused", "support-unexplained", "repetition-cut"}


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["normal", "dynamic", "stable"])
def test_aborted_rises_are_counted_as_attempts(tmp_path: Path, strategy: str) -> None:
    events, summary, truth = done(tmp_path / "trial", seed=5301001, strategy=strategy, attempts=2)
    assert len(events) == REPETITIONS
    assert events["attempts"].tolist() == [0, 1, 1]
    assert [one["time_s"] for one in summary["attempts"]] == pytest.approx(
        [one["top"] for one in truth["attempts"]], abs=0.3
    )
    assert codes(summary) & UNUSUAL == {"attempt-failed"}
    np.testing.assert_allclose(events["seat_off"], truth["seat_off_s"], atol=0.06)


def test_a_stop_in_mid_rise_is_reported(tmp_path: Path) -> None:
    events, summary, truth = done(tmp_path / "trial", seed=5301002, hold=1.0)
    assert events["held"].tolist() == [0.0, 0.0, pytest.approx(1.0, abs=0.4)]
    assert codes(summary) & UNUSUAL == {"rise-paused"}
    assert "paused" in events["why"].iloc[2]
    assert events["complete"].all()
    assert events["stand"].iloc[2] == pytest.approx(truth["reps"][2]["rise_end"], abs=0.4)


def test_a_hand_on_a_rail_is_reported(tmp_path: Path) -> None:
    events, summary, _ = done(tmp_path / "trial", seed=5301003, rail=0.12)
    assert codes(summary) & UNUSUAL == {"support-unexplained"}
    assert events["support"].between(0.05, 0.2).all()
    dynamics = pd.read_parquet(tmp_path / "trial" / "runs" / summary["trial"] / "dynamics.parquet")
    for start, stand in zip(events["start"], events["stand"], strict=True):
        rising = dynamics["time"].between(start, stand)
        assert dynamics["contact"][rising].all()
        assert dynamics.loc[rising, ["tau_1", "tau_2", "tau_3", "sd_tau_3"]].isna().all(axis=None)


@pytest.mark.parametrize(
    ("seed", "options"),
    [
        (7401, {}),
        *(pytest.param(seed, options, marks=pytest.mark.slow) for seed, options in (
            (7403, {"strategy": "stable"}), (882, {"rate": 50.0, "marker_noise": 0.001}), (883, {"soft_tissue": 2.0}),
            (882, {"rate": 50.0, "marker_noise": 0.002}),
        )),
    ],
)  # fmt: skip
def test_the_five_times_test_is_within_its_standard_deviation(
    tmp_path: Path, seed: int, options: dict[str, Any]
) -> None:
    """The truth is what the exact motion gives by the same rules, and the instant at which the chair is touched."""
    folder = tmp_path / "trial"
    outcome = run(load(simulate("sit-to-stand", folder, Options(repetitions=5, seed=seed, **options))))
    truth, found = json.loads((folder / "truth.json").read_text()), outcome.summary()["five_times"]
    centres = np.array([joint["centre_m"] for joint in outcome.summary()["joints"]])
    with np.load(folder / "truth.npz") as exact:
        time = np.arange(exact["t"][0], exact["t"][-1], 1e-3)
        q, dq = (np.column_stack([np.interp(time, exact["t"], each) for each in exact[key].T]) for key in ("q", "qd"))
    rises = find_sit_to_stand_repetitions(time, compute_posture(q, dq, centres), None, chair=True)
    right = {"stand": rises[4].stand, "seat_contact": truth["seat_on_s"][4], "seated": rises[4].end}
    for stop, instant in right.items():
        sd = found[f"to_fifth_{stop}_sd_s"]
        assert abs(found[f"to_fifth_{stop}_s"] - (instant - rises[0].start)) < 1.96 * sd, stop
        assert sd < 0.1


def test_a_recording_that_starts_in_mid_rise_keeps_the_rest(tmp_path: Path) -> None:
    events, summary, truth = done(tmp_path / "trial", seed=5301004, after=0.45)
    assert len(events) == REPETITIONS
    assert np.isnan(events["start"].iloc[0])
    assert events["complete"].tolist() == [False, True, True]
    assert "the recording begins during the rise" in events["why"].iloc[0]
    assert codes(summary) & UNUSUAL == {"repetition-cut"}
    np.testing.assert_allclose(events["seat_off"].iloc[1:], truth["seat_off_s"][1:], atol=0.06)
