"""All commands of docs/reach.md, on small simulated recordings of a depth camera and of markers."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest
from typed_commands import Terminal, blocks_of, run_page

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reach.md"


def record(terminal: Terminal) -> None:
    """Make the folders of recordings with which the page begins."""
    short = "--sessions 1 --cycles 1 --seed 6"
    terminal.type(f"mocap-id simulate reach-cohort simulated --subjects 2 --skeletons {short}")
    for subject, name in (("s01", "anna"), ("s02", "bob")):
        shutil.copytree(Path("simulated") / subject, Path("camera") / name)
    terminal.type(f"mocap-id simulate reach-cohort filmed --subjects 1 {short}")
    (Path("markers") / "anna" / "session1").mkdir(parents=True)
    shutil.copy("filmed/s01/session1/right.c3d", "markers/anna/session1")


def fill_in() -> None:
    """Make the change of the study's file that the page describes."""
    (people,) = (text for text in blocks_of(PAGE, "yaml") if text.startswith("subjects:"))
    file = Path("study.yaml")
    text = file.read_text("utf-8")
    for line in people.splitlines()[1:]:
        subject = line.split(":")[0]
        assert f"{subject}: {{}}\n" in text
        text = text.replace(f"{subject}: {{}}\n", f"{line}\n")
    file.write_text(text, "utf-8")


@pytest.mark.slow
def test_the_page_leads_from_camera_logs_to_the_table(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocap_id_simulation.arm_files.POINTS", 2**8)  # the true volumes are not needed
    record(terminal)
    said = run_page(PAGE, terminal, {"mocap-id init camera": fill_in})
    assert "4 of 4 trials have results" in said["mocap-id study study.yaml"][0]
    assert "1 of 1 trials have results" in said["mocap-id study markers/study.yaml"][0]
    (script,) = blocks_of(PAGE, "python")
    exec(compile(script, PAGE.name, "exec"), {})
    trials = pd.read_parquet("runs/study/trials.parquet")
    people = pd.read_parquet("runs/study/people.parquet")
    assert people["score"].tolist()[1:] == [5.0]
    assert Path("runs/study/cohort.html").is_file()
    assert trials["volume"].notna().all(), trials["why"].tolist()
