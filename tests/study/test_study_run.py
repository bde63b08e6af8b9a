"""A study as a whole: one broken trial stops no other, nothing is computed twice, nobody is named."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from small_study import NAME, Ran

from mocap_id.errors import StoreError
from mocap_id.store import Folder
from mocap_id.workflows.identified_trial import open_identified_trial
from mocap_id.workflows.parallel import LocalBackend, TrialRun, run_trials
from mocap_id.workflows.study import run_study
from mocap_id.workflows.study.sit_to_stand import TABLES
from mocap_id.workflows.study.study import find_remarks, find_same_recordings
from mocap_id.workflows.transfer import SERIES, apply_model
from mocap_id.workflows.trial_outcome import TrialOutcome


def table(ran: Ran, name: str) -> pd.DataFrame:
    return pd.read_parquet(ran.folder / f"{name}.parquet")


def stamps(folder: Path) -> dict[str, int]:
    """When each file was written."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name not in ("lock", "run.log"))
    return {str(path): path.stat().st_mtime_ns for path in found}


def test_a_broken_a_missing_and_a_refused_trial_stop_no_other(ran: Ran) -> None:
    codes = {done.trial: done.exit_code for done in ran.outcome.runs}
    assert codes == {"s01-normal-1": 0, "s01-gone": 3, "s01-broken": 3, "s01-dynamic-1": 0, "s01-refused": 4}
    assert [done.trial for done in ran.told] == list(codes), "each is told once, as it ends"
    assert {done.trial for done in ran.outcome.failed} == {"s01-gone", "s01-broken", "s01-refused"}
    trials = table(ran, "trials").set_index("trial")
    assert trials.loc["s01-gone", "verdict"] == trials.loc["s01-broken", "verdict"] == "failed"
    assert trials.loc["s01-refused", "verdict"] == "refused"
    assert trials.loc["s01-gone", "message"] == "the C3D file: no such file, named as `recording.markers` in study.yaml"
    assert set(table(ran, "parameters")["trial"]) == {"s01-normal-1", "s01-dynamic-1"}
    assert (ran.outcome.study.out / "s01-refused" / "report.html").is_file()


def test_a_copied_recording_is_found(ran: Ran) -> None:
    def trials(*names: str) -> Any:
        out = ran.outcome.study.out
        return SimpleNamespace(
            trials=[SimpleNamespace(name=f"{k}", trial=SimpleNamespace(out=out / n)) for k, n in enumerate(names)]
        )

    assert list(find_same_recordings(trials("s01-normal-1", "s01-dynamic-1", "s01-gone"))) == []
    assert list(find_same_recordings(trials("s01-normal-1", "s01-dynamic-1", "s01-normal-1"))) == [("0", "2")]


def test_two_people_under_one_id_are_reported(tmp_path: Path) -> None:
    def remarks(*values: tuple[str, float | None, float]) -> list[str]:
        trials = [
            SimpleNamespace(name=f"t{k}", subject=subject, trial=SimpleNamespace(out=tmp_path / str(k)))
            for k, (subject, _, _) in enumerate(values)
        ]
        summaries = [
            {"dynamics": {"mass_kg": mass}, "lengths_m": {"shank": {"value": shank, "sd": 0.003}, "thigh": None}}
            for _, mass, shank in values
        ]
        outcomes = [TrialOutcome(run=None, summary=summary) for summary in summaries]  # type: ignore[arg-type]
        study = SimpleNamespace(subjects={"s01": None, "s02": None}, trials=trials)
        return list(find_remarks(study, outcomes))  # type: ignore[arg-type]

    assert remarks(("s01", 70.0, 0.40), ("s01", 72.5, 0.42), ("s02", 55.0, 0.35)) == []
    (mass,) = remarks(("s01", 70.0, 0.40), ("s01", 71.0, 0.40), ("s01", 58.0, 0.40))
    assert "s01 may be two people: the mass is 58 kg in t2 and 71 kg in t1" in mass
    (length,) = remarks(("s01", None, 0.40), ("s01", None, 0.46))
    assert "the length of the shank is 0.4 m in t0 and 0.46 m in t1" in length


