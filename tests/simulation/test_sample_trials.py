"""The committed sample trials equal the output of the commands in their README."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from mocap_id.recording import read

SAMPLES = Path(__file__).resolve().parents[2] / "sample_trials"
COMMANDS = re.findall(r"^mocap-id (simulate .*)$", (SAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_they_are_small():
    assert sum(path.stat().st_size for path in SAMPLES.rglob("tr*.*") if "runs" not in path.parts) < 6e6


def test_every_sample_has_its_command():
    made = {Path(shlex.split(command)[2]).name for command in COMMANDS}
    assert made == {path.parent.name for path in SAMPLES.glob("*/trial.c3d")}


@pytest.mark.parametrize("command", COMMANDS)
def test_the_command_makes_the_sample(cli, tmp_path, command):
    kind, folder, *options = shlex.split(command)[1:]
    sample, again = SAMPLES.parent / folder, tmp_path / Path(folder).name
    assert cli("simulate", kind, again, *options).code == 0
    assert (again / "trial.yaml").read_text() == (sample / "trial.yaml").read_text()
    ours, theirs = (json.loads((path / "truth.json").read_text()) for path in (again, sample))
    assert ours.keys() == theirs.keys()
    assert ours["assignment"] == theirs["assignment"]
    first, second = read(again / "trial.c3d"), read(sample / "trial.c3d")
    np.testing.assert_allclose(first.positions, second.positions, atol=1e-5)
    if kind == "arm":  # the samples in space have no truth.npz and no plate
        assert {path.name for path in sample.iterdir()} - {"runs"} == {path.name for path in again.iterdir()} - {
            "truth.npz"
        }
        return
    np.testing.assert_allclose(ours["base_parameters"]["values"], theirs["base_parameters"]["values"], rtol=1e-9)
    with np.load(again / "truth.npz") as exact, np.load(sample / "truth.npz") as kept:
        for name in kept.files:
            np.testing.assert_allclose(exact[name], kept[name], rtol=1e-4, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(first.plates[0].force, second.plates[0].force, atol=1e-2)
