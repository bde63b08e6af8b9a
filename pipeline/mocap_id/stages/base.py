"""Stages as frozen records: inputs, outputs, settings and a function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from pydantic import BaseModel, ConfigDict

from mocap_id import store
from mocap_id.errors import Refused
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.stages.trial_keys import TrialKeys
    from mocap_id.store import Artefact, Document, LongTable, Table, Tree

Only: TypeAlias = Mapping[str, tuple[str, ...]]
"""Settings that exist in the plane only, or in space only, by name.

The values are the choices that exist only there; an empty tuple stands for all choices."""


class Settings(BaseModel):
    """Base class of all models of the configuration: immutable, without unknown keys.

    ``plane_only`` settings exist only with `space: plane`, ``space_only`` settings only with `space: 3d`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    plane_only: ClassVar[Only] = {}
    space_only: ClassVar[Only] = {}


@dataclass(frozen=True)
class Context:
    """Inputs of a stage's function: trial, settings and artefacts.

    ``inputs`` are the input artefacts of the stage by file name. ``refused`` is set only for the report of a refused
    trial; ``inputs`` are then the artefacts that exist. ``seconds`` are the computation times of earlier stages, s.
    """

    trial: TrialKeys
    settings: Any
    inputs: Mapping[str, Artefact]
    refused: Refused | None = None
    seconds: Mapping[str, float] | None = None

    def table(self, file: str) -> Table:
        """Return an input in a Parquet file with one row for every sample."""
        artefact = self.inputs[file]
        assert isinstance(artefact, store.Table)
        return artefact

    def long(self, file: str) -> LongTable:
        """Return an input in a Parquet file with one row for every frame and marker."""
        artefact = self.inputs[file]
        assert isinstance(artefact, store.LongTable)
        return artefact

    def tree(self, file: str) -> Tree:
        """Return an input in an HDF5 file."""
        artefact = self.inputs[file]
        assert isinstance(artefact, store.Tree)
        return artefact

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons in all inputs, each one once, in the order of the inputs."""
        return tuple(dict.fromkeys(reason for artefact in self.inputs.values() for reason in artefact.reasons))


Outputs: TypeAlias = "tuple[Artefact | Document, ...]"


@dataclass(frozen=True)
class Stage:
    """One stage of the pipeline."""

    name: str  # name on the command line, such as ``fit-joints``
    version: int  # version of the computation; it must be raised whenever the same inputs give different outputs
    # Inputs, outputs: file names of artefacts and documents. A stage may return additional documents such as figures.
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    # Keys of :class:`TrialKeys` that the function reads. With the settings, they form the stage's slice.
    uses: tuple[str, ...]
    settings: type[Settings]  # model of the section with the stage's name in the YAML file
    # function that returns the outputs for a :class:`Context`, in the order of ``outputs``
    function: Callable[[Context], Outputs]
    help: str  # one line for the command line and the documentation
    # additional keys that the function reads only if the trial has inertial sensors without a recording
    uses_alone: tuple[str, ...] = ()

    def keys_of(self, trial: TrialKeys) -> tuple[str, ...]:
        """Return the keys of the trial that the function reads."""
        return self.uses if trial.recording is not None else (*self.uses, *self.uses_alone)