def test_another_study_does_not_replace_the_tables(ran: Ran, tmp_path: Path) -> None:
    file = ran.copy(tmp_path / "copy")
    before = {path: path.read_bytes() for path in file.parent.rglob("*") if path.is_file() and path.suffix != ".log"}
    other = file.with_name("other.yaml")
    other.write_text(
        "study: another\nsubjects: {s01: {}}\ndefaults: {protocol: sit-to-stand}\n"
        f"trials: [{{trial: x, subject: s01, strategy: normal, recording: {NAME}/{NAME}-dynamic.c3d}}]\n"
    )
    with pytest.raises(StoreError, match=r"belongs to another .*`small` .*study\.yaml.*`another` .*other\.yaml"):
        run_study(other)
    assert before == {path: path.read_bytes() for path in before}
    renamed = file.rename(file.with_name("renamed.yaml"))
    assert run_study(renamed).study.name == "small"


def test_who_runs_it_is_told_which_file_is_broken(ran: Ran) -> None:
    messages = {done.trial: done.message or "" for done in ran.outcome.failed}
    assert f"{NAME}-gone.c3d: no such file" in messages["s01-gone"]
    assert f"{NAME}-broken.c3d" in messages["s01-broken"]


def test_no_file_of_the_study_names_the_person(ran: Ran) -> None:
    files = [path for path in ran.folder.rglob("*") if path.is_file() and path.suffix != ".parquet"]
    assert {path.name for path in files} >= {"cohort.html", "study.json", *(f"{name}.csv" for name in TABLES)}
    assert [path.name for path in files if NAME.encode() in path.read_bytes()] == []
    for name in TABLES:
        whole = pq.read_table(ran.folder / f"{name}.parquet")
        assert NAME not in str(whole.to_pylist()) + str(whole.schema.metadata)


def test_again_nothing_is_computed_and_nothing_written(ran: Ran) -> None:
    before, told = stamps(ran.outcome.study.out), []
    again = run_study(ran.file, tell=told.append)
    assert again.reused
    assert not any(done.computed for done in told)
    assert again.document == ran.outcome.document
    after = stamps(ran.outcome.study.out)
    assert after == before


def test_several_at_a_time_give_the_same(ran: Ran) -> None:
    def fate(done: TrialRun) -> tuple[object, ...]:
        return done.trial, done.exit_code, done.published, done.key

    trials = [one.trial for one in ran.outcome.study.trials]
    told: list[TrialRun] = []
    side_by_side = run_trials(trials, LocalBackend(2), told.append)
    assert list(map(fate, side_by_side)) == list(map(fate, ran.outcome.runs))
    assert sorted(done.trial for done in told) == sorted(trial.name for trial in trials)


