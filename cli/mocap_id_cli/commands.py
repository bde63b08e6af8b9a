"""All commands, each with one line of help; the module of a command is imported only when the command is called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

from mocap_id.stages import STAGE_HELP


@dataclass(frozen=True)
class Entry:
    """A command whose module is not imported yet."""

    name: str
    help: str  # the first sentence of its help
    load: Callable[[], Any]  # returns the function of the command, or the Typer app of a group of commands


def _load_function(name: str) -> Any:
    return getattr(import_module(f"mocap_id_cli.{name}"), name)


def _load_group(name: str) -> Any:
    return import_module(f"mocap_id_cli.{name}").commands()


def _load_stage(name: str) -> Any:
    return import_module("mocap_id_cli.run").make_stage_command(name)


_BEFORE_STAGES = {
    "run": "Run the whole pipeline on a trial.",
    "demo": "Simulate a sit-to-stand, run it and open its report.",
}
_AFTER_STAGES = {
    "init": "Write a study file for a folder of recordings.",
    "study": "Run all trials of a study and write its tables and page.",
    "batch": "Run many trials and write one table of their results.",
    "regress": "Recompute trials, and compare their results with a baseline.",
    "status": "Show what is done, what has to be computed, and what failed.",
    "clean": "Delete the results of runs.",
    "transfer": "Apply the body identified from one trial to other trials.",
    "payload": "Identify what a robot carries from two trials in space.",
    "compare": "Compare two runs: show what changed, and by how much.",
    "export": "Write a run as OpenSim files or as tables.",
    "figures": "Draw the figures of a page as SVG and PDF files.",
    "explain": "Explain a verdict's code, an error or an exit code.",
    "doctor": "Check this installation and say how to repair it.",
    "workspace": "Compute what the tip of a chain reaches within its limits.",
    "prescribe": "Find springs that let a weak person hold a wider range.",
    "sensitivity": "Perturb a trial and report which errors it tolerates.",
    "advise": "Propose the movement to record next.",
    "inspect": "Print what a recording contains.",
}
_GROUPS = {
    "simulate": "Simulate recordings whose exact truth is known.",
    "validate": "Repeat the validation studies of the thesis.",
    "pneumatic": "Describe a pneumatic spring, and choose its pressures.",
}
_REFERENCE = {
    "schema": "Print the JSON Schema of a trial's YAML file, for editors.",
    "stages": "List the stages in order, with their inputs and outputs.",
}
_SOURCES: tuple[tuple[dict[str, str], Callable[[str], Any]], ...] = (
    (_BEFORE_STAGES, _load_function),
    (dict(STAGE_HELP), _load_stage),
    (_AFTER_STAGES, _load_function),
    (_GROUPS, _load_group),
    (_REFERENCE, _load_function),
)

COMMANDS = tuple(Entry(name, text, partial(load, name)) for texts, load in _SOURCES for name, text in texts.items())
"""The commands in the order of ``mocap-id --help``."""
