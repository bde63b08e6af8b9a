"""Where a joint angle is zero: a static pose, the standing phases, or the segment lines, and the report says which."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording import read, write_trc
from mocap_id.runner import Outcome, run

SAMPLE = Path(__file__).parents[2] / "sample_trials" / "sit-to-stand" / "trial.c3d"


def start(folder: Path, **keys: Any) -> Outcome:
    folder.mkdir(exist_ok=True)
    file = folder / "trial.yaml"
    file.write_text(json.dumps({"trial": "one", "recording": str(SAMPLE), "protocol": "sit-to-stand", **keys}))
    return run(load(file))


def zeros(done: Outcome) -> dict[str, tuple[str, float, float]]:
    return {one["name"]: (one["zero"], one["zero_deg"], one["zero_sd_deg"]) for one in done.summary()["joints"]}


def codes(done: Outcome) -> list[str]:
    return [reason["code"] for reason in done.summary()["verdict"]["reasons"]]


def standing(done: Outcome) -> np.ndarray:
    """Return each joint angle of states.parquet while the person stands, degrees: just after every rise."""
    states, events = (pd.read_parquet(done.folder / f"{name}.parquet") for name in ("states", "events"))
    rows = [states[(states["time"] >= at) & (states["time"] < at + 0.2)] for at in events["stand"].dropna()]
    angles = [[row[f"theta_{j}"].mean() for j in range(1, len(done.summary()["joints"]) + 1)] for row in rows]
    return np.degrees(np.mean(angles, axis=0))


@pytest.fixture(scope="module")
def plain(once: Callable[..., Any]) -> Outcome:
    done: Outcome = once("zeros-plain", start)
    return done


def test_without_static_the_standing_phases_are_zero(plain: Outcome) -> None:
    found = zeros(plain)
    assert {source for source, _, _ in found.values()} == {"standing"}
    assert np.abs(standing(plain) - [value for _, value, _ in found.values()]).max() < 1.5
    assert all(0 < sd < 5 for _, _, sd in found.values())
    phases = pd.read_parquet(plain.folder / "phases.parquet")
    for j, (_, value, _) in enumerate(found.values(), start=1):
        raw, shown = (phases[phases["quantity"] == f"{name}_{j}"]["mean"].to_numpy() for name in ("theta", "angle"))
        np.testing.assert_allclose(np.degrees(raw - shown), value, atol=1e-9)
    page = (plain.folder / "report.html").read_text("utf-8")
    assert "angle from standing (deg)" in page
    assert "zero in the mean of the standing phases" in page


def test_a_free_movement_says_that_its_zero_is_arbitrary(tmp_path: Path) -> None:
    done = start(tmp_path, protocol="free")
    assert set(zeros(done).values()) == {("segment line", 0.0, 0.0)}
    page = (done.folder / "report.html").read_text("utf-8")
    assert "angle, segment line (deg)" in page
    assert "this zero is arbitrary" in page


def test_the_times_under_static_are_zero(tmp_path: Path, plain: Outcome) -> None:
    stand = float(pd.read_parquet(plain.folder / "events.parquet")["stand"].iloc[0])
    done = start(tmp_path, static=[stand, stand + 0.2])
    states = pd.read_parquet(done.folder / "states.parquet")
    inside = states[(states["time"] >= stand) & (states["time"] <= stand + 0.2)]
    for j, (source, value, _) in enumerate(zeros(done).values(), start=1):
        assert source == "static"
        assert value == pytest.approx(np.degrees(inside[f"theta_{j}"].mean()), abs=1e-6)
    assert "static-moves" not in codes(done)


def test_a_pose_that_moves_is_told_and_times_outside_are_an_error(tmp_path: Path) -> None:
    assert "static-moves" in codes(start(tmp_path, static=[0.0, 4.0]))
    with pytest.raises(RecordingError, match="static: no motion is known from 90 to 91 s"):
        start(tmp_path, static=[90.0, 91.0])


def test_a_static_trial_of_the_same_markers_is_zero_wherever_it_looks(tmp_path: Path, plain: Outcome) -> None:
    source, stand = read(SAMPLE), float(pd.read_parquet(plain.folder / "events.parquet")["stand"].iloc[0])
    pose = source.positions[np.argmin(np.abs(source.time - stand - 0.1))]
    turn = np.array([[np.cos(2.0), -np.sin(2.0), 0.0], [np.sin(2.0), np.cos(2.0), 0.0], [0.0, 0.0, 1.0]])
    (tmp_path / "still.yaml").write_text(json.dumps({"trial": "still", "recording": "still.trc"}))

    def record(points: np.ndarray) -> None:
        write_trc(tmp_path / "still.trc", source.labels, np.repeat(points[None], 60, axis=0), 100.0)

    record(pose @ turn.T + [1.0, -2.0, 0.0])
    done = start(tmp_path, static={"trial": "still.yaml"})
    assert {source for source, _, _ in zeros(done).values()} == {"static"}
    found = np.array([value for _, value, _ in zeros(done).values()])
    assert np.abs(found - standing(plain)).max() < 2.5
    record(1.15 * pose)
    with pytest.raises(RecordingError, match="static trial of the same person"):
        start(tmp_path, static={"trial": "still.yaml"})


def test_states_without_standard_deviations_have_a_zero_without_one(tmp_path: Path) -> None:
    done = start(tmp_path, **{"ukf-smooth": {"method": "butterworth"}})
    assert {(source, sd) for source, _, sd in zeros(done).values()} == {("standing", None)}
    assert all("no standard deviations" in one["why"] for one in done.summary()["joints"])


@pytest.mark.parametrize(
    ("static", "message"),
    [
        ([2.0, 1.0], "the first time must come before the last"),
        ([1.0, "a"], "`static\\[1\\]` is 'a', expected a number"),
        ({"trial": "none.yaml"}, "there is no file"),
        ({"file": "still.yaml"}, "expected the first and last time of a still pose"),
        ({"trial": "trial.yaml"}, "is this trial"),
    ],
)
def test_a_wrong_static_is_one_line(tmp_path: Path, static: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        start(tmp_path, static=static)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.recordings
def test_the_standing_hip_is_the_same_whatever_markers_are_used(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "sit-to-stand"
    (tmp_path / "still.yaml").write_text(json.dumps({"trial": "still", "recording": str(folder / "static1.trc")}))
    markers = {"markers": str(folder / "squats1.trc"), "forces": str(folder / "squats1_grf.mot")}
    raw, shown = [], []
    for segment in ({"ignore": ["*houlder*", "*C7*"]}, {"ignore": ["*SIS"]}, {}):
        done = start(tmp_path, recording=markers, static={"trial": "still.yaml"}, segment={"count": 4, **segment})
        zero = zeros(done)["hip"]
        assert zero[0] == "static"
        raw.append(standing(done)[2])
        shown.append(raw[-1] - zero[1])
    assert np.ptp(raw) > 5.0
    assert np.ptp(shown) < 2.0
