"""Completion in the shell: commands, options, codes, stages."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.stages import STAGE_HELP

PROGRAM = [sys.executable, "-m", "mocap_id_cli"]


def complete(line: str, shell: str = "bash") -> list[str]:
    """Return what the shell offers at the end of a line."""
    words = {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1), "_TYPER_COMPLETE_ARGS": line}
    environment = os.environ | words | {"_MOCAP_ID_COMPLETE": f"complete_{shell}"}
    if shell == "fish":
        environment["_TYPER_COMPLETE_FISH_ACTION"] = "get-args"
    done = subprocess.run(PROGRAM, env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.split() if shell == "bash" else done.stdout.splitlines()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("mocap-id de", ["demo"]),
        ("mocap-id run --pro", ["--protocol"]),
        ("mocap-id run --protocol r", ["robot-joint", "reach"]),
        ("mocap-id clean --from ", list(STAGE_HELP)),
        ("mocap-id explain segments-", [code for code in sorted(EXPLANATIONS) if code.startswith("segments-")]),
    ],
)
def test_bash(line: str, offered: list[str]) -> None:
    assert complete(line) == offered


def test_zsh_and_fish_show_the_help_too() -> None:
    assert any("demo" in line and "Simulate a sit-to-stand" in line for line in complete("mocap-id de", "zsh"))
    assert any(line.startswith("demo\tSimulate a sit-to-stand") for line in complete("mocap-id de", "fish"))


@pytest.mark.external
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_is_that_of_a_shell(shell: str) -> None:
    """The shell itself reads the script without a mistake."""
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    shown = subprocess.run(
        PROGRAM, env=os.environ | {"_MOCAP_ID_COMPLETE": f"source_{shell}"}, capture_output=True, text=True, check=True
    ).stdout
    assert "mocap-id" in shown
    read = subprocess.run([program, "-n"], input=shown, capture_output=True, text=True, check=False)
    assert (read.returncode, read.stderr) == (0, "")
