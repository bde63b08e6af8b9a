"""Trials held against a baseline: what moved is told, what did not is not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from batch_cases import trials

from mocap_id.arrays import NORMAL_95
from mocap_id.errors import RecordingError, StoreError
from mocap_id.workflows.parallel import LocalBackend
from mocap_id.workflows.regress import Baseline, Expected, check_trials, list_expected, update


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Baseline]:
    """A trial, one that is broken, and a baseline of both."""
    folder = tmp_path_factory.mktemp("regress")
    well, broken = trials(folder, ["well", "broken"])
    broken.write_text(broken.read_text().replace("link", "nowhere"))
    baseline = update([str(well), str(broken)], Baseline(tolerances={"plane.*": 0.1}), LocalBackend())
    baseline.write(folder / "baseline.json")
    return folder, baseline


def test_nothing_moves_by_itself(made: tuple[Path, Baseline]) -> None:
    folder, _ = made
    found = check_trials([str(folder)], Baseline.read(folder / "baseline.json"), LocalBackend())
    assert found.passed
    assert found.compared > 15
    assert not (folder / "runs").exists(), "the trials' own folders are not touched"


def test_a_number_that_moves_is_found(made: tuple[Path, Baseline]) -> None:
    folder, baseline = made
    before = baseline.trials["well"]
    name = next(name for name in before if name.startswith("joints."))
    shifted = replace(before[name], value=before[name].value + 1.5 * before[name].tolerance)
    other = replace(baseline, trials={"well": {**before, name: shifted}})
    found = check_trials([str(folder / "well.yaml")], other, LocalBackend())
    assert [(one.trial, one.name) for one in found.moved] == [("well", name)]
    assert found.moved[0].tolerance_used == pytest.approx(1.5, rel=1e-6)
    assert replace(found.moved[0], tolerance=2.0 * found.moved[0].tolerance).tolerance_used == pytest.approx(
        0.75, rel=1e-6
    )


def test_another_recording_of_one_name_replaces_nothing(made: tuple[Path, Baseline]) -> None:
    folder, baseline = made
    other = replace(baseline, recordings={"well": 64 * "0"})
    with pytest.raises(StoreError, match="another recording with the name well"):
        update([str(folder / "well.yaml")], other, LocalBackend())
    found = check_trials([str(folder / "well.yaml")], other, LocalBackend())
    assert "not the one of the baseline" in found.messages["well"]
    again = update([str(folder / "well.yaml")], replace(baseline, recordings={}), LocalBackend())
    assert again.recordings["well"] == baseline.recordings["well"]


def test_the_command(cli: Callable[..., Any], made: tuple[Path, Baseline], tmp_path: Path) -> None:
    folder, baseline = made
    file, data = tmp_path / "baseline.json", json.loads((folder / "baseline.json").read_text())
    data["trials"]["well"]["segments.assignment.L1"]["value"] = "7"
    data["trials"]["well"]["plane.yaw_deg"]["value"] += 0.2
    del data["trials"]["broken"]
    file.write_text(json.dumps(data))
    said = cli("regress", folder, "--baseline", file)
    assert said.code == 1
    assert "segments.assignment.L1" in said.out
    assert "plane.yaw_deg" in said.out, "the user's own tolerance counts"
    assert "broken: not in the baseline" in said.out
    told = json.loads(cli("regress", folder / "well.yaml", "--baseline", file, "--json").out)
    assert {one["name"] for one in told["moved"]} == {"segments.assignment.L1", "plane.yaw_deg"}
    updated = cli("regress", folder, "--baseline", file, "--update")
    assert updated.code == 0
    assert "broken: failed, exit code 3" in updated.out, "that a failure is now what is expected has to be seen"
    again = Baseline.read(file)
    assert again.tolerances == baseline.tolerances
    assert again.trials.keys() == {"well", "broken"}
    assert again.trials["broken"] == {"exit_code": Expected("3")}


@pytest.mark.parametrize(
    "text", [None, "", "[]", '{"schema": "other", "version": 1}', '{"schema": "mocap-id/baseline"}']
)
def test_a_file_that_is_no_baseline(tmp_path: Path, text: str | None) -> None:
    file = tmp_path / "baseline.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(RecordingError, match=r"baseline.json: (no such file|not a baseline)"):
        Baseline.read(file)


def test_a_tolerance_is_the_stated_interval() -> None:
    length = {"lengths_m": {"shank": {"value": 0.4, "sd": 0.001}, "thigh": {"value": 0.4, "sd": None}}}
    found = dict(list_expected({"verdict": {"level": "ok", "reasons": []}, **length}))
    assert found["lengths_m.shank"] == Expected(0.4, NORMAL_95 * 0.001, "m")
    assert found["lengths_m.thigh"].tolerance == pytest.approx(0.02)


def test_the_last_pattern_that_fits_counts() -> None:
    baseline = Baseline(tolerances={"lengths_m.*": 0.1, "s01/lengths_m.*": 0.2})
    assert baseline.find_tolerance("s01", "lengths_m.shank", 0.3) == 0.2
    assert baseline.find_tolerance("s02", "lengths_m.shank", 0.3) == 0.1
    assert baseline.find_tolerance("s02", "plane.yaw_deg", 0.3) == 0.3
