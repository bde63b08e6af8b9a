"""Makefile rules for trials, made from the list of stages."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from mocap_id.config import Trial
from mocap_id.errors import ConfigError
from mocap_id.runner.dependencies import find_user_files
from mocap_id.stages import STAGES, Stage


def make_rules(trials: Sequence[Trial], command: str, stages: Sequence[Stage] = STAGES) -> str:
    """Return Makefile rules that make the outputs of the last stage of every trial with the commands of the stages.

    The trials have different run folders; ``command`` calls mocap-id. Raises ConfigError if two trials share a run
    folder, or if a path contains characters that make cannot handle.
    """
    folders: dict[Path, Trial] = {}
    for trial in trials:
        other = folders.setdefault(trial.out.resolve(), trial)
        if other is not trial:
            raise ConfigError(
                f"{trial.file} and {other.file} share the folder {trial.out}: give one of them a different `out:`"
            )
    goals = " ".join(_format_path(trial.out / file) for trial in trials for file in stages[-1].outputs)
    lines = [
        "# Made by `mocap-id stages --make`. `%` replaces the dot of a file name: every version of GNU make runs a",
        "# pattern rule with several targets only once.",
        ".SUFFIXES:",
        ".SECONDARY:",
        ".PHONY: all",
        f"all: {goals}",
    ]
    for trial in trials:
        for stage in stages:
            needed = [trial.file, *find_user_files(trial, stage).values(), *(trial.out / file for file in stage.inputs)]
            targets = " ".join(_format_path(trial.out / file, pattern=True) for file in stage.outputs)
            lines += ["", f"{targets}: {' '.join(_format_path(path) for path in needed)}"]
            lines.append(f"\t{command} {stage.name} {_format_path(trial.file)}")
    return "\n".join(lines) + "\n"


def _format_path(path: Path, *, pattern: bool = False) -> str:
    """Return a path for a Makefile, relative to the working folder if it is inside.

    With ``pattern``, ``%`` replaces the dot of the file name. Raises ConfigError if make cannot handle the path.
    """
    here, plain = Path.cwd(), Path(os.path.normpath(path))  # make compares names: a/../b is not b
    path = plain if plain.resolve() == path.resolve() else path
    text = str(path.relative_to(here) if path.is_relative_to(here) else path)
    if re.search(r"[\s%:#$*?\[\]\\;|&<>()'\"`~=!{}]", text):
        raise ConfigError(f"{text}: make cannot handle blanks or special characters in a path: rename it")
    return re.sub(r"\.(?=[^./]*$)", "%", text) if pattern else text
