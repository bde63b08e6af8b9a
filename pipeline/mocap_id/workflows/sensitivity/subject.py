"""The trial that is perturbed: its artefacts, keys and settings, read once and never written to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import ConfigError, StoreError
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings, Subject, TrialKeys
from mocap_id.store import Artefact, Folder, LongTable, Table, Tree, dumps
from mocap_id.workflows.run_folder import check_origins

FIRST, LAST = "fit-joints", "identify-dim"


@dataclass(frozen=True)
class Source:
    """Where a trial's artefacts stand and how its stages are set.

    Parameters
    ----------
    name : str
    folder : Path
        The run folder.
    keys : TrialKeys
        Without what only the report's comparison with other systems needs.
    settings : mapping of str to Settings
        Of the stages that are run again.
    """

    name: str
    folder: Path
    keys: TrialKeys
    settings: Mapping[str, Settings]


@dataclass(frozen=True)
class Perturbed:
    """The inputs of the stages that are run again: those of the trial, or changed ones.

    Parameters
    ----------
    source : Source
    artefacts : mapping of str to Table or Tree
        By file name.
    settings : mapping of str to Settings
        By stage.
    """

    source: Source
    artefacts: Mapping[str, Artefact]
    settings: Mapping[str, Settings]

    def table(self, file: str) -> Table:
        """A Parquet artefact."""
        return cast(Table, self.artefacts[file])

    def long(self, file: str) -> LongTable:
        """A Parquet artefact with a row for every frame and marker."""
        return cast(LongTable, self.artefacts[file])

    def tree(self, file: str) -> Tree:
        """An HDF5 artefact."""
        return cast(Tree, self.artefacts[file])

    def node(self, file: str, group: str, name: str) -> np.ndarray[Any, Any]:
        """An array of an HDF5 artefact."""
        found: Any = self.tree(file).data[group]
        return np.asarray(found[name])

    def having(self, *changed: Artefact) -> Perturbed:
        """The same with other artefacts."""
        return replace(self, artefacts={**self.artefacts, **{one.schema.file: one for one in changed}})

    def set_to(self, stage: str, **values: object) -> Perturbed:
        """The same with other settings of a stage."""
        changed = self.settings[stage].model_copy(update=values)
        return replace(self, settings={**self.settings, stage: changed})

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(map(str, self.node("chain.h5", "joints", "name")))

    def states(self, name: str) -> FloatArray:
        """A state of every joint, (T, n)."""
        return self.table("states.parquet").stack([f"{name}_{j}" for j in range(1, len(self.joints) + 1)])

    @property
    def has_plate(self) -> bool:
        """Whether any sample of the wrench is known."""
        return bool(np.isfinite(self.table("wrench.parquet")["Fy"]).any())


def again() -> tuple[Stage, ...]:
    """The stages that a perturbation runs again, first to last."""
    names = [stage.name for stage in STAGES]
    return STAGES[names.index(FIRST) : names.index(LAST) + 1]


def located(path: Path, progress: runner.Progress = lambda step: None) -> Source:
    """Find a trial's artefacts; what a YAML file asks for and is not there yet is computed first.

    Parameters
    ----------
    path : Path
        The trial's YAML file, or its run folder, which is taken as it is.
    progress : callable, optional
        Told of every stage of a YAML file.

    Raises
    ------
    Refused
        The trial was refused.
    StoreError
        The run folder lacks an artefact or was made by another version of the program.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    if path.is_dir():
        return _of_folder(path)
    trial = load(path)
    outcome = runner.run_to(trial, LAST, progress=progress)
    if outcome.refused is not None:
        raise outcome.refused
    keys = trial.keys.model_copy(update={"compare": None})
    return Source(trial.name, outcome.folder, keys, {stage.name: trial.settings[stage.name] for stage in again()})


def _of_folder(path: Path) -> Source:
    """A run folder's trial, set as its artefacts say that they were made."""
    folder, settings, asked = Folder(path), {}, dict[str, Any]()
    for stage in again():
        origin = folder.provenance(stage.outputs[0]).origin
        if origin.stage_version != stage.version:
            raise StoreError(
                f"{path / stage.outputs[0]} was made by version {origin.stage_version} of {stage.name}, this is "
                f"version {stage.version}: run the trial again (`mocap-id run TRIAL.yaml`)"
            )
        settings[stage.name] = stage.settings.model_validate_json(dumps(origin.parameters[stage.name]), strict=True)
        asked |= origin.parameters
    if getattr(settings["ukf-smooth"], "method", None) == "encoder":
        raise ConfigError(f"{path}: its states come from an encoder's file: give the trial's YAML file instead")
    known = {"trial": asked["trial"], "protocol": asked["protocol"]}  # no stage that is run again reads the recording
    keys = TrialKeys.model_construct(**known, subject=Subject.model_validate(asked["subject"]))
    return Source(str(asked["trial"]), path, keys, settings)


def read(source: Source) -> Perturbed:
    """The unperturbed trial.

    Raises
    ------
    StoreError
        An artefact is missing or damaged, or was made from others than those beside it.
    """
    folder = Folder(source.folder)
    files = {file for stage in again() for file in (*stage.inputs, *stage.outputs)} - {"markers.parquet"}
    check_origins(folder.path, {file: folder.provenance(file) for file in sorted(files)})
    return Perturbed(source, {file: folder.read(file) for file in sorted(files)}, source.settings)