class Deadly:
    """A trial that kills whatever process gets it."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __reduce__(self) -> tuple[Callable[[int], object], tuple[int]]:
        return os._exit, (1,)


def test_a_killed_process_is_the_failure_of_its_trials() -> None:
    trials: Any = [Deadly("one"), Deadly("two")]
    told: list[TrialRun] = []
    done = run_trials(trials, LocalBackend(2), told.append)
    assert [(one.trial, one.exit_code, one.key) for one in done] == [("one", 5, None), ("two", 5, None)]
    assert all("fewer --jobs" in (one.message or "") for one in told)


def test_a_damaged_table_is_made_anew_and_no_trial_computed(ran: Ran, tmp_path: Path) -> None:
    file = ran.copy(tmp_path)
    page, lengths = (tmp_path / "runs" / "study" / name for name in ("cohort.html", "lengths.csv"))
    whole = lengths.read_bytes()
    lengths.write_bytes(whole[:-10])
    page.unlink()
    told: list[TrialRun] = []
    again = run_study(file, tell=told.append)
    assert not again.reused
    assert not any(done.computed for done in told)
    assert lengths.read_bytes() == whole
    assert page.is_file()


def test_another_landmark_changes_tables_and_no_trial(ran: Ran, tmp_path: Path) -> None:
    file = ran.copy(tmp_path)
    file.write_text(file.read_text().replace("shank: 0.375", "shank: 0.400"))
    told: list[TrialRun] = []
    again = run_study(file, tell=told.append)
    assert not any(done.computed for done in told)
    frame = pd.read_csv(again.study.folder / "lengths.csv")
    row = frame[(frame["subject"] == "cohort") & (frame["segment"] == "shank") & (frame["method"] == "framework")]
    assert row["reference_length"].item() == 0.4
    assert row["error_mean"].item() == pytest.approx(-6.2, abs=0.5), "the simulated shank is 37.5 cm"


def test_two_runs_at_once_are_turned_away(ran: Ran) -> None:
    with Folder(ran.folder).locked(), pytest.raises(StoreError, match="is in use by another run"):
        run_study(ran.file)


def test_parquet_has_units_and_csv_the_same_numbers(ran: Ran) -> None:
    for name, schema in TABLES.items():
        file = pq.read_schema(ran.folder / f"{name}.parquet")
        described = {column["name"]: column for column in ran.outcome.document["tables"][name]["columns"]}
        for column in schema.columns:
            metadata = file.field(column.name).metadata
            assert metadata[b"unit"].decode() == column.unit == described[column.name]["unit"]
            assert metadata[b"meaning"].decode() == column.meaning
        whole = pq.read_table(ran.folder / f"{name}.parquet").to_pylist()
        with (ran.folder / f"{name}.csv").open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        assert len(rows) == len(whole) > 0, name
        for row, same in zip(rows, whole, strict=True):
            for key, text in row.items():
                value = same[key]
                missing = value is None or value == "" or (isinstance(value, float) and np.isnan(value))
                assert text == "" if missing else type(value)(text) == value, (name, key)
    assert pq.read_schema(ran.folder / "models.parquet").field("tau_2_mean").metadata[b"unit"] == b"N*m"


def test_models_are_those_of_transfer(ran: Ran) -> None:
    out = ran.outcome.study.out
    found = apply_model(open_identified_trial(out / "s01-dynamic-1"), open_identified_trial(out / "s01-normal-1"))
    frame = table(ran, "models")
    own = frame[frame["action_trial"] == "s01-normal-1"].set_index("model")
    for name, theirs in (
        ("own", "own"),
        ("own, held out", "own, held out"),
        ("dynamic", "transferred"),
        ("winter",) * 2,
    ):
        errors = next(body.errors for body in found.bodies if body.name == theirs)
        for series in SERIES:
            error = errors[series]
            assert error is not None
            assert own.loc[name, f"{series}_mean"] == pytest.approx(error.bias, rel=1e-9, abs=1e-12)
            assert own.loc[name, f"{series}_sd"] == pytest.approx(error.sd, rel=1e-9)
    assert own.loc["dynamic", "model_trial"] == "s01-dynamic-1"
    assert own.loc["dynamic", "registration_residual"] == pytest.approx(found.registration.residual[1:].max())


def test_lengths_and_errors_are_those_of_the_summaries(ran: Ran) -> None:
    trials = table(ran, "trials").set_index("trial")
    for name in ("s01-normal-1", "s01-dynamic-1"):
        summary = json.loads((ran.outcome.study.out / name / "summary.json").read_text())
        assert trials.loc[name, "shank"] == summary["lengths_m"]["shank"]["value"]
        assert trials.loc[name, "shank_error"] == pytest.approx(100 * (trials.loc[name, "shank"] / 0.375 - 1))
        assert trials.loc[name, "cop_x_own_rms"] == pytest.approx(summary["dynamics"]["cop_rms_m"])
        assert trials.loc[name, "Fy_own_sd"] == pytest.approx(summary["dynamics"]["wrench"]["Fy"]["sd"])
