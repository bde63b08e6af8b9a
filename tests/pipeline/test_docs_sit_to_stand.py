"""All commands of docs/sit-to-stand.md, on a small simulated cohort."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from typed_commands import Terminal, blocks_of, run_page

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sit-to-stand.md"
PEOPLE = {"anna": 21, "bob": 22}
STRATEGIES = ("normal", "dynamic")


def block(kind: str, start: str) -> str:
    """Return the only block of a kind that begins with this text."""
    found = [text for text in blocks_of(PAGE, kind) if text.startswith(start)]
    assert len(found) == 1, found
    return found[0]


def record(terminal: Terminal) -> None:
    """Make the folder of recordings with which the page begins."""
    for name, seed in PEOPLE.items():
        for strategy in STRATEGIES:
            made = Path("simulated") / f"{name}-{strategy}"
            options = f"--seed {seed} --strategy {strategy} --repetitions 2 --rate 100 --analog-rate 100"
            terminal.type(f"mocap-id simulate sit-to-stand {made} {options}")
            target = Path("recordings") / name / f"{strategy}1.c3d"
            target.parent.mkdir(parents=True, exist_ok=True)
            (made / "trial.c3d").rename(target)


def fill_in() -> None:
    """Make the changes of the study's file and of the trial's file that the page describes."""
    file = Path("study.yaml")
    people = block("yaml", "subjects:").splitlines()[1:]
    text = file.read_text("utf-8")
    for line in people:
        subject = line.split(":")[0]
        assert f"{subject}: {{}}\n" in text
        text = text.replace(f"{subject}: {{}}\n", f"{line}\n")
    file.write_text(text, "utf-8")
    Path("study-trial.yaml").write_text(block("yaml", "# study-trial.yaml"), "utf-8")


@pytest.mark.slow
def test_the_page_holds(terminal: Terminal) -> None:
    record(terminal)
    said = run_page(PAGE, terminal, {"mocap-id init recordings": fill_in})
    assert terminal.progress.count("reused") == 6, "the last command finds a trial of the study done"
    _results(said)


def _results(said: dict[str, list[str]]) -> None:
    """Return the results that the page announces."""
    first, again = said["mocap-id study study.yaml"]
    assert first == again
    assert "4 of 4 trials have results" in first
    document = json.loads(said["mocap-id study study.yaml --quiet --json"][0])
    assert [trial["exit_code"] for trial in document["trials"]] == [0] * 4
    tables = re.findall(r"^\| `(\w+)` \|", PAGE.read_text("utf-8"), flags=re.MULTILINE)
    assert tables == list(document["tables"])
    assert Path("runs/study/cohort.html").is_file()
    lengths = pd.read_csv("runs/study/lengths.csv")
    assert set(lengths["reference"]) == {"landmarks", "stature (winter)"}
    assert "s01,anna" in Path("subjects.csv").read_text()
    for file in Path("runs/study").glob("*.[chj]*"):
        assert not re.search(r"anna|bob", file.read_text("utf-8")), file
    (script,) = blocks_of(PAGE, "python")
    exec(compile(script, PAGE.name, "exec"), {})


def test_defaults_of_the_page_are_valid(tmp_path: Path) -> None:
    from mocap_id.config.study import load_study

    file = tmp_path / "study.yaml"
    file.write_text("study: x\n" + block("yaml", "subjects:") + block("yaml", "defaults:"))
    (trial,) = load_study(file).trials
    assert trial.trial.keys.window == (0.5, 31.5)
