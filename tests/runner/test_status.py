"""Status of a trial, and removal of its outputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from filelock import FileLock
from toy_stages import STAGES

from mocap_id.config import load
from mocap_id.errors import NumericalError, Refused, StoreError
from mocap_id.runner import TrialStatus, clean, run, status
from mocap_id.stages.base import Context, Outputs, Stage
from mocap_id.store import Folder

NAMES = [stage.name for stage in STAGES]


class Bench:
    """A toy trial."""

    def __init__(self, folder: Path) -> None:
        self.file, self.recording = folder / "trial.yaml", folder / "numbers.txt"
        self.recording.write_text("1\n2\n3\n")
        self.file.write_text("trial: toy\nrecording: numbers.txt\n")
        self.out = folder / "runs" / "toy"

    def run(self, stages: tuple[Stage, ...] = STAGES) -> None:
        run(load(self.file, stages), stages)

    def status(self, stages: tuple[Stage, ...] = STAGES) -> TrialStatus:
        return status(load(self.file, stages), stages)

    def states(self) -> list[str]:
        return [one.state for one in self.status().stages]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def instead(name: str, error: Exception) -> tuple[Stage, ...]:
    def fail(context: Context) -> Outputs:
        raise error

    return tuple(replace(stage, function=fail) if stage.name == name else stage for stage in STAGES)


def test_nothing_done_and_nothing_written(bench: Bench) -> None:
    assert bench.states() == ["missing", *["waiting"] * (len(STAGES) - 1)]
    assert not bench.status().done
    assert not bench.out.exists()


def test_all_done(bench: Bench) -> None:
    bench.run()
    found = bench.status()
    assert found.done
    assert not found.running
    assert {one.why for one in found.stages} == {""}


def test_stale_stages_and_their_reasons(bench: Bench) -> None:
    bench.run()
    bench.recording.write_text("1\n2\n4\n")
    first, *rest = bench.status().stages
    assert (first.state, first.why) == ("stale", "recording.markers has changed")
    assert {one.state for one in rest} == {"waiting"}


def test_another_version_of_a_stage(bench: Bench) -> None:
    bench.run()
    newer = (replace(STAGES[0], version=STAGES[0].version + 1), *STAGES[1:])
    assert "made by version" in bench.status(newer).stages[0].why


def test_a_damaged_file_is_reported(bench: Bench) -> None:
    bench.run()
    file = bench.out / STAGES[0].outputs[0]
    file.write_bytes(file.read_bytes()[:-20])
    assert bench.status().stages[0].state == "damaged"


def test_a_refused_trial_counts_as_done(bench: Bench) -> None:
    refusing = instead(NAMES[1], Refused("no-chain", "no chain"))
    bench.run(refusing)
    found = bench.status(refusing)
    assert [one.state for one in found.stages] == ["done", *["refused"] * (len(STAGES) - 1)]
    assert found.stages[1].why == "no chain"
    assert found.done


def test_the_failure_of_the_last_run(bench: Bench) -> None:
    with pytest.raises(NumericalError):
        bench.run(instead(NAMES[1], NumericalError("singular")))
    found = bench.status()
    assert found.failure == "NumericalError: singular"
    assert [one.state for one in found.stages][:2] == ["done", "missing"]
    bench.run()
    assert bench.status().failure is None


def test_a_running_run(bench: Bench) -> None:
    bench.run()
    with Folder(bench.out).locked():
        assert bench.status().running
        with pytest.raises(StoreError, match="in use by another run"):
            clean(load(bench.file, STAGES), None, STAGES)
    assert not bench.status().running


def test_a_lock_that_may_not_be_opened_is_no_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.run()

    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(FileLock, "acquire", refused)
    assert not bench.status().running


def test_clean_deletes_everything_except_foreign_files(bench: Bench) -> None:
    bench.run()
    clean(load(bench.file, STAGES), None, STAGES)
    assert not bench.out.exists()
    bench.run()
    (bench.out / "notes.txt").write_text("mine")
    clean(load(bench.file, STAGES), None, STAGES)
    assert [path.name for path in bench.out.iterdir()] == ["notes.txt"]
    assert bench.recording.exists()
    clean(load(bench.file, STAGES), None, STAGES)


def test_clean_keeps_the_outputs_of_earlier_stages(bench: Bench) -> None:
    bench.run()
    clean(load(bench.file, STAGES), NAMES[1], STAGES)
    assert bench.states()[:2] == ["done", "missing"]
