"""GNU make and the runner agree about what is up to date."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from toy_stages import STAGES

from mocap_id.config import load
from mocap_id.runner import Outcome, make_rules, run

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")

# The command line of the toy stages: `python toy.py STAGE TRIAL.yaml`, each call noted. The real stages, which take a
# second to import, are left out.
PROGRAM = f"""
import importlib.util, sys, types
from pathlib import Path
package = types.ModuleType("mocap_id.stages")
package.__path__ = importlib.util.find_spec("mocap_id.stages").submodule_search_locations
sys.modules["mocap_id.stages"] = package
from mocap_id.stages.base import Stage
package.STAGES, package.Stage = (), Stage
sys.path.insert(0, {str(Path(__file__).parent)!r})
from toy_stages import STAGES
from mocap_id.config import load
from mocap_id.runner import run_stage
name, file = sys.argv[1:]
with Path("calls").open("a") as calls:
    print(name, file=calls)
run_stage(load(Path(file), STAGES), name, STAGES)
"""


class Workshop:
    """Two trials of the toy stages, and make."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = [folder / name / "trial.yaml" for name in ("one", "two")]
        for file in self.files:
            file.parent.mkdir()
            file.write_text(json.dumps({"trial": "toy", "recording": "numbers.txt"}))
            (file.parent / "numbers.txt").write_text("1\n2\n3\n")
        (folder / "toy.py").write_text(PROGRAM)
        rules = make_rules([load(file, STAGES) for file in self.files], "$(MOCAP_ID)", STAGES)
        (folder / "rules.mk").write_text(rules)

    def make(self, *options: str) -> int:
        command = ["make", "-f", "rules.mk", f"MOCAP_ID={sys.executable} toy.py", *options, "all"]
        environment = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
        result = subprocess.run(command, cwd=self.folder, env=environment, check=False, capture_output=True, text=True)
        return result.returncode

    def calls(self) -> list[str]:
        log = self.folder / "calls"
        calls = log.read_text().split() if log.exists() else []
        log.unlink(missing_ok=True)
        return sorted(calls)

    def run(self, number: int = 0) -> Outcome:
        return run(load(self.files[number], STAGES), STAGES)


def actions(outcome: Outcome) -> set[str]:
    return {step.action for step in outcome.steps}


@pytest.fixture
def workshop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workshop:
    monkeypatch.chdir(tmp_path)
    return Workshop(tmp_path)


def test_after_run_there_is_nothing_to_make(workshop: Workshop) -> None:
    assert workshop.make("-q") == 1
    workshop.run(0)
    workshop.run(1)
    assert workshop.make("-q") == 0


def test_after_make_there_is_nothing_to_run(workshop: Workshop) -> None:
    """And a trial that fails does not keep the other from being made."""
    (workshop.folder / "one/numbers.txt").write_text("no number")
    assert workshop.make("-k", "-j2") == 2
    assert workshop.calls() == ["cut", "read", "read", "tell"]
    assert actions(workshop.run(1)) == {"reused"}
    (workshop.folder / "one/numbers.txt").write_text("1\n2\n3\n")
    workshop.run(0)
    assert workshop.make("-q") == 0


def test_a_younger_file_of_the_same_content_is_looked_at_once(workshop: Workshop) -> None:
    workshop.run(0)
    workshop.run(1)
    workshop.files[0].write_text(workshop.files[0].read_text() + "\n# a remark\n")
    assert workshop.make("-q") == 1
    assert actions(workshop.run(0)) == {"reused"}
    assert workshop.make("-q") == 0


def test_one_of_several_outputs_is_made_again(workshop: Workshop) -> None:
    workshop.run(0)
    workshop.run(1)
    (workshop.folder / "one/runs/toy/report.html").unlink()
    assert workshop.make() == 0
    assert workshop.calls() == ["tell"]
    assert (workshop.folder / "one/runs/toy/report.html").exists()
