"""``mocap-id sensitivity`` end to end: its output, unchanged inputs, and messages for bad input."""

from __future__ import annotations

import hashlib
import html
import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest

from mocap_id.config import load
from mocap_id.runner import run_to
from mocap_id.workflows.figures import write_figures
from mocap_id.workflows.sensitivity.study import TABLES
from mocap_id_simulation import Options, simulate
from swinging_link import pendulum

SETTINGS = """seed: 3
perturbations:
  - kind: wrench-noise
    levels: [1.0]
  - kind: marker-count
    levels: [3]
  - kind: filter-noise
    on: [0.001]
    levels: [1000]
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A computed trial of a robot."""
    folder = tmp_path_factory.mktemp("computed")
    file = simulate("robot", folder, Options(seed=43, repetitions=2, analog_rate=200))
    run_to(load(file), "identify-dim")
    return file


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file except locks and the log, to which every run appends."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in ("lock", "run.log")]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(files)}


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    """A settings file."""
    file = tmp_path / "asked.yaml"
    file.write_text(SETTINGS)
    return file


@pytest.mark.slow
def test_the_same_bytes_however_many_processes_and_wherever_from(
    cli: Callable, robot: Path, settings: Path, tmp_path: Path
) -> None:
    (run_folder,) = (robot.parent / "runs").iterdir()
    before = contents(run_folder)
    one = cli("sensitivity", robot, "--settings", settings, "-j", 1, "--out", tmp_path / "one")
    two = cli("sensitivity", run_folder, "--settings", settings, "-j", 2, "--out", tmp_path / "two", "--json")
    assert (one.code, two.code) == (0, 0)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert contents(run_folder) == before
    assert "5/5" in one.err
    written = json.loads((tmp_path / "two" / "sensitivity.json").read_text())
    assert json.loads(two.out) == written
    assert "wrench noise, Fx: up to 1 N, all levels that were tried" in one.out
    _look_at_the_files(tmp_path / "one", written)


def _look_at_the_files(folder: Path, written: dict) -> None:
    """Check that tables, figure and page agree."""
    frames = {name: pd.read_parquet(folder / f"{name}.parquet") for name in TABLES}
    assert len(frames["perturbations"]) == len(written["perturbations"]) == 5
    assert len(frames["responses"]) == 5 * len(written["parameters"])
    for name in TABLES:
        assert list(pd.read_csv(folder / f"{name}.csv").columns) == list(frames[name].columns)
        assert b"meaning" in pq.read_schema(folder / f"{name}.parquet").field(0).metadata
    page = html.unescape((folder / "sensitivity.html").read_text())
    assert 'data-figure="tornado"' in page
    assert all(row["sentence"][1:20] in page for row in written["tolerates"])
    assert [file.name for file in write_figures(folder)] == ["captions.md", "tornado.svg", "tornado.pdf"]
    assert set(written["files"]) == {path.name for path in folder.iterdir() if path.is_file()} - {"sensitivity.json"}


def test_without_a_plate_only_what_moves_is_compared(cli: Callable, trial) -> None:
    file = trial.trc(pendulum())
    said = cli("sensitivity", file, "--only", "camera-noise", "--only", "wrench-bias", "-j", 1)
    assert said.code == 0
    assert "note: there is no force plate: only lengths and states are compared; left out, because" in said.out
    rows = pd.read_parquet(trial.folder / "runs" / "pendulum-sensitivity" / "perturbations.parquet")
    assert set(rows["kind"]) == {"camera-noise"}
    assert rows["theta_rms"].gt(0).all()
    assert rows["condition_number"].isna().all()
    nothing = cli("sensitivity", file, "--only", "wrench-bias")
    assert nothing.code == 2
    assert "has no force plate" in nothing.err


def test_a_refused_trial_is_refused(cli: Callable, trial) -> None:
    said = cli("sensitivity", trial.trc(pendulum(swing_deg=0.2)))
    assert said.code == 4
    assert not (trial.folder / "runs" / "pendulum-sensitivity").exists()


def test_bad_input_is_told_and_nothing_written(cli: Callable, robot: Path, tmp_path: Path) -> None:
    (run_folder,) = (robot.parent / "runs").iterdir()
    cases = [
        (("--only", "clok-offset"), "did you mean `clock-offset`?"),
        (("--settings", tmp_path / "nowhere.yaml"), "no such file"),
        (("--out", run_folder), "the trial's own run folder"),
    ]
    for options, words in cases:
        said = cli("sensitivity", robot, "--quiet", *options)
        assert said.code == 2
        assert words in said.err
    assert cli("sensitivity", tmp_path).code == 6  # not a run folder
    assert not list(tmp_path.iterdir())
