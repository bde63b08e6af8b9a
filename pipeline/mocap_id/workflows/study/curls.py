"""A study of curls: repetitions and compensation of several people under several conditions (thesis 8.3, figure 8.5).

A trial has one value for each measure. The table `conditions` averages the trials of a condition over people,
`comparisons` subtracts the trials of one condition from those of another, paired by person and number of the trial.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np

from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting import COHORT
from mocap_id.reporting.grids import show_fixed
from mocap_id.reporting.results import (
    count,
    declare_tables,
    estimate_columns,
    number,
    shown_as,
    text,
    whole,
)
from mocap_id.reporting.study.curls import render_curl_page
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study import StudyKind, average_people, group_by, pool_differences, sd_of
from mocap_id.workflows.trial_outcome import (
    TRIAL_COLUMNS,
    VERDICT_COLUMNS,
    Measure,
    StudyOutcome,
    find_entry,
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
        return self.trial.condition

    @property
    def repetitions(self) -> float:
        """Number of complete curls up to the end of the trial; NaN if unknown."""
        return number_or_nan(self.curl.get("count"))

    def average_torque(self, key: str) -> float:
        """Return the mean over the curls of a peak torque, N·m; NaN if unknown."""
        entries = self.curl.get("torque") or ()
        values = [number_or_nan(entry[key]) for entry in entries if entry is not None]
        return _mean(value for value in values if math.isfinite(value))

    def average_compensation(self, angle: str, key: str = "range_rad") -> float:
        """Return the mean over the curls of entry ``key`` of an angle's compensation, degrees; NaN if unknown."""
        entries = (self.curl.get("compensation") or {}).get(angle) or ()
        return float(np.degrees(_mean(entry[key] for entry in entries if entry is not None)))


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return float(np.mean(listed)) if listed else math.nan


CurlMeasure: TypeAlias = Measure[CurlResult, float]
ANGLES = {
    "shoulder_plane": "shoulder plane (°)",
    "shoulder_elevation": "shoulder elevation (°)",
    "shoulder_axial": "shoulder axial rotation (°)",
    "thorax_lateral": "thorax lateral (°)",
    "thorax_axial": "thorax axial (°)",
    "thorax_flexion": "thorax flexion (°)",
}
"""Labels of the angles that should not change during a curl."""
MEASURES: Mapping[str, CurlMeasure] = {
    "repetitions": Measure(
        "repetitions", "1", "complete curls up to the end of the trial", lambda trial: trial.repetitions
    ),
    "normalised": Measure(
        "normalised repetitions",
        "1",
        "repetitions, divided by the repetitions of the person's trial of the same number in the reference condition",
        lambda trial: trial.normalised,
    ),
    "duration": Measure(
        "time of a curl (s)",
        "s",
        "time of a curl, mean over the curls",
        lambda trial: _mean(value for value in trial.curl.get("tempo_s") or () if value is not None),
    ),
    "torque": Measure(
        "largest torque (N·m)",
        "N*m",
        "largest torque about the elbow in a curl, mean over the curls",
        lambda trial: trial.average_torque("peak_Nm"),
    ),
    "torque_person": Measure(
        "largest torque of the person (N·m)",
        "N*m",
        "largest torque of the person in a curl, mean over the curls",
        lambda trial: trial.average_torque("person_peak_Nm"),
    ),
    **{
        angle: Measure(
            label,
            "deg",
            f"range of {angle.replace('_', ' ')} within a curl, mean over the curls",
            partial(CurlResult.average_compensation, angle=angle),
        )
        for angle, label in ANGLES.items()
    },
    "shoulder_axial_in_step": Measure(
        None,
        "deg",
        "range of that part of shoulder axial that depends only on the flexion, in the first curl; an error of the "
        "elbow's axis has the same effect",
        lambda trial: math.degrees(number_or_nan(find_entry(trial.curl, "in_step", "shoulder_axial", "range_rad"))),
    ),
}
"""Measures that are compared between conditions."""


def _read_result(study: Study, trial: StudyTrial, run: TrialRun) -> CurlResult:
    facts, summary = read_event_facts(trial, run, "curl"), read_summary(trial.trial.out, run)
    return CurlResult(trial=trial, run=run, reference=study.reference, summary=summary, curl=facts)


