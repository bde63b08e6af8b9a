"""Whole trials in space: simulated arms and chains against their truth, calibration, and the wrong space."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.runner import Outcome, run
from mocap_id.store import Folder
from mocap_id_simulation import ArmOptions, ChainOptions, Options, simulate, write_arm, write_chain

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SHORT = {"cycles": 1, "severity": 0.2}


@pytest.fixture(scope="module")
def space():
    """The benchmark as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("space")


def summary_of(outcome: Outcome) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((outcome.folder / "summary.json").read_text("utf-8"))
    return summary


def compare(space, configuration: Path):
    return space.compare(space.harness.Run(configuration, load(configuration)))


@pytest.fixture(scope="session")
def arm(once: Callable[[str, Callable[[Path], Any]], Any]) -> tuple[Path, Path]:
    """The configuration and the run folder of a simulated right arm."""

    def make(folder: Path) -> tuple[Path, Path]:
        configuration = write_arm(folder / "arm", ArmOptions(seed=301_001, subject=301, **SHORT))
        return configuration, run(load(configuration)).folder

    found: tuple[Path, Path] = once("arm-in-space", make)
    return found


def test_an_arm_is_recovered_with_the_angles_of_the_isb(space, arm: tuple[Path, Path]) -> None:
    found = compare(space, arm[0])
    assert found.right
    assert found.kinds
    assert found.confidence > 0.5
    limits = space.ROWS["arm, default"].limits
    too_large = {name: value for name, value in found.errors.items() if not value <= 1.5 * limits[name]}
    assert not too_large
    assert all(share > 0.8 for share in found.inside.values())


def test_the_reach_of_an_arm_is_measured(arm: tuple[Path, Path]) -> None:
    configuration, folder = arm
    truth = json.loads((configuration.parent / "truth.json").read_text())
    found = json.loads((folder / "summary.json").read_text())["workspace"]
    assert found["volume_m3"] == pytest.approx(truth["reach"]["volume_m3"], rel=0.1)
    assert found["interval_m3"][0] < truth["reach"]["volume_m3"] < found["interval_m3"][1]
    assert found["visited"]["volume_m3"] < 0.5 * found["volume_m3"]
    low, high = np.degrees(truth["ranges_rad"]["elevation"])
    assert found["box_deg"]["elevation"] == pytest.approx([low, high], abs=3)
    assert found["ranges"]["shoulder_elevation"]["range_deg"] == pytest.approx(high - low, abs=3)
    assert 0 < found["surface"]["visited"]["total"] < found["surface"]["box"]["total"] <= 1
    events = Folder(folder).table("events.parquet")
    wanted = [one for one in truth["tasks"] if one["name"] != "rest"]
    tops, targets = events["top"], events["target"].tolist()
    assert len(tops) == len(wanted)
    assert all(abs(top - one["reach"]) < 0.7 for top, one in zip(tops, wanted, strict=True))
    names = {"shoulder_right": "same_shoulder", "shoulder_left": "opposite_shoulder"}
    assert sum(names.get(one["name"], one["name"]) == target for one, target in zip(wanted, targets, strict=True)) >= 4


def test_a_left_arm_has_the_angles_of_a_right_one(space, tmp_path: Path) -> None:
    configuration = write_arm(tmp_path / "left", ArmOptions(seed=301_002, side="left", **SHORT))
    outcome = run(load(configuration))
    found = compare(space, configuration)
    assert found.right
    limits = space.ROWS["arm, default"].limits
    assert not {name: value for name, value in found.errors.items() if not value <= 1.5 * limits[name]}
    assert "elbow-backwards" not in codes_of(outcome)


def test_a_left_arm_that_is_taken_for_a_right_one_bends_backwards(tmp_path: Path) -> None:
    configuration = write_arm(tmp_path / "left", ArmOptions(seed=301_002, side="left", **SHORT))
    text = configuration.read_text("utf-8")
    assert "side: left" in text
    configuration.write_text(text.replace("side: left", "side: right"), "utf-8")
    assert "elbow-backwards" in codes_of(run(load(configuration)))


