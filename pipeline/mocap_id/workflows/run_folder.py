"""A run as it stands on the disk, finished, half-way or refused: for whoever looks at it and does not compute."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store import Artefact, Folder, Held, Provenance
from mocap_id.store.schemas import SCHEMAS

SUMMARY = "summary.json"


@dataclass(frozen=True)
class RunFolder(Held):
    """What a run left.

    Parameters
    ----------
    source : Path
        As given on the command line: a YAML file or a folder.
    path : Path
        The folder.
    artefacts : mapping of str to Table, LongTable or Tree
        By file name; those that were not made are absent.
    provenance : mapping of str to Provenance
        Likewise.
    """

    source: Path
    path: Path
    artefacts: Mapping[str, Artefact]
    provenance: Mapping[str, Provenance]

    @cached_property
    def name(self) -> str:
        """The trial's name."""
        told = (each.origin.parameters.get("trial") for each in self.provenance.values())
        return str(next((name for name in told if name), self.summary.get("trial") or self.path.resolve().name))

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """summary.json; empty where there is none.

        Raises
        ------
        StoreError
            It is no JSON.
        """
        file = self.path / SUMMARY
        try:
            found: Mapping[str, Any] = json.loads(file.read_text("utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise StoreError(f"{file} cannot be read ({error}): delete it and run `mocap-id report` again") from error
        return found

    def why_missing(self, file: str) -> str:
        """Why there is no such artefact."""
        if file in self.artefacts:
            return str(self.facts(file).get("why") or f"{file} does not say why")
        refusals = [
            f"the trial was refused ({reason['code']}) before {file} was made"
            for reason in self.summary.get("verdict", {}).get("reasons", ())
            if reason["level"] == "refused"
        ]
        return refusals[0] if refusals else f"{file} is not in {self.path}"


def open_run(path: Path, progress: runner.Progress = lambda step: None) -> RunFolder:
    """A run by its trial or by its folder.

    Parameters
    ----------
    path : Path
        A YAML file: what is missing or out of date is computed. Or a run folder, which is taken as it is.
    progress : callable, optional
        Told of every stage of a YAML file.

    Raises
    ------
    StoreError
        The folder holds no artefact, a damaged one, or some that were not made from one another.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`. A refusal is none: the folder tells of it.
    """
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder; expected a trial's YAML file or a run folder, runs/<trial>")
    where = path if path.is_dir() else runner.run(load(path), progress=progress).folder
    folder = Folder(where)
    there = [file for file in SCHEMAS if folder.exists(file)]
    if not there:
        raise StoreError(
            f"{where} holds no artefacts of a run: expected a trial's YAML file or a run folder such as runs/<trial>"
        )
    found = RunFolder(
        path, where, {file: folder.read(file) for file in there}, {file: folder.provenance(file) for file in there}
    )
    check_origins(where, found.provenance)
    return found


def check_origins(where: Path, provenance: Mapping[str, Provenance]) -> None:
    """StoreError where artefacts of a folder were not made from one another: someone changed a part of a run."""
    for file, about in provenance.items():
        for needed, key in about.origin.inputs.items():
            if needed in provenance and provenance[needed].origin.key != key:
                raise StoreError(
                    f"{where / file} was made from another {needed} than the one beside it: run the trial again "
                    "(`mocap-id run TRIAL.yaml`)"
                )