def normalise(trials: Sequence[CurlResult]) -> list[CurlResult]:
    """Return the trials with ``normalised`` set: repetitions divided by those in the person's reference condition."""
    base = {(one.subject, one.trial.number): one.repetitions for one in trials if one.condition == one.reference}
    known = [base.get((one.subject, one.trial.number), math.nan) for one in trials]
    return [
        replace(one, normalised=one.repetitions / repetitions if repetitions > 0 else math.nan)
        for one, repetitions in zip(trials, known, strict=True)
    ]


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
            values = {(one.condition, one.subject, one.trial.number): measure.of(one) for one in trials}
            people: dict[str, list[float]] = {}
            for (condition, subject, nth), value in values.items():
                difference = value - values.get((first, subject, nth), np.nan)
                if condition == second and np.isfinite(difference):
                    people.setdefault(subject, []).append(difference)
            if not people:
                continue
            row = {"comparison": f"{second} - {first}", "first": first, "second": second, "measure": name}
            yield row | {"subject": COHORT} | pool_differences(people, "pairs p sd_between sd_within")
            for subject, differences in people.items():
                mean, sd = float(np.mean(differences)), sd_of(differences)
                counts = {"subject": subject, "people": 1, "pairs": len(differences)}
                yield row | counts | {"difference": mean, "sd_within": sd}


def _curl(*keys: str) -> Callable[[CurlResult], Any]:
    return lambda trial: find_entry(trial.curl, *keys)


_MEASURE = text(
    "measure", "what is measured: " + ", ".join(MEASURES), head="", cell=lambda row: MEASURES[row["measure"]].label
)
_OF_TRIALS = "of the trials, in the measure's unit"

TABLES = declare_tables(
    conditions=(
        text("condition", "condition of the trials", head="condition"),
        _MEASURE,
        whole("people", "number of people", head="people"),
        shown_as(
            whole("trials", "number of trials in which the measure is known"),
            "trials",
            lambda row: f"{row['trials']} of {row['of_trials']}",
        ),
        whole("of_trials", "number of all trials"),
        *estimate_columns("mean", "", "mean over people, in the measure's unit", head="mean"),
        number("lowest", "", f"lowest value {_OF_TRIALS}"),
        shown_as(
            number("q1", "", f"lower quartile {_OF_TRIALS}"),
            "half of the trials",
            lambda row: f"{show_fixed(row['q1'], 2)} … {show_fixed(row['q3'], 2)}",
        ),
        number("median", "", f"median {_OF_TRIALS}", head="median"),
        number("q3", "", f"upper quartile {_OF_TRIALS}"),
        number("highest", "", f"highest value {_OF_TRIALS}"),
    ),
    comparisons=(
        text("comparison", "both conditions: `second - first`", head="difference"),
        text("first", "condition that is subtracted"),
        text("second", "condition from which the first is subtracted"),
        _MEASURE,
        text("subject", "id of the person; `cohort` = mean over all people", head="person"),
        whole("people", "number of people", head="people"),
        whole("pairs", "number of pairs of trials with the same person and the same number", head="pairs"),
        *estimate_columns("difference", "", "difference, in the measure's unit", head="mean difference"),
        number(
            "p",
            "1",
            "cohort: two-sided permutation p-value, not corrected for several tests",
            head="p",
            decimals=3,
            optional=True,
        ),
        number(
            "sd_between",
            "",
            "cohort: standard deviation of the people's mean differences",
            head="sd between people",
            optional=True,
        ),
        number(
            "sd_within",
            "",
            "standard deviation of one person's differences; cohort: pooled over all people",
            head="sd within a person",
            optional=True,
        ),
    ),
    trials=(
        *TRIAL_COLUMNS,
        text("condition", "condition of the trial", lambda trial: trial.condition, "condition"),
        whole(
            "number",
            "number of the trial of the person in this condition, from 1",
            lambda trial: trial.trial.number,
            "number",
        ),
        *VERDICT_COLUMNS,
        count("partial", "number of failed attempts", _curl("partial"), "failed attempts"),
        count("after_end", "number of complete curls after the end, not counted", _curl("after_end")),
        number("end", "s", "end of the trial", _curl("end", "time_s"), "end (s)", decimals=1),
        text("end_rule", "rule that determines the end", _curl("end", "rule"), "ended by"),
        *(number(name, one.unit, one.meaning, one.of, one.label) for name, one in MEASURES.items()),
        *(
            number(
                f"floor_{angle}",
                "deg",
                f"range of {angle.replace('_', ' ')} that errors alone can cause, mean over the curls",
                partial(CurlResult.average_compensation, angle=angle, key="floor_rad"),
            )
            for angle in ANGLES
        ),
        text(
            "why",
            "why the repetitions are unknown or zero; empty otherwise",
            lambda trial: trial.curl.get("why") or "",
            "",
        ),
    ),
)
STUDY = StudyKind(
    labels=("condition",),
    read=_read_result,
    tables=TABLES,
    rows={"conditions": condition_rows, "comparisons": comparison_rows},
    page=lambda data, trials: render_curl_page(data, trials[0].reference),
    prepare=normalise,
)
