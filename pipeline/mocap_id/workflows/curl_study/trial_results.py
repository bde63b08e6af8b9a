"""The result of one trial of a study of curls."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.config.study import Study, StudyTrial
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study_outcome import Measure, StudyOutcome, read_event_facts
from mocap_id.workflows.trial_outcome import number_or_nan, read_summary


@dataclass(frozen=True, kw_only=True)
class CurlResult(StudyOutcome):
    """The result of one trial of a study of curls."""

    reference: str  # condition with which the others are compared
    curl: Mapping[str, Any]  # facts of events.parquet about the curls; empty if the trial failed or was refused
    normalised: float = math.nan  # repetitions, divided by the repetitions in the reference condition

    @property
    def condition(self) -> str:
        """Condition of the trial."""
        return self.trial.condition

    @property
    def number(self) -> int:
        """Number of the trial among the person's trials in this condition, from 1."""
        return self.trial.number

    @property
    def repetitions(self) -> float:
        """Number of complete curls up to the end of the trial; NaN if unknown."""
        return number_or_nan(self.curl.get("count"))

    @property
    def why(self) -> str:
        """Reason why the repetitions are unknown or zero; empty otherwise."""
        return self.curl.get("why") or ""

    def average(self, name: str, key: str) -> float:
        """Return the mean over the curls of entry ``key`` of quantity ``name``, e.g. a peak torque; NaN if unknown."""
        entries = self.curl.get(name) or ()
        values = [number_or_nan(entry[key]) for entry in entries if entry is not None]
        return _mean(value for value in values if math.isfinite(value))

    def average_compensation(self, angle: str, key: str = "range_rad") -> float:
        """Return the mean over the curls of entry ``key`` of an angle's compensation, degrees; NaN if unknown."""
        entries = (self.curl.get("compensation") or {}).get(angle) or ()
        return float(np.degrees(_mean(entry[key] for entry in entries if entry is not None)))

    def range_in_step(self, angle: str) -> float:
        """Return the range of that part of an angle that depends only on the flexion, degrees; NaN if unknown."""
        return math.degrees(number_or_nan(((self.curl.get("in_step") or {}).get(angle) or {}).get("range_rad")))


CurlMeasure: TypeAlias = Measure[CurlResult, float]
ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "thorax_lateral", "thorax_axial", "thorax_flexion")
"""Angles that should not change during a curl."""


def _measure_compensation(angle: str) -> CurlMeasure:
    meaning = f"range of {angle.replace('_', ' ')} within a curl, mean over the curls"
    return Measure("deg", meaning, lambda trial: trial.average_compensation(angle))


MEASURES: Mapping[str, CurlMeasure] = {
    "repetitions": Measure("1", "complete curls up to the end of the trial", lambda trial: trial.repetitions),
    "normalised": Measure(
        "1",
        "repetitions, divided by the repetitions of the person's trial of the same number in the reference condition",
        lambda trial: trial.normalised,
    ),
    "duration": Measure(
        "s",
        "time of a curl, mean over the curls",
        lambda trial: _mean(value for value in trial.curl.get("tempo_s") or () if value is not None),
    ),
    "torque": Measure(
        "N*m",
        "largest torque about the elbow in a curl, mean over the curls",
        lambda trial: trial.average("torque", "peak_Nm"),
    ),
    "torque_person": Measure(
        "N*m",
        "largest torque of the person in a curl, mean over the curls",
        lambda trial: trial.average("torque", "person_peak_Nm"),
    ),
    **{angle: _measure_compensation(angle) for angle in ANGLES},
    "shoulder_axial_in_step": Measure(
        "deg",
        "range of that part of shoulder axial that depends only on the flexion, in the first curl; an error of the "
        "elbow's axis has the same effect",
        lambda trial: trial.range_in_step("shoulder_axial"),
    ),
}
"""Measures that are compared between conditions."""


def read_curl_result(study: Study, trial: StudyTrial, run: TrialRun) -> CurlResult:
    """Read the result of a trial from its run folder."""
    facts, summary = read_event_facts(trial, run, "curl"), read_summary(trial.trial.out, run)
    return CurlResult(trial=trial, run=run, reference=study.reference, summary=summary, curl=facts)


def normalise(trials: Sequence[CurlResult]) -> list[CurlResult]:
    """Return the trials with ``normalised`` set: repetitions divided by those in the person's reference condition."""
    base = {(one.subject, one.number): one.repetitions for one in trials if one.condition == one.reference}

    def divide(one: CurlResult) -> float:
        repetitions = base.get((one.subject, one.number), math.nan)
        return one.repetitions / repetitions if repetitions > 0 else math.nan

    return [replace(one, normalised=divide(one)) for one in trials]


def _mean(values: Iterable[float]) -> float:
    """Return the mean; NaN if there are no values."""
    listed = list(values)
    return float(np.mean(listed)) if listed else math.nan
