"""A study of reaches: the reachable volume of several people and their clinical score (thesis table 7.1).

A trial has one value with its interval for each measure. The table `people` averages a person's trials over sessions
and sides, `correlation` compares people with their score, and `differences` pairs sides and successive sessions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95
from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting import COHORT
from mocap_id.reporting.figures.skeleton import make_wires
from mocap_id.reporting.grids import UNKNOWN, to_numbers
from mocap_id.reporting.results import (
    ResultColumn,
    count,
    declare_tables,
    estimate_columns,
    number,
    shown_as,
    text,
    whole,
)
from mocap_id.reporting.study import CohortData
from mocap_id.reporting.study.reach import Shape, render_reach_page, show_score
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study import (
    IntervalEstimate,
    StudyKind,
    average_estimates,
    correlate_ranks,
    group_by,
    pool_differences,
)
from mocap_id.workflows.trial_outcome import (
    TRIAL_COLUMNS,
    VERDICT_COLUMNS,
    Measure,
    StudyOutcome,
    number_or_nan,
    read_event_facts,
    read_summary,
)

SIDES = ("right", "left")


@dataclass(frozen=True, kw_only=True)
class ReachResult(StudyOutcome):
    """The result of one trial of a reach study."""

    score: float | None  # clinical score of the person; None if not given
    reach: Mapping[str, Any]  # facts of events.parquet about the reach; empty if the trial failed or was refused

    @property
    def session(self) -> str:
        return self.trial.session

    @property
    def side(self) -> str:
        """Side of the arm; for a trial that failed, the side in its configuration, or right if not given."""
        mirrored = self.value("mirrored")
        return self.trial.trial.keys.side or "right" if mirrored is None else SIDES[bool(mirrored)]


ReachMeasure: TypeAlias = Measure[ReachResult, IntervalEstimate]


def _read_number(trial: ReachResult, *keys: str) -> float:
    return number_or_nan(trial.value("workspace", *keys))


def _volume(*keys: str) -> Callable[[ReachResult], IntervalEstimate]:

    def estimate(trial: ReachResult) -> IntervalEstimate:
        interval = to_numbers(trial.value("workspace", *keys, "interval_m3")) or [math.nan] * 2
        return IntervalEstimate(_read_number(trial, *keys, "volume_m3"), *interval)

    return estimate


def _read_elevation(trial: ReachResult) -> IntervalEstimate:
    value, sd = (_read_number(trial, "ranges", "shoulder_elevation", key) for key in ("high_deg", "high_sd_deg"))
    return IntervalEstimate(value, value - NORMAL_95 * sd, value + NORMAL_95 * sd)


MEASURES: Mapping[str, ReachMeasure] = {
    "volume": Measure("volume (m³)", "m^3", "reachable volume, joints independent of each other", _volume()),
    "visited": Measure(
        "visited volume (m³)", "m^3", "reachable volume of the recorded combinations of angles", _volume("visited")
    ),
    "surface": Measure(
        "surface",
        "1",
        "reached fraction of the hemisphere in front of the shoulder",
        lambda trial: IntervalEstimate(_read_number(trial, "surface", "box", "total")),
    ),
    "elevation": Measure("elevation (°)", "deg", "highest elevation of the upper arm", _read_elevation),
    "height": Measure(
        "height (m)",
        "m",
        "highest wrist above the shoulder",
        lambda trial: IntervalEstimate(_read_number(trial, "heights", "highest_m")),
    ),
}
"""Measures that are compared between people, sides and sessions; the thesis uses `volume`."""


def _read_result(study: Study, trial: StudyTrial, run: TrialRun) -> ReachResult:
    facts, summary = read_event_facts(trial, run, "reach"), read_summary(trial.trial.out, run)
    return ReachResult(trial=trial, run=run, score=study.subjects[trial.subject].score, summary=summary, reach=facts)


def person_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each person: first people without a score, then people with a score in ascending order."""
    people = group_by(trials, lambda trial: trial.subject)
    volume = MEASURES["volume"]
    scores = {subject: own[0].score for subject, own in people.items()}
    for subject in sorted(people, key=lambda one: -math.inf if (score := scores[one]) is None else score):
        own = people[subject]
        with_volume = [trial for trial in own if np.isfinite(volume.of(trial).value)]
        row = {"subject": subject, "score": scores[subject], "trials": len(with_volume), "of_trials": len(own)}
        for name, measure in MEASURES.items():
            row |= average_estimates(_average_side(own, side, measure) for side in SIDES).columns(name)
        yield row | {f"volume_{side}": _average_side(own, side, volume).value for side in SIDES}


def _average_side(trials: Sequence[ReachResult], side: str, measure: ReachMeasure) -> IntervalEstimate:
    return average_estimates(measure.of(trial) for trial in trials if trial.side == side)


