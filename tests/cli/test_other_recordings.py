"""Two people with recordings of one name: no command replaces the results of one by those of the other."""

from __future__ import annotations

import json
import shutil
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import mocap_id
from mocap_id.plain_files import suggest
from mocap_id.recording.writer import write_trc
from mocap_id.reporting.results import CommandResult
from mocap_id.workflows.recording_trial import make_trial
from mocap_id.workflows.run_folder import describe_sources
from swinging_link import LABELS, RATE, pendulum

RUN = ("--protocol", "free", "--space", "plane", "-q")


@pytest.fixture
def lab(once: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with recordings of two people and the results of both."""

    def make(folder: Path) -> Path:
        for person, swing in (("p1", 30.0), ("p2", 40.0)):
            (folder / person).mkdir()
            write_trc(folder / person / "sts.trc", LABELS, pendulum(swing_deg=swing), RATE)
        with monkeypatch.context() as patch:
            patch.chdir(folder)
            for person in ("p1", "p2"):
                mocap_id.run(f"{person}/sts.trc", protocol="free", space="plane")
        return folder

    folder = tmp_path / "lab"
    shutil.copytree(once("lab-of-two", make), folder)
    monkeypatch.chdir(folder)
    return folder


def recording_of(run: Path) -> Path:
    """The recording that the results in a folder are made from, by the angle it swings through."""
    swing = float(np.ptp(pd.read_parquet(run / "states.parquet")["theta_1"]))
    return Path("p1" if swing < np.radians(70) else "p2", "sts.trc")


def test_the_default_name_tells_recordings_apart(lab: Path, cli: Callable[..., Any]) -> None:
    assert sorted(path.name for path in (lab / "runs").iterdir()) == ["p2-sts", "sts"]
    assert recording_of(lab / "runs" / "sts") == Path("p1", "sts.trc")
    assert recording_of(lab / "runs" / "p2-sts") == Path("p2", "sts.trc")
    for person, name in (("p1", "sts"), ("p2", "p2-sts"), ("p1", "sts")):
        again = cli("run", f"{person}/sts.trc", "--protocol", "free", "--space", "plane")
        assert again.err.count("reused") == 6, "a moved tree, and any order"
        assert again.out.endswith(f"report: {Path('runs', name, 'report.html')}\n")
    shutil.rmtree(lab / "runs" / "sts")
    assert cli("run", "p2/sts.trc", *RUN).out.endswith(f"{Path('runs', 'p2-sts', 'report.html')}\n")
    write_trc(lab / "p2" / "sts.trc", LABELS, pendulum(swing_deg=41.0), RATE)
    assert cli("run", "p2/sts.trc", *RUN).out.endswith(f"{Path('runs', 'p2-sts', 'report.html')}\n")
    assert not (lab / "runs" / "sts").exists()


def test_a_second_format_of_a_recording_has_its_own_results(lab: Path) -> None:
    shutil.copy(lab / "p2" / "sts.trc", lab / "p1" / "sts.tsv")
    assert make_trial(Path("p1/sts.tsv"), {"protocol": "free", "space": "plane"}).out.name == "p1-sts"


def test_folders_that_are_links_to_one_disk_stay_apart(
    lab: Path, cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    (lab / "disk").mkdir()
    for person in ("p1", "p2"):
        (lab / person / "runs").symlink_to(Path("..", "disk"), target_is_directory=True)
    for person, name in (("p1", "sts"), ("p2", "p2-sts"), ("p1", "sts")):
        monkeypatch.chdir(lab / person)
        assert cli("run", "sts.trc", *RUN).code == 0
        assert recording_of(lab / "disk" / name) == Path(person, "sts.trc")


@pytest.mark.parametrize("option", ["--out", "--save"])
def test_a_folder_or_file_of_another_recording_is_refused(lab: Path, cli: Callable[..., Any], option: str) -> None:
    target = "runs/sts" if option == "--out" else "saved.yaml"
    if option == "--save":
        assert cli("run", "p1/sts.trc", *RUN, "--save", target).code == 0
    before = {path: path.read_bytes() for path in lab.rglob("*") if path.is_file()}
    said = cli("run", "p2/sts.trc", *RUN, option, target)
    assert said.code == 6
    assert str(Path("p1", "sts.trc")) in said.err
    assert str(Path("p2", "sts.trc")) in said.err
    assert before == {path: path.read_bytes() for path in lab.rglob("*") if path.is_file()}
    assert cli("run", "p1/sts.trc", *RUN, option, target).code == 0


def test_two_saved_files_have_separate_results(lab: Path, cli: Callable[..., Any]) -> None:
    shutil.rmtree(lab / "runs")
    for person in ("p1", "p2"):
        assert cli("run", f"{person}/sts.trc", *RUN, "--save", f"{person}.yaml").code == 0
    for person in ("p1", "p2"):
        assert cli("run", f"{person}.yaml", "-q").code == 0
        assert recording_of(mocap_id.config.load(lab / f"{person}.yaml").out) == Path(person, "sts.trc")


def test_arrays_of_two_people_have_separate_results(lab: Path) -> None:
    first, second = (mocap_id.read(f"{person}/sts.trc") for person in ("p1", "p2"))
    keys = {"protocol": "free", "space": "plane"}
    made = [make_trial(replace(one, files=()), keys) for one in (first, second, first, second)]
    assert made[0].out == made[2].out == lab / "runs" / "arrays"
    assert made[1].out == made[3].out
    assert made[1].out.name.startswith("arrays-")
    kept = mocap_id.read(made[0].out / "recording.c3d").positions
    np.testing.assert_allclose(kept, first.positions, atol=1e-5)
    changed = [make_trial(replace(one, files=()), {"trial": "own", **keys}).out for one in (first, second)]
    assert changed[0] == changed[1], "under a name that the user gives, arrays may change"


def test_outputs_of_another_trial_are_refused(lab: Path, cli: Callable[..., Any]) -> None:
    first, second = "runs/sts", "runs/p2-sts"
    for command in (
        ("figures", "{}", "--out", "paper"),
        ("compare", "{}", "runs/sts", "--all", "--out", "table.csv"),
    ):
        for _ in range(2):
            assert cli(*(part.format(first) for part in command)).code == 0
        before = {path: path.read_bytes() for path in lab.rglob("*") if path.is_file()}
        said = cli(*(part.format(second) for part in command))
        assert said.code == 6, command
        assert "p2-sts" in said.err
        assert before == {path: path.read_bytes() for path in lab.rglob("*") if path.is_file()}


def test_the_document_of_another_trial_is_refused(lab: Path) -> None:
    def write(source: str) -> None:
        sources = describe_sources(lab / "out", Path(source))
        CommandResult("workspace", "workspace.json", {}, made_from=sources).write(lab / "out")

    for _ in range(2):
        write("runs/sts")
    with pytest.raises(mocap_id.StoreError, match=r"the results of sts\. The results of p2-sts"):
        write("runs/p2-sts")
    shutil.move(lab / "runs" / "sts", lab / "elsewhere")
    write("elsewhere")
    shutil.copytree(lab / "runs" / "p2-sts", lab / "elsewhere", dirs_exist_ok=True)
    write("elsewhere")


def test_exported_files_of_another_trial_are_refused(lab: Path, cli: Callable[..., Any]) -> None:
    (lab / "sts.yaml").write_text(json.dumps({"trial": "sts", "recording": "p2/sts.trc", "out": "other"}))
    for options in ((), ("--force",)):
        assert cli("export", "runs/sts", "--to", "trc", "--out", "exports", *options).code == 0
    assert cli("export", "runs/sts", "--to", "csv", "--out", "exports").code == 0
    assert cli("export", "runs/p2-sts", "--to", "trc", "--out", "exports").code == 0, "the names differ"
    before = {path: path.read_bytes() for path in (lab / "exports").rglob("*") if path.is_file()}
    for options in (("trc",), ("mot",), ("trc", "--force")):
        said = cli("export", "sts.yaml", "--out", "exports", "-q", "--to", *options)
        assert said.code == 6
        assert f"contains the results of `sts` ({Path('runs', 'sts')})" in said.err
        assert "The results of `sts` (other)" in said.err
    assert before == {path: path.read_bytes() for path in (lab / "exports").rglob("*") if path.is_file()}


def test_a_demo_or_simulation_never_takes_the_folder_of_a_trial(lab: Path, cli: Callable[..., Any]) -> None:
    (lab / "p1" / "trial.yaml").write_text("trial: mine\nrecording: sts.trc\n")
    for command in (("demo", "p1", "--no-open"), ("simulate", "sit-to-stand", "p1")):
        said = cli(*command)
        assert said.code == 6
        assert "contains" in said.err
    assert (lab / "p1" / "trial.yaml").read_text() == "trial: mine\nrecording: sts.trc\n"
    assert sorted(path.name for path in (lab / "p1").iterdir()) == ["sts.trc", "trial.yaml"]


def test_the_table_of_another_batch_is_refused(lab: Path, cli: Callable[..., Any]) -> None:
    assert cli("batch", "runs/sts", "-q").code == 0
    assert cli("batch", "runs", "-q").code == 0, "with more trials"
    assert cli("batch", "runs/sts", "-q").code == 0
    said = cli("batch", "runs/p2-sts", "-q")
    assert said.code == 6
    assert "sts" in said.err
    assert "p2-sts" in said.err
    for person in ("p1", "p2", "p3"):
        (lab / person).mkdir(exist_ok=True)
        source = f"../{'p1' if person == 'p3' else person}/sts.trc"
        (lab / person / "own.yaml").write_text(json.dumps({"trial": "sts", "recording": source}))
    (lab / "p2" / "wrong.yaml").write_text("trial: sts\nrecording: missing\nout: [1]\n")
    for folders, code in (("p1 p2", 0), ("p1", 0), ("p1 p2", 0), ("p2", 0), ("p2", 0), ("p3", 6)):
        said = cli("batch", *(f"{name}/own.yaml" for name in folders.split()), "-q", "--out", "people.parquet")
        assert said.code == code, folders
    assert f"other trials ({Path('p2', 'own.yaml')})" in said.err
    assert f"this batch ({Path('p3', 'own.yaml')})" in said.err
    for _ in range(2):
        assert cli("batch", "p2", "-q", "--out", "unreadable.parquet").code == 1, "one trial has no folder"
    (lab / "own.parquet").write_bytes(b"other data")
    assert cli("batch", "runs/sts", "-q", "--out", "own.parquet").code == 6
    assert (lab / "own.parquet").read_bytes() == b"other data"


def test_status_lists_runs_of_yaml_files_and_counts_refusals(lab: Path, cli: Callable[..., Any]) -> None:
    write_trc(lab / "still.trc", LABELS, pendulum(swing_deg=0.0), RATE)
    (lab / "still.yaml").write_text("trial: still\nrecording: still.trc\n")
    assert cli("run", "still.yaml", "-q").code == 4
    said = cli("status", "runs")
    assert said.out.splitlines()[-1] == "3 trials: 2 done, 1 refused"
    found = {one["trial"]: (one["done"], one["refused"]) for one in json.loads(cli("status", "runs", "--json").out)}
    assert found == {"sts": (True, False), "p2-sts": (True, False), "still": (False, True)}


def test_forces_beside_a_recording_are_named(lab: Path, cli: Callable[..., Any]) -> None:
    head = "nRows=3\nnColumns=2\nendheader\ntime\t{}\n0\t1\n0.01\t1\n0.02\t1\n"
    (lab / "p1" / "sts.mot").write_text(head.format("knee_angle"))
    assert "sts.mot" not in cli("inspect", "p1/sts.trc").out, "joint angles, no forces"
    columns = "\t".join(f"ground_force_{what}{axis}" for what in "vp" for axis in "xyz")
    rows = "".join(f"{k / RATE:.4f}\t0\t700\t0\t0\t0\t0\n" for k in range(len(pendulum())))
    table = f"nRows={len(pendulum())}\nnColumns=7\nendheader\ntime\t{columns}\n{rows}"
    (lab / "p1" / "sts_grf.mot").write_text(table)
    assert "the forces are from sts_grf.mot" in cli("inspect", "p1/sts.trc").out
    assert "sts_grf.mot" in cli("run", "p1/sts.trc", "--protocol", "free", "--space", "plane", "--out", "o").err


def test_inspect_reads_skeletons(tmp_path: Path, cli: Callable[..., Any]) -> None:
    rows = "".join(f"{k / 30:.4f},0.1,1.2,{k / 100}\n" for k in range(40))
    (tmp_path / "kinect.csv").write_text(f"time_s,Neck_x,Neck_y,Neck_z\n{rows}")
    said = cli("inspect", tmp_path / "kinect.csv", "--json")
    assert said.code == 0
    assert json.loads(said.out)["markers"] == ["Neck"]
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    said = cli("inspect", tmp_path / "table.csv")
    assert said.code == 3
    assert "neither a QTM TSV" in said.err
    assert "As a skeleton it cannot be read either" in said.err


def test_a_missing_file_with_a_similar_name_is_suggested(lab: Path, cli: Callable[..., Any]) -> None:
    composed, decomposed = (unicodedata.normalize(form, "Müller.trc") for form in ("NFC", "NFD"))
    shutil.copy("p1/sts.trc", decomposed)
    for named, hint in (
        ("p1/STS.TRC", f"there is {Path('p1', 'sts.trc')}: this system distinguishes capital and small letters"),
        ("P1/sts.trc", f"there is {Path('p1', 'sts.trc')}"),
        ("p1\\sts.trc", f"there is {Path('p1', 'sts.trc')}: write its path with / instead of \\"),
        ("p1\\STS.trc", f"there is {Path('p1', 'sts.trc')}"),
        (composed, f"there is {decomposed}: the name looks the same"),
    ):
        (lab / "trial.yaml").write_text(json.dumps({"trial": "t", "recording": named}, ensure_ascii=False))
        for command in (("run", named), ("inspect", named), ("run", "trial.yaml")):
            said = cli(*command)
            assert said.code == 3, command
            assert hint in said.err, command
    assert "there is trial.yaml" in cli("run", "Trial.YAML").err
    assert "there is runs/sts" in cli("export", "runs\\sts", "--to", "csv").err
    assert suggest(Path("nothing.c3d")) == suggest(lab / "p1" / "other.trc") == ""
