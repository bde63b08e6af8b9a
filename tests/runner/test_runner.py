"""Computation, reuse, refusals, failures and interruptions of runs, with three toy stages."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from toy_stages import STAGES, cut, read, tell

from mocap_id.config import load
from mocap_id.errors import ConfigError, NumericalError, RecordingError, Refused, StoreError
from mocap_id.runner import LOG_FILE, RUN_LOG, Outcome, make_rules, run, run_stage, run_to
from mocap_id.stages.base import Context, Outputs, Stage
from mocap_id.store import Artefact, Folder, Origin, Table
from mocap_id.store.provenance import SEGMENTS


class Bench:
    """A trial of the toy stages in a folder."""

    def __init__(self, folder: Path) -> None:
        self.file, self.out, self.recording = folder / "trial.yaml", folder / "runs" / "toy", folder / "numbers.txt"
        self.recording.write_text("1\n2\n3\n")
        self.say()

    def say(self, **sections: object) -> None:
        content = {"trial": "toy", "recording": "numbers.txt"} | sections
        self.file.write_text(json.dumps(content))

    def run(self, stages: tuple[Stage, ...] = STAGES) -> Outcome:
        return run(load(self.file, stages), stages)

    def stage(self, name: str, stages: tuple[Stage, ...] = STAGES) -> Outcome:
        return run_stage(load(self.file, stages), name, stages)

    def files(self) -> list[str]:
        if not self.out.exists():
            return []
        return sorted(path.name for path in self.out.iterdir() if path.name not in (".mocap-id", RUN_LOG))


def actions(outcome: Outcome) -> list[str]:
    return [step.action for step in outcome.steps]


def instead(name: str, function: Callable[[Context], Outputs], **changes: object) -> tuple[Stage, ...]:
    """The toy stages with another function for one of them."""
    return tuple(
        dataclasses.replace(s, function=function, **changes) if s.name == name else s  # type: ignore[arg-type]
        for s in STAGES
    )


def raising(error: BaseException) -> Callable[[Context], Outputs]:
    def function(context: Context) -> Outputs:
        raise error

    return function


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


ALL = ["events.parquet", "report.html", "segments.parquet", "summary.json"]


def test_everything_is_computed_once(bench: Bench) -> None:
    first, second = bench.run(), bench.run()
    assert actions(first) == ["computed"] * 3
    assert actions(second) == ["reused"] * 3
    assert [step.seconds for step in second.steps] == [step.seconds for step in first.steps]
    assert bench.files() == ALL
    assert second.summary()["time_s"] == ["cut", "read"]


def test_run_and_single_stages_share_their_work(bench: Bench) -> None:
    assert actions(bench.stage("read")) == ["computed"]
    assert actions(bench.stage("cut")) == ["computed"]
    assert actions(bench.run()) == ["reused", "reused", "computed"]
    for stage in STAGES:
        assert actions(bench.stage(stage.name)) == ["reused"]


def test_a_run_up_to_a_stage_leaves_the_later_ones_alone(bench: Bench) -> None:
    def up_to(name: str) -> list[str]:
        return actions(run_to(load(bench.file, STAGES), name, STAGES))

    assert up_to("cut") == ["computed", "computed"]
    assert bench.files() == ["events.parquet", "segments.parquet"]
    assert up_to("cut") == ["reused", "reused"]
    assert actions(bench.run()) == ["reused", "reused", "computed"]
    bench.say(cut={"length": 1})
    assert up_to("read") == ["reused"]
    assert up_to("cut") == ["reused", "computed"]
    assert actions(bench.run()) == ["reused", "reused", "computed"]


def test_a_setting_affects_its_stage_and_later_ones(bench: Bench) -> None:
    bench.run()
    bench.say(cut={"length": 3})
    assert actions(bench.run()) == ["reused", "computed", "computed"]
    bench.say(cut={"length": 3}, window=[0, 1])
    assert actions(bench.run()) == ["computed", "computed", "computed"]


def test_a_setting_counts_even_where_it_changes_no_result(bench: Bench) -> None:
    bench.run()
    bench.say(read={"unused": 5})
    assert actions(bench.run()) == ["computed", "computed", "computed"]


def test_a_lost_file_is_made_again_without_affecting_others(bench: Bench) -> None:
    bench.run()
    (bench.out / "events.parquet").unlink()
    assert actions(bench.run()) == ["computed", "reused", "reused"]


def test_a_default_written_out_changes_nothing(bench: Bench) -> None:
    bench.run()
    bench.say(read={"gain": 1.0}, cut={"length": 2})
    assert actions(bench.run()) == ["reused"] * 3


def test_the_recording_is_identified_by_its_content(bench: Bench) -> None:
    bench.run()
    stamp = time.time_ns() + 10**9
    os.utime(bench.recording, ns=(stamp, stamp))
    assert actions(bench.run()) == ["reused"] * 3
    bench.recording.write_text("4\n5\n6\n")
    assert actions(bench.run()) == ["computed"] * 3


def test_a_moved_trial_stays_up_to_date(bench: Bench, tmp_path: Path) -> None:
    bench.run()
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("trial.yaml", "numbers.txt", "runs"):
        (tmp_path / name).rename(moved / name)
    assert actions(run(load(moved / "trial.yaml", STAGES), STAGES)) == ["reused"] * 3


def test_a_new_version_of_a_stage_is_another_stage(bench: Bench) -> None:
    bench.run()
    assert actions(bench.run(instead("cut", cut, version=2))) == ["reused", "computed", "computed"]


@pytest.mark.parametrize("spoil", ["delete", "truncate"])
@pytest.mark.parametrize("file", ALL)
def test_lost_or_damaged_files_are_made_again(bench: Bench, file: str, spoil: str) -> None:
    bench.run()
    path = bench.out / file
    if spoil == "delete":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-10])
    whose = next(index for index, stage in enumerate(STAGES) if file in stage.outputs)
    expected = ["reused"] * 3
    expected[whose] = "computed"
    assert actions(bench.run()) == expected


def test_a_damaged_artefact_is_mentioned(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.run()
    (bench.out / "events.parquet").write_bytes(b"rubbish")
    caplog.set_level(logging.WARNING, "mocap_id")  # a command that was told to be quiet may have been called before
    bench.run()
    assert "events.parquet is damaged" in caplog.text


def test_a_stage_without_its_inputs_says_what_to_run(bench: Bench) -> None:
    with pytest.raises(StoreError, match=r"events.parquet is missing. Run `mocap-id read .*trial.yaml` first"):
        bench.stage("cut")
    bench.stage("read")
    with pytest.raises(StoreError, match=r"segments.parquet is missing. Run `mocap-id cut"):
        bench.stage("tell")


@pytest.mark.parametrize("how", ["setting", "recording", "version", "earlier"])
def test_stale_inputs_are_not_used(bench: Bench, how: str) -> None:
    bench.run()
    stages, stage = STAGES, "cut"
    match how:
        case "setting":
            bench.say(read={"gain": 2})
        case "recording":
            bench.recording.write_text("9\n")
        case "version":
            stages = instead("read", read, version=2)
        case "earlier":  # what is stale need not be read directly
            bench.say(read={"gain": 2})
            stage = "tell"
    with pytest.raises(StoreError, match=r"events.parquet was made from another .* Run `mocap-id read"):
        bench.stage(stage, stages)


def test_a_damaged_input_is_named(bench: Bench) -> None:
    bench.run()
    (bench.out / "events.parquet").write_bytes(b"rubbish")
    with pytest.raises(StoreError, match=r"events.parquet is damaged"):
        bench.stage("cut")


REFUSAL = Refused("not-planar", "the motion leaves the plane", 0.4, 0.1)


@pytest.mark.parametrize(("stage", "left"), [("read", []), ("cut", ["events.parquet"])])
@pytest.mark.parametrize("alone", [False, True])
def test_a_refusal_is_reported_and_removes_older_results(
    bench: Bench, stage: str, left: list[str], alone: bool
) -> None:
    bench.run()
    stages = instead(stage, raising(REFUSAL), version=2)
    outcome = bench.stage(stage, stages) if alone else bench.run(stages)
    assert outcome.refused is REFUSAL
    assert actions(outcome)[-2:] == ["refused", "computed"]
    assert bench.files() == sorted([*left, "report.html", "summary.json"])
    summary = outcome.summary()
    assert summary["verdict"]["level"] == "refused"
    assert summary["verdict"]["reasons"][-1]["code"] == "not-planar"
    assert summary["inputs"] == left


def test_a_refused_trial_can_be_corrected_and_run_again(bench: Bench) -> None:
    refusing = instead("cut", raising(REFUSAL), version=2)
    for _ in range(2):
        refused = bench.run(refusing).refused
        assert refused is not None
        assert refused.args == REFUSAL.args
        assert (refused.code, refused.value, refused.limit) == (REFUSAL.code, REFUSAL.value, REFUSAL.limit)
    assert actions(bench.run()) == ["reused", "computed", "computed"]
    assert bench.run().summary()["verdict"]["level"] == "ok"


def test_a_refusal_is_remembered_until_something_changes(bench: Bench) -> None:
    asked = []

    def refuse(context: Context) -> Outputs:
        asked.append(context)
        raise Refused("not-planar", "the motion leaves the plane", 0.4, 0.1)

    refusing = instead("cut", refuse, version=2)
    first = bench.run(refusing)
    second = bench.run(refusing)
    assert actions(first)[1:] == ["refused", "computed"]
    assert actions(second) == ["reused", "refused", "reused"]
    assert len(asked) == 1
    assert second.summary()["verdict"] == first.summary()["verdict"]
    assert second.refused is not None
    assert (second.refused.value, second.refused.limit) == (0.4, 0.1)
    bench.say(cut={"length": 1})
    assert actions(bench.run(refusing))[1:] == ["refused", "reused"], "asked anew, with the same answer"
    (bench.out / "report.html").write_text("edited")
    assert actions(bench.run(refusing)) == ["reused", "refused", "computed"]
    bench.recording.write_text("5\n6\n")
    assert actions(bench.run(refusing)) == ["computed", "refused", "computed"]
    assert len(asked) == 3, "the edited report alone is no reason to ask again"


def test_a_numerical_failure_leaves_what_came_before(bench: Bench) -> None:
    bench.run()
    with pytest.raises(NumericalError, match="singular") as caught:
        bench.run(instead("cut", raising(NumericalError("singular")), version=2))
    assert caught.value.__notes__ == ["trial toy, stage cut"]
    assert bench.files() == ["events.parquet"]


def test_an_unforeseen_failure_is_one_line_and_a_log(bench: Bench) -> None:
    with pytest.raises(NumericalError, match=r"unforeseen failure, ZeroDivisionError: .*failure.log") as caught:
        bench.run(instead("cut", lambda context: 1 // 0))  # type: ignore[arg-type, return-value]
    assert "\n" not in str(caught.value)
    assert caught.value.__notes__ == ["trial toy, stage cut"]
    assert "ZeroDivisionError" in (bench.out / LOG_FILE).read_text()
    bench.run()
    assert bench.files() == ALL


def test_the_log_describes_every_run(bench: Bench) -> None:
    bench.run()
    bench.run()
    with pytest.raises(NumericalError):
        bench.run(instead("cut", raising(NumericalError("singular")), version=2))
    with pytest.raises(RecordingError):
        bench.run(instead("read", raising(RecordingError(f"{bench.recording}: no markers")), version=2))
    told = [line.partition("Z ")[2] for line in (bench.out / RUN_LOG).read_text("utf-8").splitlines()]
    begins = [k for k, line in enumerate(told) if line.startswith("toy: mocap-id ")]
    first, again, failed, unreadable = (told[a:b] for a, b in zip(begins, [*begins[1:], None], strict=True))
    assert [line.partition(",")[0] for line in first[1:-1]] == [f"{stage.name} computed" for stage in STAGES]
    assert again[1:-1] == [f"{stage.name} reused" for stage in STAGES]
    assert failed[1:] == ["read reused", "NumericalError: singular"]
    assert unreadable[1:] == ["RecordingError: recording.markers: no markers"], "not by the recording's own name"


def test_the_log_keeps_its_newer_half(bench: Bench) -> None:
    bench.run()
    (bench.out / RUN_LOG).write_text("an old line\n" * 90_000)
    bench.run()
    kept = (bench.out / RUN_LOG).read_text().splitlines()
    assert len(kept) * len("an old line\n") < 600_000
    assert kept[0] == "an old line"
    assert "reused" in kept[-2]


def test_a_recording_is_not_taken_for_a_log(bench: Bench) -> None:
    bench.out.mkdir(parents=True)
    shutil.copy(bench.recording, bench.out / RUN_LOG)
    bench.file.write_text(bench.file.read_text().replace(bench.recording.name, str(bench.out / RUN_LOG)))
    with pytest.raises(ConfigError, match="would overwrite"):
        bench.run()


def test_a_stage_with_other_outputs_than_its_record_is_an_error(bench: Bench) -> None:
    with pytest.raises(NumericalError, match="it declares"):
        bench.run(instead("cut", lambda context: ()))
    with pytest.raises(NumericalError, match="residual"):
        bench.run(instead("cut", lambda context: (Table(SEGMENTS, pd.DataFrame({"marker": ["A"]})),)))


def test_an_error_in_the_recording_leaves_older_results(bench: Bench) -> None:
    bench.run()
    with pytest.raises(RecordingError):
        bench.run(instead("read", raising(RecordingError("no markers")), version=2))
    assert bench.files() == ALL


@pytest.mark.parametrize("interruption", [KeyboardInterrupt(), SystemExit(143)])
def test_an_interruption_leaves_whole_files_and_resumes(bench: Bench, interruption: BaseException) -> None:
    with pytest.raises(type(interruption)):
        bench.run(instead("cut", raising(interruption)))
    assert bench.files() == ["events.parquet"]
    assert actions(bench.run()) == ["reused", "computed", "computed"]


def test_a_missing_recording_writes_nothing(bench: Bench) -> None:
    bench.recording.unlink()
    with pytest.raises(RecordingError, match=r"numbers.txt: no such file, named as `recording.markers` in"):
        bench.run()
    assert not bench.out.exists()


def test_a_folder_for_a_recording(bench: Bench) -> None:
    bench.say(recording=".")
    with pytest.raises(RecordingError, match="cannot be read"):
        bench.run()


def test_a_run_never_overwrites_what_it_reads(bench: Bench) -> None:
    target = bench.recording.parent / "events.parquet"
    bench.recording.rename(target)
    bench.say(recording="events.parquet", out=".")
    with pytest.raises(ConfigError, match=r"would overwrite `recording.markers`"):
        bench.run()
    assert target.read_text() == "1\n2\n3\n"


def test_a_second_run_fails_at_once(bench: Bench) -> None:
    with Folder(bench.out).locked(), pytest.raises(StoreError, match="in use by another run"):
        bench.run()


def test_a_stage_cannot_spoil_the_next_ones_input(bench: Bench) -> None:
    def careless(context: Context) -> Outputs:
        context.table("events.parquet").facts["count"] = -1  # its own copy
        with pytest.raises(ValueError, match="read-only"):
            context.table("events.parquet")["start"][:] = -1.0
        return cut(context)

    seen: list[float] = []

    def look(context: Context) -> Outputs:
        seen.extend([*context.table("events.parquet")["start"], context.table("events.parquet").facts["count"]])
        return tell(context)

    stages = tuple(dataclasses.replace(s, function=look) if s.name == "tell" else s for s in instead("cut", careless))
    bench.run(stages)
    assert seen == [1.0, 2.0, 3.0, 3]


def test_outputs_in_memory_equal_those_in_the_files(bench: Bench) -> None:
    seen: list[dict[str, Artefact]] = []

    def look(context: Context) -> Outputs:
        seen.append(dict(context.inputs))
        return tell(context)

    stages = instead("tell", look)
    bench.run(stages)
    (bench.out / "summary.json").unlink()
    bench.run(stages)
    handed, read = seen
    for file, artefact in handed.items():
        assert (artefact.facts, artefact.reasons) == (read[file].facts, read[file].reasons)
        pd.testing.assert_frame_equal(artefact.frame, read[file].frame)


def test_a_large_output_leaves_memory_until_a_later_stage_reads_its_file(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocap_id.runner.execution._LARGE", 0)
    store, writes, computed = Folder.store, threading.Event(), threading.Event()
    folders: list[Folder] = []
    seen: list[float] = []

    def slowly(folder: Folder, outputs: Any, origin: Origin) -> None:
        if origin.stage == "read":
            folders.append(folder)
            writes.set()
            assert computed.wait(10)
        store(folder, outputs, origin)

    def alone(context: Context) -> Outputs:
        assert writes.wait(10)
        assert folders[0].size("events.parquet") is None
        computed.set()
        columns = {"marker": np.array(["M0"], dtype=object), "segment": np.ones(1, dtype=np.int64)}
        beside = {"residual": np.zeros(1), "reason": np.full(1, "", dtype=object)}
        return (Table(SEGMENTS, columns | beside),)

    def look(context: Context) -> Outputs:
        seen.extend(context.table("events.parquet")["start"])
        return tell(context)

    monkeypatch.setattr(Folder, "store", slowly)
    last = instead("tell", look)
    bench.run(tuple(dataclasses.replace(s, function=alone, inputs=()) if s.name == "cut" else s for s in last))
    assert seen == [1.0, 2.0, 3.0]


def test_a_run_computes_while_it_writes_and_ends_after_the_last_file(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, told = threading.Event(), []
    store = Folder.store

    def slowly(folder: Folder, outputs: Any, origin: Origin) -> None:
        if origin.stage == "read":
            assert began.wait(10)  # the next stage computes before this one is on the disk
        store(folder, outputs, origin)
        told.append(origin.stage)

    def cuts(context: Context) -> Outputs:
        began.set()
        return cut(context)

    monkeypatch.setattr(Folder, "store", slowly)
    assert actions(bench.run(instead("cut", cuts))) == ["computed"] * 3
    assert told == ["read", "cut", "tell"]
    assert actions(bench.run()) == ["reused"] * 3


def test_a_failed_write_ends_the_run_without_later_files(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Folder.store

    def full(folder: Folder, outputs: Any, origin: Origin) -> None:
        if origin.stage == "read":
            raise StoreError("the disk is full")
        store(folder, outputs, origin)

    monkeypatch.setattr(Folder, "store", full)
    with pytest.raises(StoreError, match="the disk is full") as caught:
        bench.run()
    assert caught.value.__notes__ == ["trial toy, stage read"]
    assert not list(bench.out.glob("*.parquet"))
    monkeypatch.undo()
    assert actions(bench.run()) == ["computed"] * 3


def test_provenance_names_files_without_their_folders(bench: Bench) -> None:
    bench.run()
    origin = Folder(bench.out).provenance("events.parquet").origin
    assert origin.parameters == {
        "recording": {"markers": "numbers.txt", "skeleton": None, "forces": None},
        "window": None,
        "read": {"gain": 1.0, "unused": 0.0},
    }
    assert list(origin.inputs) == ["recording.markers"]


def test_rules_name_every_file_and_command(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bench.file.parent)
    rules = make_rules([load(bench.file, STAGES)], "mocap-id", STAGES)
    assert "all: runs/toy/summary.json runs/toy/report.html" in rules
    assert "runs/toy/events%parquet: trial.yaml numbers.txt\n\tmocap-id read trial.yaml" in rules
    assert "runs/toy/segments%parquet: trial.yaml runs/toy/events.parquet\n\tmocap-id cut trial.yaml" in rules


def test_paths_that_make_cannot_handle_are_refused(bench: Bench, tmp_path: Path) -> None:
    twin = tmp_path / "twin.yaml"
    twin.write_text(bench.file.read_text())
    with pytest.raises(ConfigError, match="share the folder"):
        make_rules([load(bench.file, STAGES), load(twin, STAGES)], "mocap-id", STAGES)
    bench.say(recording="my numbers.txt")
    with pytest.raises(ConfigError, match="rename it"):
        make_rules([load(bench.file, STAGES)], "mocap-id", STAGES)
