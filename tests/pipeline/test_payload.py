"""The payload of a robot, from two whole trials by the command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mocap_id.errors import ConfigError
from mocap_id.workflows.transfer import PARAMETERS, find_payload
from mocap_id_cli.commands import build
from mocap_id_simulation import SpaceRobotOptions, simulate_space_robot


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The trials with and without a payload of 2 kg; the first takes its chain from the second."""
    place = tmp_path_factory.mktemp("payload")
    for name, payload in (("empty", 0.0), ("loaded", 2.0)):
        options = SpaceRobotOptions(seed=12, payload=payload, duration=20, rate=60, analog_rate=600)
        simulate_space_robot(place / name, options)
    loaded = place / "loaded" / "trial.yaml"
    loaded.write_text(loaded.read_text() + "calibration: ../empty/trial.yaml\n")
    return loaded, place / "empty" / "trial.yaml"


def moments_about_centre(parameters: np.ndarray) -> np.ndarray:
    """Principal moments of inertia about the centre of mass, which are the same in every frame."""
    m, first, (xx, yy, zz, xy, xz, yz) = parameters[0], parameters[1:4], parameters[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.linalg.eigvalsh(inertia - (first @ first * np.eye(3) - np.outer(first, first)) / m)


def test_the_command_gives_the_payload(trials: tuple[Path, Path]) -> None:
    done = CliRunner().invoke(build(), ["payload", *map(str, trials), "--json", "--quiet"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    value = np.array([found["parameters"][name]["value"] for name in PARAMETERS])
    sd = np.array([found["parameters"][name]["sd"] for name in PARAMETERS])
    truth = json.loads((trials[0].parent / "truth.json").read_text())["payload"]["parameters"]
    assert found["segment"] == "segment_2"
    assert abs(value[0] - truth[0]) < 3 * sd[0] < 0.1
    np.testing.assert_allclose(
        moments_about_centre(value), moments_about_centre(np.array(truth)), atol=5 * float(sd[4:].max())
    )
    text = CliRunner().invoke(build(), ["payload", *(str(path.parent / "runs" / path.parent.name) for path in trials)])
    assert "centre of mass" in text.stdout
    assert found["cautions"] == {"loaded": [], "empty": []}
    assert "caution" not in text.stdout
    assert f"{value[0]:.2f}" in text.stdout


def test_exchanged_trials_and_cautions_of_a_trial_are_reported(trials: tuple[Path, Path], tmp_path: Path) -> None:
    folders = [path.parent / "runs" / path.parent.name for path in trials]
    doubtful = tmp_path / "doubtful"
    shutil.copytree(folders[1], doubtful)
    summary = json.loads((doubtful / "summary.json").read_text())
    summary["verdict"]["reasons"].append({"code": "wrench-unexplained", "level": "caution"})
    (doubtful / "summary.json").write_text(json.dumps(summary))
    said = CliRunner().invoke(build(), ["payload", str(doubtful), str(folders[0])]).stdout
    assert "the mass is negative: probably the trials are exchanged" in said
    assert "cautions of empty: wrench-unexplained" in said


def test_what_cannot_be_subtracted_is_refused(trials: tuple[Path, Path], tmp_path: Path) -> None:
    loaded, empty = trials
    with pytest.raises(ConfigError, match="the segments are base, segment_1, segment_2"):
        find_payload(loaded, empty, "gripper")
    other = simulate_space_robot(tmp_path / "other", SpaceRobotOptions(seed=13, duration=10, rate=60, analog_rate=600))
    with pytest.raises(ConfigError, match=r"different chains.*`calibration:`"):
        find_payload(loaded, other)
    sample = Path(__file__).parents[2] / "sample_trials" / "robot-joint" / "trial.yaml"
    copied = tmp_path / "plane"
    copied.mkdir()
    for file in sample.parent.iterdir():
        if file.is_file():
            (copied / file.name).write_bytes(file.read_bytes())
    with pytest.raises(ConfigError, match="in the plane"):
        find_payload(copied / "trial.yaml", empty)
