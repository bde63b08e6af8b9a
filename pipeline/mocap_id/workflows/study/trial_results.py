"""The result of one trial of a study, with the reference lengths of the person."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.study import Person, Study, StudyTrial
from mocap_id.dynamics.allometry import TableName, look_up_table
from mocap_id.store import Folder
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study_outcome import StudyOutcome
from mocap_id.workflows.transfer import HELD_OUT, OWN, BodyErrors, errors_at_home
from mocap_id.workflows.trial_outcome import read_summary

SEGMENTS = ("shank", "thigh")
"""Segments whose lengths are compared with a reference."""
LANDMARKS = "landmarks"


@dataclass(frozen=True)
class LengthReference:
    """Reference for the segment lengths of a person."""

    kind: str  # ``landmarks``, or ``stature`` with the name of the allometric table; empty if there is no reference
    lengths: Mapping[str, float | None]  # reference lengths by segment, m; None if unknown
    by_stature: Mapping[str, float | None]  # lengths from height and allometric table, m; None if the height is unknown


@dataclass(frozen=True)
class BaseParameters:
    """The b base parameters of a trial."""

    symbols: tuple[str, ...]  # the first parameter in each expression: m1, mx1, mx2 …
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    verdicts: tuple[str, ...]
    value: FloatArray  # (b,) NaN if unknown
    sd: FloatArray  # (b,) standard deviations; NaN if unknown
    reference: FloatArray  # (b,) values for the allometric body on the same chain; NaN if unknown
    segments: int  # number of segments of the chain, including the base


@dataclass(frozen=True, kw_only=True)
class TrialResult(StudyOutcome):
    """The result of one trial of a study."""

    reference: LengthReference
    identified: IdentifiedTrial | None  # None if the trial failed or was refused
    # errors of the trial's own model, in the fit and on left-out repetitions, and of the allometric body; empty if
    # the trial failed or was refused
    bodies: tuple[BodyErrors, ...]
    parameters: BaseParameters | None  # None if no parameter was identified

    @property
    def strategy(self) -> str:
        """Strategy of the movement."""
        return self.trial.strategy

    def length(self, segment: str) -> float | None:
        """Return the length of a segment, m; None if unknown."""
        length: float | None = self.value("lengths_m", segment, "value")
        return length

    def length_error(self, segment: str) -> float | None:
        """Return length minus reference length, % of the reference; None if one of the lengths is unknown."""
        length, reference = self.length(segment), self.reference.lengths[segment]
        return None if length is None or reference is None else 100 * (length / reference - 1)

    def model_errors(self, model: str) -> dict[str, tuple[float, float, float]]:
        """Return bias, standard deviation and root mean square of a model's error, by name of each known series.

        Parameters
        ----------
        model : {"own", "held_out", "reference"}
        """
        names = {OWN: "own", HELD_OUT: "held_out"}
        bodies = [body for body in self.bodies if names.get(body.name, "reference") == model]
        return {
            name: (error.bias, error.sd, math.hypot(error.bias, error.sd))
            for body in bodies
            for name, error in body.errors.items()
            if error is not None
        }


def read_trial_result(study: Study, trial: StudyTrial, run: TrialRun) -> TrialResult:
    """Read the result of a trial from its run folder."""
    out, passed = trial.trial.out, run.exit_code == 0
    identified = open_identified_trial(out) if passed else None
    settings: Any = trial.trial.settings["identify-dim"]
    return TrialResult(
        trial=trial,
        run=run,
        reference=find_length_reference(study.subjects[trial.subject], settings.reference),
        summary=read_summary(out, run),
        identified=identified,
        bodies=() if identified is None else errors_at_home(identified),
        parameters=_read_parameters(out) if passed else None,
    )


def find_length_reference(person: Person, name: TableName) -> LengthReference:
    """Return the reference for a person's lengths: landmarks if one of them is given, or else stature."""
    table = look_up_table(name, person.sex)
    by_stature = {
        segment: None if person.height is None else getattr(table, segment).length * person.height
        for segment in SEGMENTS
    }
    measured = {segment: getattr(person.landmarks_m, segment) for segment in SEGMENTS}
    if any(length is not None for length in measured.values()):
        return LengthReference(LANDMARKS, measured, by_stature)
    return LengthReference("" if person.height is None else f"stature ({name})", by_stature, by_stature)


def _read_parameters(out: Path) -> BaseParameters | None:
    """Read the base parameters from a run folder; None if no parameter except the mass was identified."""
    tree = Folder(out).tree("dynamics.h5")
    value, reference = tree.numbers("base/value"), tree.numbers("full/reference")
    if np.isfinite(value).sum() <= 1:  # the mass alone is not a model
        return None
    expressions = tree.texts("base/name")
    return BaseParameters(
        symbols=tuple(name.split("+")[0] for name in expressions),
        expressions=expressions,
        units=tree.texts("base/unit"),
        verdicts=tree.texts("base/verdict"),
        value=value,
        sd=tree.numbers("base/sd"),
        reference=tree.array("base/regrouping") @ reference,
        segments=len(reference) // 4,
    )
