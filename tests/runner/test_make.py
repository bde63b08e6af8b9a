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

ROOT = Path(__file__).resolve().parents[2]

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


def call(command: list[str], folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command as no child of another make."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    environment = inherited | variables
    return subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)


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
        return call(command, self.folder).returncode

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


def test_a_newer_file_with_the_same_content_is_checked_once(workshop: Workshop) -> None:
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


@pytest.mark.slow
def test_the_real_stages_by_make_leave_nothing_to_run(tmp_path: Path) -> None:
    """The commands of all stages, called by make, give the same as one run."""
    shutil.copytree(ROOT / "sample_trials" / "robot-joint", tmp_path / "trial", ignore=shutil.ignore_patterns("runs"))
    file = tmp_path / "trial" / "trial.yaml"
    (tmp_path / "rules.mk").write_text(make_rules([load(file)], "$(MOCAP_ID)"))
    program = f"MOCAP_ID={sys.executable} -m mocap_id_cli"
    made = call(["make", "-f", "rules.mk", program, "all"], tmp_path)
    assert made.returncode == 0, made.stderr
    assert call(["make", "-q", "-f", "rules.mk", program, "all"], tmp_path).returncode == 0
    outcome = run(load(file))
    assert actions(outcome) == {"reused"}
    assert outcome.summary()["segments"]["count"] == 2


def executable(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def test_any_later_python_will_do(tmp_path: Path) -> None:
    """The first on the path is too old, the next one is younger than this test."""
    executable(tmp_path / "python3", "exit 1")
    executable(tmp_path / "python3.27", f'exec {sys.executable} "$@"')
    make = shutil.which("make")
    assert make is not None
    said = call([make, "-n", "require-python"], ROOT, PATH=str(tmp_path))
    assert "test -n 'python3.27'" in said.stdout
    (tmp_path / "python3.27").unlink()
    assert "test -n ''" in call([make, "-n", "require-python"], ROOT, PATH=str(tmp_path)).stdout


@pytest.mark.parametrize(("without", "code"), [("", 1), ("0", 1), ("1", 0)])
def test_continuous_integration_does_not_pass_by_skipping(tmp_path: Path, without: str, code: int) -> None:
    executable(tmp_path / "make", 'echo "make $*"')
    for program in ("chromium", "chromedriver"):
        executable(tmp_path / program, "exit 0")  # installed as far as it can see
    said = call(
        [str(ROOT / ".ci" / "run")],
        tmp_path,
        PATH=f"{tmp_path}:{os.environ['PATH']}",
        MOCAP_ID_RECORDINGS=str(tmp_path / "nowhere"),
        MOCAP_ID_WITHOUT_RECORDINGS=without,
    )
    assert said.returncode == code
    assert said.stdout == ("make opensim\nmake test\nmake test-slow\n" if code == 0 else "")
    assert ("no recordings at" in said.stderr) is (code != 0)


def test_a_calibration_is_made_by_its_own_rule(tmp_path: Path) -> None:
    """Its chain, named from the folder of another trial, is the target of the calibration's rule."""
    samples = Path(__file__).resolve().parents[2] / "sample_trials"
    for name in ("arm-reach", "curl"):
        shutil.copytree(samples / name, tmp_path / name, ignore=shutil.ignore_patterns("runs"))
    rules = make_rules([load(tmp_path / name / "trial.yaml") for name in ("arm-reach", "curl")], "mocap-id")
    chain = str(tmp_path / "arm-reach" / "runs" / "arm-reach" / "chain")
    assert f"{chain}%h5:" in rules
    assert f"{chain}.h5" in rules
    assert "/../" not in rules
