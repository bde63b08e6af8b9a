"""The robot study end to end: simulated trials, own trials without truth, and a trial that fails."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from mocap_id.config.study import load_robot_study
from mocap_id.errors import ConfigError
from mocap_id.workflows.figures import write_figures
from mocap_id.workflows.study.robots import TABLES, RobotStudyResult, read_published, validate_robot
from mocap_id_simulation import Options, RobotSet, simulate_robot_set
from mocap_id_simulation.space_robot import reuse_robot_set, robot_set_trials

OPTIONS = Options(seed=31, repetitions=3, rate=120.0, analog_rate=600.0)
TWO = RobotSet(1, ("elbow", "wrist"), ("fast",), (45.0,), OPTIONS)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, RobotStudyResult]]:
    out = tmp_path_factory.mktemp("robot") / "out"
    yield out, validate_robot(partial(reuse_robot_set, robot_set=TWO), out)


def row(frame: pd.DataFrame, **cell: object) -> pd.Series:  # type: ignore[type-arg]
    for name, value in cell.items():
        frame = frame[frame[name] == value]
    assert len(frame) == 1, cell
    return frame.iloc[0]


def test_every_trial_and_method_is_near_the_truth(study: tuple[Path, RobotStudyResult]) -> None:
    frame = study[1].frames["trials"]
    assert not study[1].failed
    for joint, reference, within in (
        ("elbow", (26.633, 0, 0, 1.76, 0.7), 0.01),
        ("wrist", (26.633, 0, 0, 0.11, 0.01), None),
    ):
        for method in ("cameras", "encoder", "differences", "differences-6", "spline"):
            found = row(frame, joint=joint, method=method)
            for name, true in zip(("mass", "mx1", "mx2", "my2", "Izz2"), reference, strict=True):
                assert abs(found[name] - true) < 4 * found[f"{name}_sd"], (joint, method, name)
                assert found[f"{name}_reference"] == true
            if within is not None:
                assert found["my2"] == pytest.approx(1.76, rel=within)
            assert found["against"] == "truth"
            assert found["theta_r2"] > 0.9999
            assert abs(found["base_error"]) < 1e-3
        for method in ("cameras", "encoder"):
            assert row(frame, joint=joint, method=method)["ddtheta_r2"] > 0.99
        clock = row(frame, joint=joint, method="cameras")
        assert abs(clock["encoder_offset"] - clock["encoder_offset_truth"]) < 4 * clock["encoder_offset_sd"]


def test_the_wrist_is_said_to_be_weak_and_the_elbow_known(study: tuple[Path, RobotStudyResult]) -> None:
    frame = study[1].frames["trials"]
    assert row(frame, joint="wrist", method="cameras")["Izz2_verdict"] in {"weak", "not identifiable"}
    assert "parameters-weak" in row(frame, joint="wrist", method="cameras")["codes"]
    assert row(frame, joint="elbow", method="cameras")["Izz2_verdict"] == "known"
    assert (
        row(frame, joint="elbow", method="cameras")["torque_r2"]
        > 0.97
        > row(frame, joint="wrist", method="cameras")["torque_r2"]
    )


def test_the_reference_fits_as_well_as_what_was_found(study: tuple[Path, RobotStudyResult]) -> None:
    """The reference is the truth here, so a wrong rotation into the plane would show."""
    frame = study[1].frames["trials"]
    for joint in ("elbow", "wrist"):
        reference, found = (row(frame, joint=joint, method=method) for method in ("reference", "encoder"))
        for name in ("Fx", "Fy", "tauz", "torque"):
            assert reference[f"{name}_sd"] == pytest.approx(found[f"{name}_sd"], rel=0.05)
            assert abs(reference[f"{name}_bias"]) < 0.2 * found[f"{name}_sd"]


def test_tables_have_the_thesiss_rows_below_ours_in_the_same_units(study: tuple[Path, RobotStudyResult]) -> None:
    frames = study[1].frames
    kinematic = row(frames["table_5_1"], joint="elbow", source="thesis")
    assert (kinematic["base_mean"], kinematic["marker_mean"]) == pytest.approx((0.525, 0.6e-3))
    assert kinematic["dtheta_sd"] == pytest.approx(np.radians(3.5))
    assert row(frames["table_5_1"], joint="elbow", source="this")["base_mean"] == pytest.approx(0.526, abs=1e-3)
    dynamic = row(frames["table_5_2"], joint="elbow", source="thesis", obs="P")
    assert (dynamic["condition_mean"], dynamic["my2_mean"], dynamic["torque_sd"]) == (5.056, 1.675, 1.572)
    assert row(frames["table_5_5_6"], joint="wrist", source="thesis", obs="Spline")["Izz2_mean"] == 0.075
    assert row(frames["table_5_4"], joint="wrist", source="thesis", obs="Ref.")["Fy_r2_mean"] == -186.1
    assert set(frames["table_5_3"]["obs"]) == {"R", "P"}


def test_every_row_of_the_thesis_has_a_number_for_each_of_its_columns() -> None:
    counts = {"table_5_1": 10, "table_5_2": 13, "table_5_3": 10, "table_5_4": 13, "table_5_5_6": 15}
    for table, (_, methods, quantities) in TABLES.items():
        published = read_published(table)
        assert len(published) == counts[table]
        own = [len(row) // 2 for row in published.values()]
        assert set(own) == {len(quantities) - (table in {"table_5_1", "table_5_5_6"})}
        assert {obs for *_, obs in published} <= set(methods.values())


def test_files_say_what_they_hold(study: tuple[Path, RobotStudyResult]) -> None:
    out = study[0]
    document = json.loads((out / "validation.json").read_text())
    assert [trial["against"] for trial in document["trials"]] == ["truth", "truth"]
    for name, table in document["tables"].items():
        stored = pq.read_table(out / f"{name}.parquet")
        assert stored.num_rows == table["rows"] == len(pd.read_csv(out / f"{name}.csv"))
        assert stored.schema.field(-1).metadata[b"meaning"].decode() == table["columns"][-1]["meaning"]
    page = (out / "robot.html").read_text()
    assert page.count('class="chart" data-figure=') == 4  # one cell: one recovery
    assert "2 of 2 trials have results" in page
    assert "| elbow |" in (out / "robot.md").read_text()
    drawn = {path.stem for path in write_figures(out)}
    assert drawn == {"recovery-1", "wrench", "residuals", "accelerations", "captions"}


def test_what_no_method_changes_is_computed_once(study: tuple[Path, RobotStudyResult]) -> None:
    run = study[0] / "runs" / "elbow-fast-45-1"
    for file in ("planar.parquet", "chain.h5"):
        assert (run / file).samefile(run / "methods" / "spline" / file)
    again = validate_robot(partial(reuse_robot_set, robot_set=TWO), study[0])
    assert all(not one.run.computed for one in again.trials)


def test_a_labs_own_trials_without_truth_and_one_that_fails(
    study: tuple[Path, RobotStudyResult], tmp_path: Path, cli
) -> None:  # type: ignore[no-untyped-def]
    source = study[0] / "trials" / "elbow-fast-45-1"
    for file in ("trial.c3d", "encoder.csv"):
        (tmp_path / file).write_bytes((source / file).read_bytes())
    common = "protocol: robot-joint\nencoder: encoder.csv\n"
    (tmp_path / "mine.yaml").write_text(f"trial: mine\nrecording: trial.c3d\n{common}")
    (tmp_path / "lost.yaml").write_text(f"trial: lost\nrecording: nowhere.c3d\n{common}")
    page = tmp_path / "page.md"
    page.write_text(
        "above\n<!-- tables: written by `mocap-id validate robot` -->\nold\n<!-- end of tables -->\nbelow\n"
    )
    (tmp_path / "study.yaml").write_text(
        "study: lab\nreference: {elbow: {mass: 26.6, mx1: 0.0, mx2: 0.0, my2: 1.7, Izz2: 0.7}}\ntrials:\n"
        "  - {file: mine.yaml, joint: elbow, speed: fast, orientation: 45}\n  - {file: lost.yaml}\n"
    )
    said = cli("validate", "robot", tmp_path / "study.yaml", "--out", tmp_path / "out", "--page", page)
    assert said.code == 1
    assert "1 of 2 trials have results" in said.out and "nowhere.c3d" in said.out
    frame = pd.read_parquet(tmp_path / "out" / "trials.parquet")
    found = row(frame, trial="mine", method="cameras")
    assert found["against"] == "encoder"
    assert found["ddtheta_r2"] > 0.99
    assert np.isnan(found["encoder_offset_truth"]) and np.isnan(found["base_error"])
    assert np.isnan(row(frame, trial="mine", method="encoder")["theta_sd"])
    assert found["my2_reference"] == 1.7
    assert row(frame, trial="lost", method="cameras")["verdict"] == "failed"
    text = page.read_text()
    assert text.startswith("above") and text.rstrip().endswith("below") and "old" not in text
    assert "page/recovery-1.svg" in text and (tmp_path / "page" / "recovery-1.svg").exists()


def test_the_shared_trial_of_the_thesiss_elbow(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "simulated" / "ur5-elbow-fast"
    (tmp_path / "ur5.yaml").write_text(
        f"trial: ur5\nrecording: {folder}/trial.c3d\nprotocol: robot-joint\nencoder: {folder}/encoder.csv\n"
    )
    found = validate_robot([tmp_path / "ur5.yaml"], tmp_path / "out")
    truth = json.loads((folder / "truth.json").read_text())
    ours = row(found.frames["table_5_2"], obs="P", source="this")
    assert (ours["joint"], ours["speed"]) == ("elbow", "fast")
    assert ours["my2_mean"] == pytest.approx(1.76, rel=0.01)
    assert ours["Izz2_mean"] == pytest.approx(0.70, rel=0.02)
    assert ours["torque_r2_mean"] > 0.97
    kinematic = row(found.frames["table_5_1"], source="this")
    assert abs(kinematic["base_error_mean"]) < 1e-3 and kinematic["marker_mean"] < 1.5e-3
    states = row(found.frames["table_5_3"], obs="P", source="this")
    assert states["theta_r2_mean"] > 0.9999 and states["ddtheta_r2_mean"] > 0.995
    clock = row(found.frames["trials"], method="cameras")
    offset, sd = clock["encoder_offset"], clock["encoder_offset_sd"]
    assert abs(offset - truth["encoder"]["clock_offset_s"]) < 4 * sd < 1e-3


def test_more_repeats_leave_the_first_ones_alone() -> None:
    one, three = (dict(robot_set_trials(replace(TWO, repeats=repeats))) for repeats in (1, 3))
    assert one.items() <= three.items()
    assert len({options.seed for options in three.values()}) == len(three) == 6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("study: a\ntrials:\n  - {fil: x.yaml}\n", ["fil", "file"]),
        ("study: a\nreference: {elbow: {Izz: 1.0}}\ntrials:\n  - {file: t.yaml}\n", ["Izz", "Izz2"]),
        ("study: a\ntrials:\n  - {file: t.yaml}\n  - {file: t.yaml}\n", ["two trials are called t"]),
        ("study: a\ntrials:\n  - {file: free.yaml}\n", ["robot-joint"]),
    ],
)
def test_a_wrong_study_file_is_explained(tmp_path: Path, text: str, words: list[str]) -> None:
    (tmp_path / "t.yaml").write_text("trial: t\nrecording: t.c3d\nprotocol: robot-joint\n")
    (tmp_path / "free.yaml").write_text("trial: t\nrecording: t.c3d\n")
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_robot_study((tmp_path / "study.yaml",))
    for word in words:
        assert word in str(caught.value)


def test_a_set_is_made_in_an_empty_folder_only(tmp_path: Path) -> None:
    (tmp_path / "something").write_text("")
    with pytest.raises(Exception, match="not empty"):
        simulate_robot_set(tmp_path, TWO)


def test_another_set_is_not_taken_for_the_one_that_is_asked_for(study: tuple[Path, RobotStudyResult]) -> None:
    other = replace(TWO, options=replace(TWO.options, seed=TWO.options.seed + 1))
    with pytest.raises(ConfigError, match="a different seed or number of trials"):
        validate_robot(partial(reuse_robot_set, robot_set=other), study[0])
