"""Balance boards: reading, resampling and calibration of the log, and a whole trial."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.sensor_logs import calibrate_cells, read_board
from mocap_id.runner import run
from mocap_id.store import Folder
from mocap_id_simulation import Options, simulate

_HEAD = "time_s,tl_kg,tr_kg,bl_kg,br_kg\n"


def _write(path: Path, rows: np.ndarray[Any, Any]) -> Path:
    path.write_text(_HEAD + "\n".join(",".join(f"{value:.4f}" for value in row) for row in rows) + "\n")
    return path


def _loads(time: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.column_stack([15 + np.sin(2 * time + k) for k in range(4)])


def test_repeated_rounded_stamps_give_the_load_without_lag(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.008, 0.013, 2000))
    stamps = np.round(time / 0.01) * 0.01
    log = read_board(_write(tmp_path / "a.csv", np.column_stack([stamps, _loads(time)])))
    even = log.start + np.arange(len(log.force)) / log.rate
    error = log.force - 9.81 * _loads(even).sum(axis=1)
    assert log.ok.all() and abs(error.mean()) < 0.1 and error.std() < 0.3
    assert np.median(np.diff(even)) == pytest.approx(0.005)


def test_moments_are_those_of_the_cells(tmp_path: Path) -> None:
    time = np.arange(100) * 0.01
    rows = np.column_stack([time, np.tile([10.0, 20.0, 0.0, 10.0], (100, 1))])
    log = read_board(_write(tmp_path / "a.csv", rows))
    np.testing.assert_allclose(log.force, 9.81 * 40)
    np.testing.assert_allclose(log.moment[:, 0] / log.force, 0.433 / 2 * (30 - 10) / 40)
    np.testing.assert_allclose(log.moment[:, 1] / log.force, 0.238 / 2 * (30 - 10) / 40)


@pytest.mark.parametrize("reading", [0.0, 12.3])
def test_a_dead_cell_makes_the_board_unusable_and_is_named(tmp_path: Path, reading: float) -> None:
    time = np.arange(1000) * 0.01
    cells = 15 + 8 * np.sin(2 * time[:, None] + np.arange(4))
    rng = np.random.default_rng(3)
    assert read_board(_write(tmp_path / "a.csv", np.column_stack([time, cells]))).problem == ""
    cells[:, 2] = reading + 0.05 * rng.normal(size=len(time))
    problem = read_board(_write(tmp_path / "b.csv", np.column_stack([time, cells]))).problem
    assert "`bl_kg`" in problem and "`tl_kg`" not in problem


def test_a_long_pause_is_unknown_and_a_short_one_is_bridged(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(100) * 0.01, 1.1 + np.arange(100) * 0.01, 2.6 + np.arange(100) * 0.01])
    log = read_board(_write(tmp_path / "a.csv", np.column_stack([time, _loads(time)])))
    even = log.start + np.arange(len(log.force)) / log.rate
    assert log.gaps == 1
    assert not log.ok[(even > 2.11) & (even < 2.58)].any() and log.ok[even < 2.0].all()


def test_known_loads_give_zeros_and_gains() -> None:
    rng = np.random.default_rng(2)
    gain, zero = np.array([1.01, 0.99, 1.005, 0.995]), np.array([0.2, -0.1, 0.0, 0.3])
    load = np.concatenate([np.zeros((2, 4)), 20 * np.eye(4), 5 + 30 * rng.random((4, 4))])
    found = calibrate_cells(np.column_stack([load.sum(axis=1), load / gain + zero]))
    np.testing.assert_allclose(found[0], gain, atol=1e-3)
    np.testing.assert_allclose(found[1], zero, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows[:5], "at least"),
        (lambda rows: rows[::-1], "does not increase"),
        (lambda rows: rows * [1, 1000, 1, 1, 1], "not raw counts"),
    ],
)
def test_unusable_logs_are_refused(tmp_path: Path, change: Any, words: str) -> None:
    time = np.arange(100) * 0.01
    path = _write(tmp_path / "a.csv", change(np.column_stack([time, _loads(time)])))
    with pytest.raises(RecordingError, match=words):
        read_board(path)


def test_other_columns_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,load\n" + "0,1\n" * 30)
    with pytest.raises(RecordingError, match="tl_kg"):
        read_board(path)


def test_a_wrong_key_is_an_error_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "trial.yaml"
    file.write_text("trial: a\nrecording: {markers: a.c3d, forces: {balance_board: b.csv, top: up}}\n")
    with pytest.raises(ConfigError, match=r"line 2.*top"):
        load(file)


@pytest.fixture(scope="module")
def on_a_board(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("board") / "trial"
    options = Options(seed=320_001, repetitions=2, analog_rate=100, board=True, clock_offset=0.06)
    configuration = simulate("sit-to-stand", folder, options)
    return configuration, run(load(configuration)).folder


def test_a_whole_trial_on_a_board(on_a_board: tuple[Path, Path]) -> None:
    configuration, out = on_a_board
    truth = json.loads(configuration.with_name("truth.json").read_text())
    summary = json.loads((out / "summary.json").read_text())
    dynamics, wrench = (Folder(out).read(f"{name}.parquet") for name in ("dynamics", "wrench"))
    with np.load(configuration.with_name("truth.npz")) as arrays:
        true = np.interp(dynamics["time"], arrays["t"], arrays["cop_x"])
    fit = dynamics["in_fit"]
    away = (dynamics["cop_x_model"] - true)[fit]
    assert np.isnan(wrench["Fx"]).all() and np.isnan(dynamics["Fx"]).all() and np.isfinite(dynamics["Fx_model"]).any()
    assert abs(summary["dynamics"]["clock_offset_s"] - truth["board"]["clock_offset"]) < 0.005
    assert np.std(away) < 0.004 and abs(np.mean(away)) < 0.008
    assert np.mean(np.abs(away) < 1.96 * dynamics["sd_cop_x_model"][fit]) > 0.8
    assert summary["dynamics"]["base"][0]["value"] == pytest.approx(truth["total_mass"], rel=0.02)
    assert wrench.facts["board"]["top"] == truth["board"]["top"]
    assert summary["dynamics"]["wrench"]["Fx"]["sd"] is None


def test_a_board_that_lies_the_other_way_is_doubted(on_a_board: tuple[Path, Path]) -> None:
    configuration, _ = on_a_board
    truth = json.loads(configuration.with_name("truth.json").read_text())
    opposite = {"forwards": "backwards", "backwards": "forwards", "left": "right", "right": "left"}
    text = configuration.read_text().replace("board.csv", f"board.csv, top: {opposite[truth['board']['top']]}")
    other = configuration.with_name("other.yaml")
    other.write_text(text + "out: other\n")
    summary = json.loads((run(load(other)).folder / "summary.json").read_text())
    assert "board-direction-unsure" in [reason["code"] for reason in summary["verdict"]["reasons"]]
