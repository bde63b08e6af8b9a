"""docs/adding-a-stage.md, followed to the letter in a copy of the source tree."""

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
    """What the remark before a block says: a new file, or where in a file it goes."""
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
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("tree")
    leave = shutil.ignore_patterns("__pycache__", "runs")
    for part in ("pipeline", "cli", "configs", "docs", "tests/house", "sample_trials/robot-joint"):
        shutil.copytree(ROOT / part, root / part, ignore=leave)
    shutil.copy(ROOT / "pyproject.toml", root)
    for block in blocks(PAGE):
        if block.kind == "python":
            edit(root, block.note, block.text)
    return root


def python(root: Path, *arguments: str) -> str:
    """Standard output of Python in the copied tree."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root / "pipeline"), str(root / "cli")])}
    result = subprocess.run(
        [sys.executable, *arguments], cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr + result.stdout
    return result.stdout


def test_the_new_stage_is_a_command(copy: Path) -> None:
    trial = copy / "sample_trials" / "robot-joint" / "trial.yaml"
    trial.write_text(trial.read_text() + "\nspeeds: {limit: 0.1}\n")
    commands = [line.removeprefix("$ mocap-id ") for block in blocks(PAGE) for line in block.text.splitlines()
                if block.kind == "console"]  # fmt: skip
    assert commands[0] == "speeds trial.yaml"
    python(copy, "-m", "mocap_id_cli", "planarise", str(trial))
    said = [python(copy, "-m", "mocap_id_cli", *command.replace("trial.yaml", str(trial)).split()) for command in commands]
    out = trial.parent / "runs" / "robot-joint"
    table = pd.read_parquet(out / "speeds.parquet")
    assert (table["median"] <= table["fastest"]).all()
    assert (table["fastest"] > 0.1).any()
    assert "speeds" in json.loads(said[1])["properties"]
    assert "speeds.parquet" in said[2]
    assert "marker-fast" in python(copy, "-c", f"import pyarrow.parquet as q; print(q.read_schema({str(out / 'speeds.parquet')!r}).metadata)")


def test_the_house_finds_it_in_order(copy: Path) -> None:
    chosen = "reads_what_earlier or says_what_it_is or written_by_one_stage or last_stage"
    said = python(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/house/test_stages_and_pages.py", "-k", chosen)
    assert re.search(r"\b16 passed", said), said
