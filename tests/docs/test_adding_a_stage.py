"""The steps of docs/adding-a-stage.md and docs/adding-a-number.md, executed in copies of the source tree."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from pages_of_docs import DOCS, ROOT, blocks

PAGE = DOCS / "adding-a-stage.md"


def edit(root: Path, note: str, text: str) -> None:
    """Apply a code block as its preceding comment says: as a new file, or at a place in a file."""
    if note.startswith("file: "):
        target = root / note.removeprefix("file: ")
        assert not target.exists()
        target.write_text(text)
        return
    found = re.fullmatch(r'edit: (\S+) before (".*")', note)
    assert found, note
    target, before = root / found[1], json.loads(found[2])
    old = target.read_text("utf-8")
    assert old.count(before) == 1, f"{before!r} stands {old.count(before)} times in {found[1]}"
    between = "" if before.startswith(" ") else "\n"
    target.write_text(old.replace(before, text + between + before), "utf-8")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the source tree with the page's edits."""
    root = tmp_path_factory.mktemp("tree")
    for part in ("pipeline", "cli", "configs", "docs", "tests/house", "sample_trials/robot-joint"):
        shutil.copytree(ROOT / part, root / part, ignore=shutil.ignore_patterns("runs"))
    for block in blocks(PAGE):
        if block.note.startswith(("file: ", "edit: ")):
            edit(root, block.note, block.text)
    trial = root / "sample_trials" / "robot-joint" / "trial.yaml"
    trial.write_text(trial.read_text("utf-8") + "\nspeeds: {limit: 0.1}\n", "utf-8")
    return root


FOLLOW = """
import json, sys
import pyarrow.parquet as pq
from typer.testing import CliRunner
import test_stages_and_pages as house
from mocap_id.stages import STAGES
from mocap_id_cli.commands import build

said = {}
for command in json.loads(sys.argv[1]):
    result = CliRunner().invoke(build(), command.split())
    assert result.exit_code == 0, (command, result.output, result.exception)
    said[command] = result.stdout
for stage in STAGES:
    house.test_a_stage_reads_what_earlier_ones_wrote(stage)
    house.test_a_stage_says_what_it_is(stage)
house.test_every_artefact_is_written_by_one_stage()
house.test_the_last_stage_is_the_report()
said["metadata"] = pq.read_schema("runs/robot-joint/speeds.parquet").metadata[b"mocap-id.reasons"].decode()
print(json.dumps(said))
"""


@pytest.mark.slow
def test_the_page_leads_to_a_stage_that_runs(tree: Path) -> None:
    shown = [line for block in blocks(PAGE) if block.kind == "console" for line in block.text.splitlines()]
    commands = [line.removeprefix("$ mocap-id ") for line in shown]
    assert commands == ["planarise trial.yaml", "speeds trial.yaml", "schema", "stages"]
    folder = tree / "sample_trials" / "robot-joint"
    rooms = os.pathsep.join(str(tree / room) for room in ("pipeline", "cli", "tests/house"))
    result = subprocess.run(
        [sys.executable, "-c", FOLLOW, json.dumps(commands)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": rooms},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    said = json.loads(result.stdout.splitlines()[-1])
    assert "speeds" in json.loads(said["schema"])["properties"]
    assert "speeds.parquet" in said["stages"]
    assert "marker-fast" in said["metadata"]
    table = pd.read_parquet(folder / "runs" / "robot-joint" / "speeds.parquet")
    assert (table["median"] <= table["fastest"]).all()
    assert (table["fastest"] > 0.1).any()


@pytest.mark.slow
def test_the_two_edits_of_a_number_lead_to_summary_report_and_study(tmp_path: Path) -> None:
    for part in ("pipeline", "cli", "sample_trials/sit-to-stand"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("runs"))
    edits = [block for block in blocks(DOCS / "adding-a-number.md") if block.note.startswith("edit: ")]
    assert len(edits) == 2
    for block in edits:
        edit(tmp_path, block.note, block.text)
    rooms = os.pathsep.join(str(tmp_path / room) for room in ("pipeline", "cli"))

    def python(*words: str) -> str:
        environment = os.environ | {"PYTHONPATH": rooms}
        return subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout

    python("-m", "mocap_id_cli", "run", "sample_trials/sit-to-stand/trial.yaml", "-q")
    results = tmp_path / "sample_trials" / "sit-to-stand" / "runs" / "sit-to-stand"
    five_times = json.loads((results / "summary.json").read_text("utf-8"))["five_times"]
    assert five_times["slowest_cycle_s"] >= five_times["mean_cycle_s"]
    assert "slowest cycle (s)" in (results / "report.html").read_text("utf-8")
    code = (
        "from mocap_id.workflows.study.sit_to_stand import TABLES as t; print(*(c.name for c in t['trials'].columns))"
    )
    assert "slowest_cycle" in python("-c", code).split()
