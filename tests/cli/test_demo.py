"""``mocap-id demo`` in an empty folder, with and without a browser."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_demo_makes_a_trial_and_opens_its_report(
    cli: Callable[..., Any], empty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    said = cli("demo")
    assert said.code == 0
    assert said.out.splitlines() == [
        f"trial: {Path('mocap-id-demo', 'trial.yaml')}",
        "verdict: ok",
        f"report: {Path('mocap-id-demo', 'runs', 'mocap-id-demo', 'report.html')}",
    ]
    report = empty / "mocap-id-demo" / "runs" / "mocap-id-demo" / "report.html"
    assert opened == [report.as_uri()]
    truth = json.loads((empty / "mocap-id-demo" / "truth.json").read_text())
    lengths = json.loads((report.parent / "summary.json").read_text())["lengths_m"]
    for name in truth["lengths_scored"]:
        assert abs(lengths[name]["value"] - truth["segment_lengths_m"][name]) < 3 * lengths[name]["sd"], name
    before = report.stat().st_mtime_ns
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    again = cli("demo")
    assert (again.code, again.out) == (0, said.out)
    assert "no browser could be opened: open the report yourself" in again.err
    assert report.stat().st_mtime_ns == before, "the results are reused"
    assert cli("demo", "--no-open", "--quiet").err == ""
    assert opened == [report.as_uri()]


def test_a_folder_that_cannot_be_used(cli: Callable[..., Any], empty: Path) -> None:
    (empty / "notes").write_text("not a folder")
    said = cli("demo", "notes", "--no-open")
    assert (said.code, said.out) == (6, "")
    assert "notes" in said.err
