"""The inputs of a sensitivity study: artefacts, keys and settings of the trial; its files are not changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, StoreError
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import Subject, TrialKeys
from mocap_id.store import Artefact, Folder, LongTable, Table, Tree, dumps
from mocap_id.store.views import joint_columns
from mocap_id.workflows.run_folder import check_provenance, open_run_to

FIRST, LAST = "fit-joints", "identify-dim"


@dataclass(frozen=True)
class TrialSource:
    """The run folder of a trial, and the settings of its stages."""

    name: str
    folder: Path  # the run folder
    keys: TrialKeys  # keys of the trial, without the keys for the report's comparison with other systems
    settings: Mapping[str, Settings]  # settings by stage, of the stages that are run again


@dataclass(frozen=True)
class TrialInputs:
    """The inputs of the stages that are run again, unperturbed or perturbed."""

    source: TrialSource
    artefacts: Mapping[str, Artefact]  # artefacts by file name
    settings: Mapping[str, Settings]  # settings by stage

    def table(self, file: str) -> Table:
        """Return a Parquet artefact that has a row for each sample or object."""
        return cast(Table, self.artefacts[file])

    def long(self, file: str) -> LongTable:
        """Return a Parquet artefact that has a row for each pair of frame and marker."""
        return cast(LongTable, self.artefacts[file])

    def tree(self, file: str) -> Tree:
        """Return an HDF5 artefact."""
        return cast(Tree, self.artefacts[file])

    def with_artefacts(self, *changed: Artefact) -> TrialInputs:
        """Return the inputs with the ``changed`` artefacts in place of the artefacts with the same file names."""
        return replace(self, artefacts={**self.artefacts, **{one.schema.file: one for one in changed}})

    def with_settings(self, stage: str, **values: object) -> TrialInputs:
        """Return the inputs with new ``values`` for some settings of a stage."""
        changed = self.settings[stage].model_copy(update=values)
        return replace(self, settings={**self.settings, stage: changed})

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.tree("chain.h5").texts("joints/name")

    @property
    def time(self) -> FloatArray:
        """Times of the states (T,), s."""
        return self.table("states.parquet")["time"]

    def states(self, name: str) -> FloatArray:
        """Return a state (T, n) of all n joints; ``name`` is theta, dtheta or ddtheta."""
        return joint_columns(self.table("states.parquet"), name, len(self.joints))

    @property
    def has_plate(self) -> bool:
        """Whether any sample of the wrench is known."""
        return bool(np.isfinite(self.table("wrench.parquet")["Fy"]).any())


def repeated_stages() -> tuple[Stage, ...]:
    """Return the stages that may be run again, from first to last."""
    names = [stage.name for stage in STAGES]
    return STAGES[names.index(FIRST) : names.index(LAST) + 1]


def locate_trial(path: Path, progress: runner.Progress = lambda step: None) -> TrialSource:
    """Return the run folder and settings of a trial; if ``path`` is a YAML file, missing artefacts are computed first.

    ``path`` and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`.

    Raises
    ------
    Refused
        The trial was refused.
    StoreError
        The run folder lacks an artefact, or was made by a different version of the program.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    folder, trial = open_run_to(path, LAST, progress)
    if trial is None:
        return _read_source(path)
    keys = trial.keys.model_copy(update={"compare": None})
    settings = {stage.name: trial.settings[stage.name] for stage in repeated_stages()}
    return TrialSource(trial.name, folder.path, keys, settings)


def _read_source(path: Path) -> TrialSource:
    """Return the trial of a run folder, with the settings from which its artefacts were computed."""
    folder, settings, parameters = Folder(path), {}, dict[str, Any]()
    for stage in repeated_stages():
        origin = folder.provenance(stage.outputs[0]).origin
        if origin.stage_version != stage.version:
            raise StoreError(
                f"{path / stage.outputs[0]} was made by version {origin.stage_version} of {stage.name}, but this "
                f"program has version {stage.version}: run the trial again (`mocap-id run TRIAL.yaml`)"
            )
        settings[stage.name] = stage.settings.model_validate_json(dumps(origin.parameters[stage.name]), strict=True)
        parameters |= origin.parameters
    if getattr(settings["ukf-smooth"], "method", None) == "encoder":
        raise ConfigError(f"{path}: a run folder does not contain the encoder's file: give the trial's YAML file")
    if parameters.get("imus"):
        raise ConfigError(f"{path}: a run folder does not contain the sensors' logs: give the trial's YAML file")
    known = {name: parameters[name] for name in ("trial", "protocol")}
    subject = Subject.model_validate(parameters["subject"])
    # No stage that is run again reads the recording.
    keys = TrialKeys.model_construct(**known, recording=None, subject=subject)
    return TrialSource(str(parameters["trial"]), path, keys, settings)


def read_inputs(source: TrialSource) -> TrialInputs:
    """Read the unperturbed inputs of a trial.

    Raises
    ------
    StoreError
        An artefact is missing or damaged, or was not computed from the other artefacts in the folder.
    """
    folder = Folder(source.folder)
    files = {file for stage in repeated_stages() for file in (*stage.inputs, *stage.outputs)} - {"markers.parquet"}
    check_provenance(folder, sorted(files))
    return TrialInputs(source, {file: folder.read(file) for file in sorted(files)}, source.settings)
