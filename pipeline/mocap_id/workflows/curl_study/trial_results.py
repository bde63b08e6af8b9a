"""The result of one trial of a study of curls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting.numbers import known
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study_outcome import StudyOutcome, event_facts
from mocap_id.workflows.trial_outcome import read_summary


@dataclass(frozen=True, kw_only=True)
class CurlResult(StudyOutcome):
    """The result of one trial of a study of curls."""

    reference: str  # condition that others are compared with
    curl: Mapping[str, Any]  # facts of events.parquet; empty without any
    normalised: float = math.nan  # repetitions over those of the reference in the trial of the same number

    @property
    def condition(self) -> str:
        """Condition of the trial."""
        return self.trial.condition

    @property
    def number(self) -> int:
        """Number of the trial among those of the person in this condition, from 1."""
        return self.trial.number

    @property
    def repetitions(self) -> float:
        """Complete curls up to the end of the trial; NaN if unknown."""
        return _number(self.curl.get("count"))

    @property
    def why(self) -> str:
        """Why the repetitions are unknown, or there are none; empty otherwise."""
        return self.curl.get("why") or ""

    def mean_of_curls(self, name: str, key: str) -> float:
        """Return the mean of a quantity over the curls, such as the range of an angle; NaN if unknown."""
        entries = self.curl.get(name) or ()
        found = [_number(entry[key]) for entry in entries if entry is not None]
        kept = [value for value in found if math.isfinite(value)]
        return float(np.mean(kept)) if kept else math.nan

    def compensation(self, angle: str, key: str = "range_rad") -> float:
        """Return the mean over the curls of an entry of an angle's compensation, degrees; NaN if unknown."""
        entries = (self.curl.get("compensation") or {}).get(angle) or ()
        found = [entry[key] for entry in entries if entry is not None]
        return float(np.degrees(np.mean(found))) if found else math.nan

    def in_step(self, angle: str) -> float:
        """Return the range of an angle in step with the flexion, degrees; NaN if unknown."""
        return math.degrees(_number(((self.curl.get("in_step") or {}).get(angle) or {}).get("range_rad")))


@dataclass(frozen=True)
class Measure:
    """What is compared between conditions."""

    unit: str
    meaning: str
    of: Callable[[CurlResult], float]


ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "thorax_lateral", "thorax_axial", "thorax_flexion")
"""Angles that curls should leave still."""


def _compensation(angle: str) -> Measure:
    meaning = f"range of {angle.replace('_', ' ')} within a curl, mean over the curls"
    return Measure("deg", meaning, lambda trial: trial.compensation(angle))


MEASURES: Mapping[str, Measure] = {
    "repetitions": Measure("1", "complete curls up to the end of the trial", lambda trial: trial.repetitions),
    "normalised": Measure(
        "1",
        "repetitions over those of the person's trial of the same number in the reference condition",
        lambda trial: trial.normalised,
    ),
    "duration": Measure("s", "time of a curl, mean over the curls", lambda trial: _mean(trial.curl.get("tempo_s"))),
    "torque": Measure(
        "N*m",
        "largest torque about the elbow in a curl, mean over the curls",
        lambda trial: trial.mean_of_curls("torque", "peak_Nm"),
    ),
    "torque_person": Measure(
        "N*m",
        "largest torque of the person in a curl, mean over the curls",
        lambda trial: trial.mean_of_curls("torque", "person_peak_Nm"),
    ),
    **{angle: _compensation(angle) for angle in ANGLES},
    "shoulder_axial_in_step": Measure(
        "deg",
        "range of shoulder axial in the first curl that goes in step with the flexion; an error of the elbow's axis "
        "looks the same",
        lambda trial: trial.in_step("shoulder_axial"),
    ),
}


def read_curl_result(study: Study, trial: StudyTrial, run: TrialRun) -> CurlResult:
    """Read the result of a trial from its run folder."""
    facts, summary = event_facts(trial, run, "curl"), read_summary(trial.trial.out, run)
    return CurlResult(trial=trial, run=run, reference=study.reference, summary=summary, curl=facts)


def normalise(trials: Sequence[CurlResult]) -> list[CurlResult]:
    """Return the trials with repetitions over those of the person's trial of the same number in the reference."""
    base = {(one.subject, one.number): one.repetitions for one in trials if one.condition == one.reference}

    def ratio(one: CurlResult) -> float:
        below = base.get((one.subject, one.number), math.nan)
        return one.repetitions / below if below > 0 else math.nan

    return [replace(one, normalised=ratio(one)) for one in trials]


def _number(value: object) -> float:
    found = known(value)
    return math.nan if found is None else found


def _mean(values: Sequence[float | None] | None) -> float:
    found = [value for value in values or () if value is not None]
    return float(np.mean(found)) if found else math.nan
