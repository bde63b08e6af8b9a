"""Records of the stages: each describes the inputs, outputs, settings and function of one stage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from pydantic import BaseModel, ConfigDict

from mocap_id.errors import ConfigError, Refused
from mocap_id.store.folder import ArtefactReader
from mocap_id.verdict import Level, Reason

if TYPE_CHECKING:
    from mocap_id.stages.trial_keys import TrialKeys
    from mocap_id.store import Artefact, Document

Only: TypeAlias = Mapping[str, tuple[str, ...]]
"""Restricted choices by the name of the setting, for settings that exist only in the plane or only in space.

An empty tuple means that the whole setting is restricted."""


class Settings(BaseModel):
    """Base class of all models of the configuration: immutable, without unknown keys.

    The settings in ``plane_only`` exist only with `space: plane`, those in ``space_only`` only with `space: 3d`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    plane_only: ClassVar[Only] = {}
    space_only: ClassVar[Only] = {}


@dataclass(frozen=True)
class Context(ArtefactReader):
    """Inputs of a stage's function: trial, settings and artefacts.

    ``inputs`` are the input artefacts of the stage by file name. ``refused`` is the refusal in the report of a refused
    trial, else None; ``inputs`` then contains only the artefacts that exist. ``seconds`` are the computation times of
    the earlier stages by name, s; they are given only to the report.
    """

    trial: TrialKeys
    settings: Any
    inputs: Mapping[str, Artefact]
    refused: Refused | None = None
    seconds: Mapping[str, float] | None = None

    def read(self, file: str) -> Artefact:
        """Return the input ``file``."""
        return self.inputs[file]


class Findings:
    """Facts and reasons of an artefact, in the order in which a stage finds them."""

    def __init__(self, reasons: Iterable[Reason] = ()) -> None:
        self.facts: dict[str, Any] = {}
        self.reasons = list(reasons)

    def fact(self, **facts: Any) -> None:
        """Add facts by name."""
        self.facts |= facts

    def say(
        self,
        code: str,
        message: str,
        value: float | None = None,
        limit: float | None = None,
        level: Level = "caution",
    ) -> None:
        """Add a :class:`Reason` with these fields."""
        self.reasons.append(Reason(code, message, value, limit, level))


Outputs: TypeAlias = "tuple[Artefact | Document, ...]"


@dataclass(frozen=True)
class Stage:
    """One stage of the pipeline."""

    name: str  # name on the command line, such as ``fit-joints``
    version: int  # version of the computation; it must be raised whenever the same inputs give different outputs
    # Inputs, outputs: file names of artefacts and documents. A stage may return additional documents such as figures.
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    # Keys of :class:`TrialKeys` that the function reads. The stage runs again if one of them or a setting changes.
    uses: tuple[str, ...]
    settings: type[Settings]  # model of the section in the YAML file that has the name of the stage
    # function that returns the outputs for a :class:`Context`, in the order of ``outputs``
    function: Callable[[Context], Outputs]
    help: str  # one line for the command line and the documentation
    # additional keys that the function reads only if the trial has inertial sensors without a recording
    uses_alone: tuple[str, ...] = ()

    def keys_of(self, trial: TrialKeys) -> tuple[str, ...]:
        """Return the names of the trial's keys that the function of the stage reads."""
        return self.uses if trial.recording is not None else (*self.uses, *self.uses_alone)


def find_markers(labels: Sequence[str], patterns: Sequence[str], key: str) -> tuple[int, ...]:
    """Return the indices, in ascending order, of the markers that match labels or patterns such as ``L*WR*``.

    A pattern that is also the label of a marker selects only this marker, because camera software gives unlabelled
    markers names such as ``*12``. If no marker matches a pattern, the message of the ConfigError begins with ``key``,
    the key in the configuration.
    """
    matches = {
        pattern: {
            i
            for i, label in enumerate(labels)
            if (label == pattern if pattern in labels else fnmatchcase(label, pattern))
        }
        for pattern in patterns
    }
    unmatched = [pattern for pattern, indices in matches.items() if not indices]
    if unmatched:
        near = get_close_matches(unmatched[0], labels, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; the markers are {', '.join(labels)}"
        raise ConfigError(f"{key}: no marker is called {', '.join(unmatched)}{hint}")
    return tuple(sorted(set().union(*matches.values())))
