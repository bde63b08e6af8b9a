"""The result of one trial of a study of curls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np

from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting.contents import COHORT
from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.pooling import average_people, group_by, sign_flip_p
from mocap_id.workflows.trial_outcome import (
    TRIAL_COLUMNS,
    VERDICT_COLUMNS,
    Measure,
    StudyOutcome,
    estimate_columns,
    fill_tables,
    number_or_nan,
    read_event_facts,
    read_summary,
)


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


def condition_rows(trials: Sequence[CurlResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each measure and each condition in which the measure is known."""
    for name, measure in MEASURES.items():
        for condition, own in group_by(trials, lambda trial: trial.condition).items():
            known = [(trial.subject, value) for trial in own if np.isfinite(value := measure.of(trial))]
            if not known:
                continue
            people = group_by(known, lambda one: one[0])
            means = [float(np.mean([value for _, value in values])) for values in people.values()]
            ends = np.quantile([value for _, value in known], (0, 0.25, 0.5, 0.75, 1)).tolist()
            counts = {"people": len(people), "trials": len(known), "of_trials": len(own)}
            quantiles = dict(zip(("lowest", "q1", "median", "q3", "highest"), ends, strict=True))
            yield {"condition": condition, "measure": name} | counts | average_people(means).columns("mean") | quantiles


def comparison_rows(trials: Sequence[CurlResult]) -> Iterator[dict[str, Any]]:
    """Yield, for each pair of conditions and each measure, the row of the cohort and then the rows of the people.

    Trials are paired by person and by their number in the condition.
    """
    reference = trials[0].reference
    conditions = sorted(dict.fromkeys(trial.condition for trial in trials), key=lambda name: name != reference)
    for first, second in combinations(conditions, 2):
        for name, measure in MEASURES.items():
            people = _subtract_conditions(trials, first, second, measure)
            if not people:
                continue
            row = {"comparison": f"{second} - {first}", "first": first, "second": second, "measure": name}
            yield row | {"subject": COHORT} | _average_cohort(people)
            for subject, differences in people.items():
                yield row | {
                    "subject": subject,
                    "people": 1,
                    "pairs": len(differences),
                    "difference": float(np.mean(differences)),
                    "sd_within": float(np.std(differences, ddof=1)) if len(differences) > 1 else np.nan,
                }


def _subtract_conditions(
    trials: Sequence[CurlResult], first: str, second: str, measure: CurlMeasure
) -> Mapping[str, Sequence[float]]:
    """Return the differences (second minus first condition) by person, one for each pair of trials."""
    values = {(one.condition, one.subject, one.number): measure.of(one) for one in trials}
    people: dict[str, list[float]] = {}
    for (condition, subject, nth), value in values.items():
        difference = value - values.get((first, subject, nth), np.nan)
        if condition == second and np.isfinite(difference):
            people.setdefault(subject, []).append(difference)
    return people


def _average_cohort(people: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return the cohort's mean with its interval, its p-value, and standard deviations between and within people."""
    means = [float(np.mean(differences)) for differences in people.values()]
    freedom = sum(len(differences) - 1 for differences in people.values())
    squares = sum(float(np.var(differences)) * len(differences) for differences in people.values())
    return {
        "people": len(means),
        "pairs": sum(map(len, people.values())),
        **average_people(means).columns("difference"),
        "p": sign_flip_p(means),
        "sd_between": float(np.std(means, ddof=1)) if len(means) > 1 else np.nan,
        "sd_within": float(np.sqrt(squares / freedom)) if freedom else np.nan,
    }


_MEASURE = text("measure", "what is measured: " + ", ".join(MEASURES))
_QUANTILES = {
    "lowest": "lowest value",
    "q1": "lower quartile",
    "median": "median",
    "q3": "upper quartile",
    "highest": "highest value",
}


def _curl(key: str) -> Callable[[CurlResult], Any]:
    return lambda trial: trial.curl.get(key)


def _end(key: str) -> Callable[[CurlResult], Any]:
    return lambda trial: (trial.curl.get("end") or {}).get(key)


def _floor(angle: str) -> Callable[[CurlResult], float]:
    return lambda trial: trial.average_compensation(angle, "floor_rad")


TABLES: Mapping[str, TableSchema] = {
    "conditions": TableSchema(
        "conditions.parquet",
        1,
        (
            text("condition", "condition of the trials"),
            _MEASURE,
            whole("people", "number of people"),
            whole("trials", "number of trials in which the measure is known"),
            whole("of_trials", "number of all trials"),
            *estimate_columns("mean", "", "mean over people, in the measure's unit"),
            *(number(name, "", f"{words} of the trials, in the measure's unit") for name, words in _QUANTILES.items()),
        ),
    ),
    "comparisons": TableSchema(
        "comparisons.parquet",
        1,
        (
            text("comparison", "both conditions: `second - first`"),
            text("first", "condition that is subtracted"),
            text("second", "condition from which the first is subtracted"),
            _MEASURE,
            text("subject", "id of the person; `cohort` = mean over all people"),
            whole("people", "number of people"),
            whole("pairs", "number of pairs of trials with the same person and the same number"),
            *estimate_columns("difference", "", "difference, in the measure's unit"),
            number("p", "1", "cohort: two-sided permutation p-value, not corrected for several tests"),
            number("sd_between", "", "cohort: standard deviation of the people's mean differences"),
            number("sd_within", "", "standard deviation of one person's differences; cohort: pooled over all people"),
        ),
    ),
    "trials": TableSchema(
        "trials.parquet",
        1,
        (
            *TRIAL_COLUMNS,
            text("condition", "condition of the trial", lambda trial: trial.condition),
            whole("number", "number of the trial of the person in this condition, from 1", lambda trial: trial.number),
            *VERDICT_COLUMNS,
            count("partial", "number of failed attempts", _curl("partial")),
            count("after_end", "number of complete curls after the end, not counted", _curl("after_end")),
            number("end", "s", "end of the trial", _end("time_s")),
            text("end_rule", "rule that determines the end", _end("rule")),
            *(number(name, measure.unit, measure.meaning, measure.of) for name, measure in MEASURES.items()),
            *(
                number(
                    f"floor_{angle}",
                    "deg",
                    f"range of {angle.replace('_', ' ')} that errors alone can cause, mean over the curls",
                    _floor(angle),
                )
                for angle in ANGLES
            ),
            text("why", "why the repetitions are unknown or zero; empty otherwise", lambda trial: trial.why),
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(trials: Sequence[CurlResult]) -> dict[str, ResultTable]:
    """Return the tables of a study of curls by name."""
    rows = {"conditions": condition_rows, "comparisons": comparison_rows}
    return fill_tables(TABLES, rows, normalise(trials))
