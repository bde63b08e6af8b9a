"""Keys of trials of curls: names of conditions, and the device's file."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mocap_id.config import load
from mocap_id.config.device import load_device
from mocap_id.errors import ConfigError

DEVICE = Path(__file__).parents[2] / "configs" / "devices" / "elbow.yaml"


def trial(folder: Path, curl: str) -> Path:
    shutil.copy(DEVICE, folder / "elbow.yaml")
    file = folder / "trial.yaml"
    file.write_text(
        f"trial: a\nspace: 3d\nprotocol: curl\nrecording: a.c3d\ncurl: {{device: elbow.yaml, {curl}}}\n", "utf-8"
    )
    return file


def test_a_number_names_a_condition(tmp_path: Path) -> None:
    curl = load(trial(tmp_path, "condition: 5")).keys.curl
    assert curl.condition == "5"
    assert curl.device is not None
    assert curl.device["sealed"]["flexion_Pa"] == 446063.0


def test_without_a_condition_the_state_is_that_of_the_file(tmp_path: Path) -> None:
    device = load(trial(tmp_path, "metronome_hz: 0.5")).keys.curl.device
    assert device is not None
    assert device["sealed"] == load_device(DEVICE).keys.sealed.model_dump(mode="json")


def test_a_condition_that_the_device_lacks_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no condition `6`"):
        load(trial(tmp_path, "condition: 6"))


def test_a_missing_device_is_an_error_with_its_line(tmp_path: Path) -> None:
    file = trial(tmp_path, "condition: C")
    (tmp_path / "elbow.yaml").unlink()
    with pytest.raises(ConfigError, match=r"trial.yaml, line 5: device: there is no file .*elbow.yaml"):
        load(file)


@pytest.mark.parametrize(
    ("load_", "said"),
    [
        ("{mass: 3.6, centre: [0, -75, 0]}", "at most 0.6 m in each direction, not -75"),
        ("{mass: 3.6, centre: [0, -0.075, 0], inertia: [90, 90, 90]}", "expected 0 to 1.3 kg·m²"),
    ],
)
def test_loads_in_wrong_units_are_errors(tmp_path: Path, load_: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load(trial(tmp_path, f"loads: {{dumbbell: {load_}}}"))