def codes_of(outcome: Outcome) -> set[str]:
    return {reason["code"] for reason in summary_of(outcome)["verdict"]["reasons"]}


def test_a_chain_without_names_is_recovered(space, tmp_path: Path) -> None:
    configuration = write_chain(tmp_path / "chain", ChainOptions(seed=301_003, kinds="SH"))
    outcome = run(load(configuration))
    found = compare(space, configuration)
    assert found.right
    assert found.kinds
    assert found.errors["centres, mm"] < 1
    assert summary_of(outcome)["segments"]["names"] == ["base", "segment_1", "segment_2"]


def test_curls_take_the_shoulder_from_their_calibration(space, arm: tuple[Path, Path], tmp_path: Path) -> None:
    curls = ArmOptions(seed=301_004, subject=301, movement="curl", repetitions=2)
    configuration = write_arm(tmp_path / "curl", curls)
    alone = summary_of(run(load(configuration)))
    codes = {reason["code"] for reason in alone["verdict"]["reasons"]}
    assert codes & {"centre-unknown", "segments-unsure", "no-isb-frame"}
    text = configuration.read_text("utf-8")
    configuration.write_text(f"{text}calibration: {arm[0]}\nout: {tmp_path / 'calibrated'}\n", "utf-8")
    outcome = run(load(configuration))
    found = compare(space, configuration)
    assert found.right
    assert found.errors["GH centre, mm"] < 8
    assert found.errors["shoulder_elevation, °"] < 3
    assert summary_of(outcome)["verdict"]["level"] != "refused"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("landmarks: {IJ: Sternum}\n", "needs `space: 3d`"),
        ("protocol: reach\n", "needs `space: 3d`"),
        ("space: 3d\nprotocol: sit-to-stand\n", "needs `space: plane`"),
        ("space: 3d\nplanarise: {facing: +x}\n", "exists only with `space: plane`"),
        ("space: 3d\nfit-joints: {estimator: circle}\n", "exists only with `space: plane`"),
        ("fit-joints: {estimator: score}\n", "exists only with `space: 3d`"),
        ("space: 3d\ncalibration: missing.yaml\n", "there is no file"),
    ],
)
def test_settings_of_the_other_space_are_named_with_their_line(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "trial.yaml"
    file.write_text(f"trial: a\nrecording: a.c3d\n{text}", "utf-8")
    with pytest.raises(ConfigError, match="line ") as found:
        load(file)
    assert expected in str(found.value)


def test_a_movement_in_space_is_refused_in_the_plane(arm: tuple[Path, Path], tmp_path: Path) -> None:
    recording = arm[0].with_name("trial.c3d")
    file = tmp_path / "trial.yaml"
    file.write_text(f"trial: a\nrecording: {recording}\n", "utf-8")
    summary = summary_of(run(load(file)))
    assert summary["verdict"]["level"] == "refused"
    assert "`space: 3d`" in " ".join(reason["message"] for reason in summary["verdict"]["reasons"])


@pytest.mark.parametrize("command", [("sensitivity", "--only", "camera-noise"), ("advise",)], ids=lambda one: one[0])
def test_commands_for_the_plane_say_so(cli, arm: tuple[Path, Path], tmp_path: Path, command: tuple[str, ...]) -> None:
    said = cli(command[0], arm[1], *command[1:], "--out", tmp_path / "out")
    assert said.code == 6
    assert "needs a run in the plane" in said.err
    assert not (tmp_path / "out").exists()


def test_a_movement_in_the_plane_is_noted_in_space(tmp_path: Path) -> None:
    configuration = simulate("sit-to-stand", tmp_path / "sts", Options(repetitions=2, analog_rate=100))
    text = configuration.read_text("utf-8").replace("protocol: sit-to-stand", "space: 3d")
    configuration.write_text(text, "utf-8")
    summary = summary_of(run(load(configuration)))
    notes = summary["verdict"]["notes"] + summary["verdict"]["reasons"]
    assert "planar-motion" in {each["code"] for each in notes}
