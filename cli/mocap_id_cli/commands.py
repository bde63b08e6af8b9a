"""Every command with its one line of help; its module, with all that that needs, is imported when it is called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

from mocap_id.stages import LINEUP


@dataclass(frozen=True)
class Entry:
    """A command that is not loaded yet.

    Parameters
    ----------
    name : str
    help : str
        The first sentence of its own help.
    load : callable
        Gives the function of the command, or the Typer app of a group of commands.
    """

    name: str
    help: str
    load: Callable[[], Any]


def _found(module: str, name: str) -> Any:
    return getattr(import_module(f"mocap_id_cli.{module}"), name)


def _called(module: str, name: str, *arguments: str) -> Any:
    return _found(module, name)(*arguments)


COMMANDS = (
    Entry(
        "run",
        "Run the whole pipeline on a trial; what is up to date is not computed again.",
        partial(_found, "run", "run"),
    ),
    *(Entry(stage, line, partial(_called, "run", "stage_command", stage)) for stage, line in LINEUP.items()),
    Entry(
        "init",
        "Write the file of a study from a folder of recordings: C3D files, or TRC files with their MOT.",
        partial(_found, "init", "init"),
    ),
    Entry(
        "study",
        "Run every trial of a study, then write the cohort's tables and page; what is up to date is reused.",
        partial(_found, "study", "study"),
    ),
    Entry(
        "batch",
        "Run many trials and write one table over them; what is up to date is reused.",
        partial(_found, "batch", "batch"),
    ),
    Entry(
        "regress",
        "Run recorded trials anew and compare every headline number with a baseline.",
        partial(_found, "regress", "regress"),
    ),
    Entry(
        "status",
        "Tell what of the trials is done, what would be computed anew and why, and what failed.",
        partial(_found, "housekeeping", "status"),
    ),
    Entry(
        "clean",
        "Take away what runs have made; recordings, configurations and anybody else's files stay.",
        partial(_found, "housekeeping", "clean"),
    ),
    Entry(
        "transfer",
        "Apply the body identified on one trial to other trials of the same person.",
        partial(_found, "transfer", "transfer"),
    ),
    Entry(
        "compare",
        "Hold two runs against each other: what changed, and by how much.",
        partial(_found, "compare", "compare"),
    ),
    Entry(
        "export",
        "Write a run for OpenSim (trc, mot, sto, osim) or as tables (csv).",
        partial(_found, "export", "export"),
    ),
    Entry(
        "figures",
        "Draw the figures of a report, of a study's page or of a validation's as SVG and PDF, with their captions.",
        partial(_found, "figures", "figures"),
    ),
    Entry(
        "explain",
        "Say what a code of a verdict, an error or an exit code means, how it is judged, and what to do.",
        partial(_found, "explain", "explain"),
    ),
    Entry(
        "doctor",
        "Check this installation: what is needed, what is there, and what to do; exit code 1 where something fails.",
        partial(_found, "doctor", "doctor"),
    ),
    Entry(
        "workspace",
        "Measure what the tip of the chain can reach within the joint limits that were seen: area, or volume in space.",
        partial(_found, "workspace", "workspace"),
    ),
    Entry(
        "prescribe",
        "Find the springs that let a weak person hold most of a joint's, or a chain's, range.",
        partial(_found, "prescribe", "prescribe"),
    ),
    Entry(
        "sensitivity",
        "Perturb a trial in every way that a lab meets, and say what its parameters tolerate (thesis 5.5.2).",
        partial(_found, "sensitivity", "sensitivity"),
    ),
    Entry(
        "advise",
        "Tell which movement would make the parameters of a trial's body better known.",
        partial(_found, "advise", "advise"),
    ),
    Entry(
        "inspect",
        "Print what a recording holds: markers, rates, gaps, force plates, oddities.",
        partial(_found, "inspect", "inspect"),
    ),
    Entry(
        "simulate",
        "Make recordings whose exact truth is known.",
        partial(_called, "simulate", "simulating"),
    ),
    Entry(
        "validate",
        "Repeat the thesis's validation studies.",
        partial(_called, "validate", "validating"),
    ),
    Entry(
        "schema",
        "Print the JSON Schema of a trial's YAML file, for editors.",
        partial(_found, "reference", "schema"),
    ),
    Entry(
        "stages",
        "Print the stages in their order: what each reads and writes.",
        partial(_found, "reference", "stages"),
    ),
)
"""In the order in which ``mocap-id --help`` lists them."""
