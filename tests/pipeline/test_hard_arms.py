"""Simulated arms with much soft tissue whose results were once wrong without a word."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from mocap_id.config import load
from mocap_id.runner import run, run_stage
from mocap_id.simulation.arm import ArmOptions, write_arm
from mocap_id.stages.segment import space as segment_stage
from mocap_id.store import Folder

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def space():
    """The benchmark as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("space")


def hard_arm(space, folder: Path, seed: int) -> Path:
    return write_arm(folder, ArmOptions(seed=seed, **space.ROWS["arm, hard"].arm))


def test_the_joint_fit_does_not_end_in_the_wrong_minimum(space, tmp_path: Path) -> None:
    """Steps of the whole chain from frames that do not obey the first axes ended 27° from the elbow's axis."""
    configuration = hard_arm(space, tmp_path / "arm", 260_009)
    found = space.compare(configuration, run(load(configuration)).folder)
    assert found.right
    assert found.errors["elbow axis, °"] < 8
    assert found.errors["shoulder_axial, °"] < 12


def test_landmarks_of_the_wrist_are_on_the_forearm_where_the_wrist_hardly_turns(space, tmp_path: Path) -> None:
    configuration = hard_arm(space, tmp_path / "arm", 271_036)
    trial = load(configuration)
    for stage in ("planarise", "segment"):
        outcome = run_stage(trial, stage)
    table = Folder(outcome.folder).table("segments.parquet")
    names = table.facts["names"]
    assert names == ["thorax", "upper_arm", "forearm", "hand"]
    of = {
        label: (names[k], why)
        for label, k, why in zip(*(table[c] for c in ("marker", "segment", "reason")), strict=True)
    }
    for label in ("RS", "US"):
        segment, why = of[label]
        assert segment == "forearm"
        assert "as its name says" in why
    assert of["M008"][0] == "forearm"
    assert of["M014"][0] == "hand"


def test_a_segment_between_upper_arm_and_forearm_is_doubtful() -> None:
    """It cannot be: the elbow connects these two."""
    assert not segment_stage._without_forearm(["thorax", "upper_arm", "forearm", "hand"])
    assert not segment_stage._without_forearm(["base", "segment_1", "segment_2"])
    (reason,) = segment_stage._without_forearm(["thorax", "upper_arm", "segment_2", "forearm"])
    assert reason.code == "segments-unsure"
    assert reason.level != "ok"
