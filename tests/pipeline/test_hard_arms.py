"""Simulated arms with much soft tissue whose results were once wrong without a word."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.runner import run_stage
from mocap_id.stages.base import Findings
from mocap_id.stages.segment import space as segment_stage
from mocap_id.store import Folder, Table
from mocap_id.verdict import Reason
from mocap_id_simulation import ArmOptions, write_arm

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def space():
    """The benchmark as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("space")


def hard_arm(space, folder: Path, seed: int) -> Path:
    return write_arm(folder, ArmOptions(seed=seed, **space.ROWS["arm, hard"].arm))


@pytest.mark.slow
def test_the_joint_fit_does_not_end_in_the_wrong_minimum(space, tmp_path: Path) -> None:
    """Steps of the whole chain from frames that do not obey the first axes ended 27° from the elbow's axis."""
    configuration = hard_arm(space, tmp_path / "arm", 260_009)
    found = space.compare(space.harness.run_trial(configuration))
    assert found.right
    assert found.errors["elbow axis, °"] < 8
    assert found.errors["shoulder_axial, °"] < 12


def test_the_wrist_is_at_its_landmarks_although_they_move_the_elbow_too(tmp_path: Path) -> None:
    """The elbow moves by 17 mm to its landmarks; the wrist was then 13 mm beside its own, which had not moved along."""
    configuration = write_arm(tmp_path / "arm", ArmOptions(seed=450_001, preset="hard", severity=0.1, rate=100.0))
    for stage in ("planarise", "segment", "fit-joints"):
        outcome = run_stage(load(configuration), stage)
    chain = Folder(outcome.folder).tree("chain.h5")
    beside = np.isin(chain.texts("landmarks/name"), ("RS", "US"))
    middle = chain.numbers("landmarks/local", (-1, 3))[beside].mean(axis=0)
    assert np.linalg.norm(chain.numbers("joints/centre", (-1, 3))[2] - middle) < 2e-3


@pytest.fixture(scope="module")
def stiff_wrist(space, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Table]:
    """Configuration and segments.parquet of an arm whose wrist hardly turns."""
    configuration = hard_arm(space, tmp_path_factory.mktemp("stiff"), 271_036)
    trial = load(configuration)
    for stage in ("planarise", "segment"):
        outcome = run_stage(trial, stage)
    return configuration, Folder(outcome.folder).table("segments.parquet")


def test_landmarks_of_the_wrist_are_on_the_forearm_where_the_wrist_hardly_turns(
    stiff_wrist: tuple[Path, Table],
) -> None:
    _, table = stiff_wrist
    names = table.facts["names"]
    assert names == ["thorax", "upper_arm", "forearm", "hand"]
    of = {
        label: (names[k], why)
        for label, k, why in zip(*(table[c] for c in ("marker", "segment", "reason")), strict=True)
    }
    for label in ("RS", "US"):
        segment, why = of[label]
        assert segment == "forearm"
        assert "because of its name" in why
    assert of["M008"][0] == "forearm"
    assert of["M014"][0] == "hand"


def test_hints_of_the_user_count_more_than_names_of_the_wrist(stiff_wrist: tuple[Path, Table]) -> None:
    configuration, table = stiff_wrist
    (why,) = (why for label, why in zip(table["marker"], table["reason"], strict=True) if label == "RS")
    forearm = why.split("on the segment of ")[1].split(",")[0]
    text = configuration.read_text("utf-8")
    assert "\nsegment:" not in text
    configuration.write_text(f"{text}\nsegment: {{apart: [[{forearm}, RS]]}}\n", "utf-8")
    table = Folder(run_stage(load(configuration), "segment").folder).table("segments.parquet")
    of = dict(zip(table["marker"], table["segment"], strict=True))
    assert of[forearm] != of["RS"]
    assert not any("because of its name" in why for why in table["reason"])
    assert "segments-unsure" in {reason.code for reason in table.reasons}


def test_a_segment_between_upper_arm_and_forearm_is_doubtful() -> None:
    """It cannot be: the elbow connects these two."""
    sure: Any = SimpleNamespace(confidence=SimpleNamespace(value=1.0))

    def doubt(*names: str) -> list[Reason]:
        out = Findings()
        segment_stage._explain_doubts(out, sure, names)
        return out.reasons

    assert not doubt("thorax", "upper_arm", "forearm", "hand")
    assert not doubt("base", "segment_1", "segment_2")
    (reason,) = doubt("thorax", "upper_arm", "segment_2", "forearm")
    assert reason.code == "segments-unsure"
    assert reason.level != "ok"
