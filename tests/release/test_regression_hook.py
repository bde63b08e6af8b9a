"""The hook and the templates of ``configs/ci``: a repository whose commits are compared with a baseline."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from mocap_id.workflows.parallel import LocalBackend
from mocap_id.workflows.regress import Baseline, update
from mocap_id_simulation import Options, simulate

ROOT = Path(__file__).resolve().parents[2]
CI = ROOT / "configs" / "ci"
COMMAND = "mocap-id regress trials --baseline trials/baseline.json"


class Repository:
    """A repository of git with the trials of a laboratory, and the hook."""

    def __init__(self, folder: Path, program: Path) -> None:
        self.folder = folder
        kept = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
        identity = {
            f"GIT_{who}_{what}": "lab@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
        }
        nothing = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
        self._environment = kept | identity | nothing | {"MOCAP_ID": str(program)}
        self.git("init", "--quiet")
        shutil.copy(CI / "pre-commit", folder / ".git" / "hooks" / "pre-commit")

    def git(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["git", *arguments], cwd=self.folder, env=self._environment, capture_output=True, text=True, check=False
        )

    def commit(self, message: str) -> subprocess.CompletedProcess[str]:
        self.git("add", "--all")
        return self.git("commit", "--message", message)

    @property
    def commits(self) -> list[str]:
        return self.git("log", "--format=%s").stdout.splitlines()


def _trial(folder: Path) -> Path:
    """Simulate a short trial and write its baseline."""
    simulate("robot", folder / "joint", Options(seed=3, repetitions=2, rate=100.0, analog_rate=500.0))
    update([str(folder)], Baseline(), LocalBackend()).write(folder / "baseline.json")
    return folder


@pytest.fixture
def repository(once: Callable[..., Any], tmp_path: Path) -> Repository:
    program = tmp_path / "mocap-id"
    program.write_text(f'#!/bin/sh\necho called >> "{tmp_path}/calls"\nexec "{sys.executable}" -m mocap_id_cli "$@"\n')
    program.chmod(0o755)
    folder = tmp_path / "lab"
    shutil.copytree(once("trial-with-baseline", _trial), folder / "trials")
    return Repository(folder, program)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="the hook is a shell script")
def test_a_commit_that_moves_a_number_is_refused_and_the_number_is_named(repository: Repository) -> None:
    calls = repository.folder.parent / "calls"
    first = repository.commit("trials and baseline")
    assert first.returncode == 0, first.stderr
    assert calls.read_text().count("called") == 1

    (repository.folder / "notes.txt").write_text("Recorded in May.\n")
    assert repository.commit("notes").returncode == 0
    assert calls.read_text().count("called") == 1, "no trial is in this commit, so none is run"

    trial = repository.folder / "trials" / "joint" / "trial.yaml"
    before = trial.read_text()
    trial.write_text(before + "identify-dim: {clock_offset_limit_s: 0.01}\n")
    repository.git("add", "--all")
    trial.write_text(before)  # what counts is what would be committed
    refused = repository.git("commit", "--message", "a typing error")
    assert refused.returncode == 1
    moved = re.findall(r"^joint +(\S+) ", refused.stdout + refused.stderr, flags=re.MULTILINE)
    assert moved == ["dynamics.samples"]
    assert "commit refused" in refused.stderr
    assert repository.commits == ["notes", "trials and baseline"]
    assert list(repository.folder.rglob("runs")) == []


def test_the_templates_run_the_same_command() -> None:
    github, gitlab, framework = (
        YAML(typ="safe").load((CI / name).read_text("utf-8"))
        for name in ("github-workflow.yml", "gitlab-ci.yml", "pre-commit-config.yaml")
    )
    steps = [step.get("run", "") for step in github["jobs"]["regress"]["steps"]]
    assert steps[-1] == gitlab["trials"]["script"][-1] == f"{COMMAND} --jobs 2"
    (hook,) = framework["repos"][0]["hooks"]
    assert hook["entry"] == f"{COMMAND} --quiet"
    for name, watched in (("trials/baseline.json", True), ("requirements.txt", True), ("notes.txt", False)):
        assert bool(re.search(hook["files"], name)) == watched


def test_the_page_shows_the_templates_as_they_are() -> None:
    """Readers who installed the wheel have no folder ``configs``."""
    page = (ROOT / "docs" / "regression-in-ci.md").read_text("utf-8")
    for file in CI.iterdir():
        assert f"\n{file.read_text('utf-8')}```\n" in page, file.name
