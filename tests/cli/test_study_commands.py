"""``mocap-id study`` and ``mocap-id init``: exit codes, output and interruption."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mocap_id.recording.writer import write_trc
from mocap_id.store import Folder
from swinging_link import LABELS, RATE, pendulum

ROOT = Path(__file__).resolve().parents[2]
STUDY = """\
study: swings
subjects: {s01: }
trials:
  - {trial: one, subject: s01, strategy: free, recording: rec/anna/free.trc}
  - {trial: two, subject: s01, strategy: free, recording: rec/anna/nowhere.trc}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rec" / "anna").mkdir(parents=True)
    write_trc(tmp_path / "rec" / "anna" / "free.trc", LABELS, pendulum(), RATE)
    (tmp_path / "study.yaml").write_text(STUDY)
    return tmp_path


def test_one_failed_trial_makes_the_exit_code_1(cli, folder: Path) -> None:
    said = cli("study", folder / "study.yaml")
    assert said.code == 1
    lines = said.out.splitlines()
    assert lines[0].startswith("one  caution")
    assert lines[1] == "two  failed (exit code 3)"
    assert "nowhere.trc: no such file" in lines[2]
    assert lines[3] == "1 of 2 trials have results"
    assert [line.split()[-1] for line in said.err.splitlines()][1:] == ["failed"]
    assert (folder / "runs" / "study" / "cohort.html").is_file()


def test_all_well_is_0_and_json_is_all_there_is(cli, folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY.replace("nowhere", "free"))
    said = cli("study", folder / "study.yaml", "--json", "--quiet")
    assert (said.code, said.err) == (0, "")
    document = json.loads(said.out)
    assert document == json.loads((folder / "runs" / "study" / "study.json").read_text())
    assert document["subjects"] == {"s01": ["one", "two"]}


def test_a_wrong_study_writes_nothing(cli, folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY.replace("strategy: free", "stratagem: free", 1))
    said = cli("study", folder / "study.yaml")
    assert (said.code, said.out) == (2, "")
    assert "study.yaml, line 4: `trials[0].strategy` is missing" in said.err
    assert not (folder / "runs").exists()
    assert cli("study", folder / "study.yaml", "--jobs", "0").code == 2


def test_init_shows_before_it_writes(cli, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "study.yaml").unlink()
    shown = cli("init", "rec", "--dry-run")
    assert shown.code == 0
    assert sorted(path.name for path in folder.iterdir()) == ["rec"]
    said = cli("init", "rec")
    assert said.out.splitlines()[:-2] == shown.out.splitlines()[:-1]
    assert said.out.splitlines()[-2:] == ["wrote study.yaml", "wrote subjects.csv"]
    again = cli("init", "rec")
    assert (again.code, "--force" in again.err) == (6, True)
    assert cli("init", "rec", "--force").code == 0
    assert cli("init", "rec", "--pattern", "{who}/*", "--out", "other.yaml").code == 2


def test_init_warns_where_file_names_tell_who_it_is(cli, tmp_path: Path) -> None:
    write_trc(tmp_path / "anna_free_1.trc", LABELS, pendulum(), RATE)
    said = cli("init", tmp_path, "--dry-run")
    assert "note: anna_free_1.trc contains the name of s01" in said.out


@pytest.mark.skipif(os.name == "nt", reason="signals and groups of POSIX")
@pytest.mark.parametrize(
    ("number", "code", "at"),
    [pytest.param(signal.SIGTERM, 143, "work", marks=pytest.mark.slow), (signal.SIGINT, 130, "start")],
)
def test_an_interrupted_study_leaves_no_process_behind(
    tmp_path: Path, number: signal.Signals, code: int, at: str
) -> None:
    recording = ROOT / "sample_trials" / "sit-to-stand" / "trial.c3d"
    trials = "".join(f"  - {{trial: t{k}, subject: s, strategy: x, recording: {recording}}}\n" for k in (1, 2))
    file = tmp_path / "study.yaml"
    file.write_text(f"study: x\nsubjects: {{s: }}\ndefaults: {{protocol: sit-to-stand}}\ntrials:\n{trials}")
    program = [sys.executable, "-m", "mocap_id_cli", "study", str(file), "--jobs", "2"]
    with subprocess.Popen(program, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        first = tmp_path / "runs" / "t1" / "planar.parquet"
        if at == "work":
            _until(first.exists, 60)
        else:
            _until((tmp_path / "runs" / "study").exists, 60)
            time.sleep(0.5)  # while the processes are starting
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does
        else:
            process.send_signal(number)
        assert process.stderr is not None
        err = process.stderr.read()
    assert process.returncode == code
    assert "Traceback" not in err
    assert "interrupted" in err
    _until(lambda: not _alive(process.pid), 20)
    assert [path for path in tmp_path.rglob("*") if ".tmp" in path.name] == []
    if at == "work":
        Folder(first.parent).read(first.name)
    assert not (tmp_path / "runs" / "study" / "study.json").exists()


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _until(condition, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.02)