def correlation_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each measure: its correlation with the score, from people for whom both are known."""
    rows = list(person_rows(trials))
    score = np.array([math.nan if row["score"] is None else row["score"] for row in rows], dtype=np.float64)
    for name in MEASURES:
        estimate, p, people = correlate_ranks(score, np.array([row[name] for row in rows], dtype=np.float64))
        yield {"measure": name, "people": people, "p": p} | estimate.columns("spearman")


def difference_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield, for each comparison and measure, the row of the cohort and then the rows of the people."""
    # The pairs of groups of trials of one person that differ only in side or in session, by comparison, second minus
    # first: right and left of each session, then successive sessions of each side. The label is the session in which
    # two sides, or the side in which two sessions are compared.
    compared: dict[str, list[tuple[str, str, list[ReachResult], list[ReachResult]]]] = {}
    sessions = list(dict.fromkeys(trial.session for trial in trials if trial.session))
    for subject, own in group_by(trials, lambda trial: trial.subject).items():
        groups = group_by(own, lambda trial: (trial.session, trial.side))
        for session in dict.fromkeys(trial.session for trial in own):
            right, left = (groups.get((session, side), []) for side in SIDES)
            if right and left:
                compared.setdefault("left - right", []).append((subject, session, right, left))
        for side in SIDES:
            recorded = [session for session in sessions if (session, side) in groups]
            for before, after in pairwise(recorded):
                pair = (subject, side, groups[before, side], groups[after, side])
                compared.setdefault(f"{after} - {before}", []).append(pair)
    for comparison, pairs in compared.items():
        for name, measure in MEASURES.items():
            known, people = [], dict[str, list[float]]()
            for subject, label, *both in pairs:
                first, second = (_average_side(own, own[0].side, measure) for own in both)
                difference = second.minus(first)
                if math.isfinite(difference.value):
                    known.append({"subject": subject, "label": label, "people": 1} | difference.columns("difference"))
                    people.setdefault(subject, []).append(difference.value)
            if not known:
                continue
            labels = {"comparison": comparison, "measure": name}
            yield labels | {"subject": COHORT} | pool_differences(people, "sd")
            yield from (labels | row for row in known)


def make_page(data: CohortData, trials: Sequence[ReachResult]) -> bytes:
    """Return the page of the study as UTF-8; the page draws the last trial of each person, side and session."""
    with_surface = [trial for trial in trials if trial.reach.get("mesh")]
    drawn = {(trial.subject, trial.side, trial.session): trial for trial in with_surface}
    return render_reach_page(data, tuple(map(make_shape, drawn.values())))


def make_shape(trial: ReachResult) -> Shape:
    """Return the surface of a trial's reachable volume; the surface of a left arm is mirrored back to the left."""
    mesh, mirror = trial.reach["mesh"], [1, 1, -1 if trial.side == "left" else 1]
    shoulder = np.array(trial.reach["shoulder_m"])
    surface = shoulder + make_wires(mesh["theta_deg"], mesh["psi_deg"], mesh["box_m"])
    arm = shoulder + np.array(trial.reach["view"]["arm_m"])
    return Shape(trial.subject, trial.side, trial.session, surface * mirror, arm * mirror)


# The columns of all tables, and how the page shows them.

_SCORE = "clinical score of the person; NaN if not given"
_MEASURE = text(
    "measure",
    "measure of reach: " + ", ".join(MEASURES),
    head="measure",
    cell=lambda row: MEASURES[row["measure"]].label,
)


def _measure_columns(*, per_trial: bool) -> Iterator[ResultColumn]:
    for name, one in MEASURES.items():
        yield from estimate_columns(name, one.unit, one.meaning, one.of if per_trial else None, one.label)


def _level(level: str) -> ResultColumn:
    def read(trial: ReachResult) -> int | None:
        reached = trial.value("workspace", "heights", "levels", level)
        return None if reached is None else int(reached)

    return count(level, f"1: reached the height of {level}; 0: not reached", read)


def _explain(trial: ReachResult) -> str:
    return "" if math.isfinite(MEASURES["volume"].of(trial).value) else trial.value("workspace", "why") or ""


TABLES = declare_tables(
    people=(
        text("subject", "id of the person", head="person"),
        shown_as(number("score", "1", _SCORE), "score", lambda row: show_score(row["score"]), optional=True),
        shown_as(
            whole("trials", "number of trials with a known volume"),
            "trials",
            lambda row: f"{row['trials']} of {row['of_trials']}",
        ),
        whole("of_trials", "number of all trials"),
        *_measure_columns(per_trial=False),
        *(
            number(
                f"volume_{side}",
                "m^3",
                f"reachable volume of the {side} arm, mean over its trials",
                head=f"{side} (m³)",
                decimals=3,
                optional=True,
            )
            for side in SIDES
        ),
    ),
    correlation=(
        _MEASURE,
        whole("people", "number of people whose score and measure are known", head="people"),
        *estimate_columns("spearman", "1", "Spearman's correlation with the score", head="Spearman's correlation"),
        number("p", "1", "two-sided permutation p-value of the hypothesis of no correlation", head="p"),
    ),
    differences=(
        text("comparison", "both sides or sessions: second minus first", head="difference"),
        _MEASURE,
        text("subject", "id of the person; `cohort` = mean over all people", head="person"),
        text("label", "session in which sides are compared, or side in which sessions are compared", head="of"),
        whole("people", "number of people in the row", head="people"),
        *estimate_columns("difference", "", "difference, in the measure's unit", head="difference"),
        number(
            "sd",
            "",
            "cohort: standard deviation of the differences, in the measure's unit",
            head="sd",
            optional=True,
        ),
    ),
    trials=(
        *TRIAL_COLUMNS,
        text("side", "side of the arm", lambda trial: trial.side, "side"),
        text("session", "session of the recording", lambda trial: trial.session, "session", missing=UNKNOWN),
        number("score", "1", _SCORE, lambda trial: trial.score),
        *VERDICT_COLUMNS,
        *_measure_columns(per_trial=True),
        *map(_level, ("waist", "mouth", "overhead")),
        text("why", "why the volume is unknown; empty otherwise", _explain, ""),
    ),
)
STUDY = StudyKind(
    labels=("side", "session"),
    read=_read_result,
    tables=TABLES,
    rows={"people": person_rows, "correlation": correlation_rows, "differences": difference_rows},
    page=make_page,
)
