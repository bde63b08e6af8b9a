"""Studies of one arm: curls, and reaches (thesis 8.3, figure 8.5, and table 7.1).

From top to bottom: the result of a trial; the rows and columns of curls; those of reaches. A trial has one value for
each measure. Curls: `conditions` averages the trials of a condition over people, and `comparisons` subtracts the trials
of one condition from those of another, paired by person and number of the trial. Reaches: `people` averages a person's
trials over sessions and sides, `correlation` compares people with their clinical score, and `differences` pairs sides
and successive sessions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95
from mocap_id.config.study import Study, StudyTrial
from mocap_id.reporting import COHORT
from mocap_id.reporting.figures.skeleton import make_wires
from mocap_id.reporting.grids import UNKNOWN, show_fixed, to_numbers
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
from mocap_id.reporting.study.curls import render_curl_page
from mocap_id.reporting.study.reach import Shape, render_reach_page, show_score
from mocap_id.store import Folder
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study import (
    IntervalEstimate,
    StudyKind,
    average_estimates,
    average_people,
    correlate_ranks,
    group_by,
    pool_differences,
    sd_of,
)
from mocap_id.workflows.trial_outcome import (
    TRIAL_COLUMNS,
    VERDICT_COLUMNS,
    StudyOutcome,
    find_entry,
    number_or_nan,
    read_summary,
)

SIDES = ("right", "left")


@dataclass(frozen=True, kw_only=True)
class ArmTrial(StudyOutcome):
    """The result of one trial of curls or of a reach."""

    facts: Mapping[str, Any]  # facts of events.parquet about the protocol; empty if the trial failed or was refused
    score: float | None = None  # clinical score of the person; None if not given
    reference: str = ""  # condition of curls with which the others are compared
    normalised: float = math.nan  # repetitions of curls, divided by the repetitions in the reference condition

    @property
    def condition(self) -> str:
        return self.trial.condition

    @property
    def session(self) -> str:
        return self.trial.session

    @property
    def side(self) -> str:
        """Side of the arm; for a trial that failed, the side in its configuration, or right if not given."""
        mirrored = self.value("mirrored")
        return self.trial.trial.keys.side or "right" if mirrored is None else SIDES[bool(mirrored)]


def _read_result(protocol: str, study: Study, trial: StudyTrial, run: TrialRun) -> ArmTrial:
    facts = Folder(trial.trial.out).read("events.parquet").facts if run.exit_code == 0 else {}
    return ArmTrial(
        trial=trial,
        run=run,
        summary=read_summary(trial.trial.out, run),
        facts=facts.get(protocol) or {},
        score=study.subjects[trial.subject].score,
        reference=study.reference,
    )


# Curls.


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return float(np.mean(listed)) if listed else math.nan


def _count_repetitions(trial: ArmTrial) -> float:
    return number_or_nan(trial.facts.get("count"))


def _average_torque(trial: ArmTrial, key: str) -> float:
    values = [number_or_nan(entry[key]) for entry in trial.facts.get("torque") or () if entry is not None]
    return _mean(value for value in values if math.isfinite(value))


def _average_compensation(trial: ArmTrial, angle: str, key: str = "range_rad") -> float:
    """Return the mean over the curls of entry ``key`` of an angle's compensation, degrees; NaN if unknown."""
    entries = (trial.facts.get("compensation") or {}).get(angle) or ()
    return float(np.degrees(_mean(entry[key] for entry in entries if entry is not None)))


ANGLES = {
    "shoulder_plane": "shoulder plane (°)",
    "shoulder_elevation": "shoulder elevation (°)",
    "shoulder_axial": "shoulder axial rotation (°)",
    "thorax_lateral": "thorax lateral (°)",
    "thorax_axial": "thorax axial (°)",
    "thorax_flexion": "thorax flexion (°)",
}
"""Labels of the angles that should not change during a curl."""
_CURL_MEASURES = (
    number("repetitions", "1", "complete curls up to the end of the trial", _count_repetitions, "repetitions"),
    number(
        "normalised",
        "1",
        "repetitions, divided by the repetitions of the person's trial of the same number in the reference condition",
        lambda trial: trial.normalised,
        "normalised repetitions",
    ),
    number(
        "duration",
        "s",
        "time of a curl, mean over the curls",
        lambda trial: _mean(value for value in trial.facts.get("tempo_s") or () if value is not None),
        "time of a curl (s)",
    ),
    number(
        "torque",
        "N*m",
        "largest torque about the elbow in a curl, mean over the curls",
        partial(_average_torque, key="peak_Nm"),
        "largest torque (N·m)",
    ),
    number(
        "torque_person",
        "N*m",
        "largest torque of the person in a curl, mean over the curls",
        partial(_average_torque, key="person_peak_Nm"),
        "largest torque of the person (N·m)",
    ),
    *(
        number(
            angle,
            "deg",
            f"range of {angle.replace('_', ' ')} within a curl, mean over the curls",
            partial(_average_compensation, angle=angle),
            label,
        )
        for angle, label in ANGLES.items()
    ),
    number(
        "shoulder_axial_in_step",
        "deg",
        "range of that part of shoulder axial that depends only on the flexion, in the first curl; an error of the "
        "elbow's axis has the same effect",
        lambda trial: math.degrees(number_or_nan(find_entry(trial.facts, "in_step", "shoulder_axial", "range_rad"))),
    ),
)
"""Measures that are compared between conditions; a measure without a heading is on no page."""


def _measure_trials(trials: Sequence[ArmTrial]) -> Iterator[tuple[str, list[float]]]:
    """Yield the name of each measure of curls and its values in the trials."""
    for measure in _CURL_MEASURES:
        assert measure.value is not None
        yield measure.name, [measure.value(trial) for trial in trials]


def normalise(trials: Sequence[ArmTrial]) -> list[ArmTrial]:
    """Return the trials with ``normalised`` set: repetitions divided by those in the person's reference condition."""
    counts = [_count_repetitions(one) for one in trials]
    pairs = [(one.subject, one.trial.number) for one in trials]
    rows = list(zip(trials, pairs, counts, strict=True))
    base = {pair: repetitions for one, pair, repetitions in rows if one.condition == one.reference}
    return [
        replace(one, normalised=repetitions / base[pair] if base.get(pair, math.nan) > 0 else math.nan)
        for one, pair, repetitions in rows
    ]


def condition_rows(trials: Sequence[ArmTrial]) -> Iterator[dict[str, Any]]:
    """Yield a row for each measure and each condition in which the measure is known."""
    for name, values in _measure_trials(trials):
        groups = group_by(zip(trials, values, strict=True), lambda one: one[0].condition)
        for condition, own in groups.items():
            known = [(trial.subject, value) for trial, value in own if np.isfinite(value)]
            if not known:
                continue
            people = group_by(known, lambda one: one[0])
            means = [float(np.mean([value for _, value in values])) for values in people.values()]
            ends = np.quantile([value for _, value in known], (0, 0.25, 0.5, 0.75, 1)).tolist()
            counts = {"people": len(people), "trials": len(known), "of_trials": len(own)}
            quantiles = dict(zip(("lowest", "q1", "median", "q3", "highest"), ends, strict=True))
            yield {"condition": condition, "measure": name} | counts | average_people(means).columns("mean") | quantiles


def comparison_rows(trials: Sequence[ArmTrial]) -> Iterator[dict[str, Any]]:
    """Yield, for each pair of conditions and each measure, the row of the cohort and then the rows of the people.

    Trials are paired by person and by their number in the condition.
    """
    reference = trials[0].reference
    conditions = sorted(dict.fromkeys(trial.condition for trial in trials), key=lambda name: name != reference)
    keys = [(one.condition, one.subject, one.trial.number) for one in trials]
    measures = {name: dict(zip(keys, values, strict=True)) for name, values in _measure_trials(trials)}
    for first, second in combinations(conditions, 2):
        for name, values in measures.items():
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


_SUBJECT = text("subject", "id of the person; `cohort` = mean over all people", head="person")
_OF_ALL_TRIALS = whole("of_trials", "number of all trials")


def _column_of_measures(meaning: str, head: str, labels: Mapping[str, str]) -> ResultColumn:
    meaning = f"{meaning}: {', '.join(labels)}"
    return text("measure", meaning, head=head, cell=lambda row: labels[row["measure"]])


def _count_trials(what: str) -> ResultColumn:
    column = whole("trials", f"number of trials {what}")
    return shown_as(column, "trials", lambda row: f"{row['trials']} of {row['of_trials']}")


def _fact(*keys: str) -> Callable[[ArmTrial], Any]:
    return lambda trial: find_entry(trial.facts, *keys)


_CURL_MEASURE = _column_of_measures(
    "what is measured", "", {one.name: "" if one.shown is None else one.shown.head for one in _CURL_MEASURES}
)
_OF_TRIALS = "of the trials, in the measure's unit"

CURL_TABLES = declare_tables(
    conditions=(
        text("condition", "condition of the trials", head="condition"),
        _CURL_MEASURE,
        whole("people", "number of people", head="people"),
        _count_trials("in which the measure is known"),
        _OF_ALL_TRIALS,
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
        _CURL_MEASURE,
        _SUBJECT,
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
        count("partial", "number of failed attempts", _fact("partial"), "failed attempts"),
        count("after_end", "number of complete curls after the end, not counted", _fact("after_end")),
        number("end", "s", "end of the trial", _fact("end", "time_s"), "end (s)", decimals=1),
        text("end_rule", "rule that determines the end", _fact("end", "rule"), "ended by"),
        *_CURL_MEASURES,
        *(
            number(
                f"floor_{angle}",
                "deg",
                f"range of {angle.replace('_', ' ')} that errors alone can cause, mean over the curls",
                partial(_average_compensation, angle=angle, key="floor_rad"),
            )
            for angle in ANGLES
        ),
        text(
            "why",
            "why the repetitions are unknown or zero; empty otherwise",
            lambda trial: trial.facts.get("why") or "",
            "",
        ),
    ),
)
CURLS = StudyKind(
    labels=("condition",),
    read=partial(_read_result, "curl"),
    tables=CURL_TABLES,
    rows={"conditions": condition_rows, "comparisons": comparison_rows},
    page=lambda data, trials: render_curl_page(data, trials[0].reference),
    prepare=normalise,
)


# Reaches.


def _read_number(trial: ArmTrial, *keys: str) -> float:
    return number_or_nan(trial.value("workspace", *keys))


def _volume(*keys: str) -> Callable[[ArmTrial], IntervalEstimate]:

    def estimate(trial: ArmTrial) -> IntervalEstimate:
        interval = to_numbers(trial.value("workspace", *keys, "interval_m3")) or [math.nan] * 2
        return IntervalEstimate(_read_number(trial, *keys, "volume_m3"), *interval)

    return estimate


def _elevation(trial: ArmTrial) -> IntervalEstimate:
    value, sd = (_read_number(trial, "ranges", "shoulder_elevation", key) for key in ("high_deg", "high_sd_deg"))
    return IntervalEstimate(value, value - NORMAL_95 * sd, value + NORMAL_95 * sd)


_find_volume = _volume()
_ReachMeasure: TypeAlias = tuple[str, str, str, Callable[[ArmTrial], IntervalEstimate]]
_REACH_MEASURES: Mapping[str, _ReachMeasure] = {
    "volume": ("volume (m³)", "m^3", "reachable volume, joints independent of each other", _find_volume),
    "visited": (
        "visited volume (m³)",
        "m^3",
        "reachable volume of the recorded combinations of angles",
        _volume("visited"),
    ),
    "surface": (
        "surface",
        "1",
        "reached fraction of the hemisphere in front of the shoulder",
        lambda trial: IntervalEstimate(_read_number(trial, "surface", "box", "total")),
    ),
    "elevation": ("elevation (°)", "deg", "highest elevation of the upper arm", _elevation),
    "height": (
        "height (m)",
        "m",
        "highest wrist above the shoulder",
        lambda trial: IntervalEstimate(_read_number(trial, "heights", "highest_m")),
    ),
}
"""Label, unit, meaning and source of the measures that are compared between people, sides and sessions."""


def person_rows(trials: Sequence[ArmTrial]) -> Iterator[dict[str, Any]]:
    """Yield a row for each person: first people without a score, then people with a score in ascending order."""
    people = group_by(trials, lambda trial: trial.subject)
    scores = {subject: own[0].score for subject, own in people.items()}
    for subject in sorted(people, key=lambda one: -math.inf if (score := scores[one]) is None else score):
        own = people[subject]
        with_volume = [trial for trial in own if np.isfinite(_find_volume(trial).value)]
        row = {"subject": subject, "score": scores[subject], "trials": len(with_volume), "of_trials": len(own)}
        for name, (*_, measure) in _REACH_MEASURES.items():
            sides = {side: average_estimates(measure(trial) for trial in own if trial.side == side) for side in SIDES}
            row |= average_estimates(sides.values()).columns(name)
            if name == "volume":
                row |= {f"volume_{side}": each.value for side, each in sides.items()}
        yield row


def correlation_rows(trials: Sequence[ArmTrial]) -> Iterator[dict[str, Any]]:
    """Yield a row for each measure: its correlation with the score, from people for whom both are known."""
    rows = list(person_rows(trials))
    score = np.array([math.nan if row["score"] is None else row["score"] for row in rows], dtype=np.float64)
    for name in _REACH_MEASURES:
        estimate, p, people = correlate_ranks(score, np.array([row[name] for row in rows], dtype=np.float64))
        yield {"measure": name, "people": people, "p": p} | estimate.columns("spearman")


def difference_rows(trials: Sequence[ArmTrial]) -> Iterator[dict[str, Any]]:
    """Yield, for each comparison and measure, the row of the cohort and then the rows of the people."""
    # The pairs of groups of trials of one person that differ only in side or in session, by comparison, second minus
    # first: right and left of each session, then successive sessions of each side. The label is the session in which
    # two sides, or the side in which two sessions are compared.
    compared: dict[str, list[tuple[str, str, list[ArmTrial], list[ArmTrial]]]] = {}
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
        for name, (*_, measure) in _REACH_MEASURES.items():
            known, people = [], dict[str, list[float]]()
            for subject, label, first, second in pairs:
                difference = average_estimates(map(measure, second)).minus(average_estimates(map(measure, first)))
                if math.isfinite(difference.value):
                    known.append({"subject": subject, "label": label, "people": 1} | difference.columns("difference"))
                    people.setdefault(subject, []).append(difference.value)
            if not known:
                continue
            labels = {"comparison": comparison, "measure": name}
            yield labels | {"subject": COHORT} | pool_differences(people, "sd")
            yield from (labels | row for row in known)


def make_reach_page(data: CohortData, trials: Sequence[ArmTrial]) -> bytes:
    """Return the page of the study as UTF-8; the page draws the last trial of each person, side and session."""
    with_surface = [trial for trial in trials if trial.facts.get("mesh")]
    drawn = {(trial.subject, trial.side, trial.session): trial for trial in with_surface}
    return render_reach_page(data, tuple(map(make_shape, drawn.values())))


def make_shape(trial: ArmTrial) -> Shape:
    """Return the surface of a trial's reachable volume; the surface of a left arm is mirrored back to the left."""
    mesh, mirror = trial.facts["mesh"], [1, 1, -1 if trial.side == "left" else 1]
    shoulder = np.array(trial.facts["shoulder_m"])
    surface = shoulder + make_wires(mesh["theta_deg"], mesh["psi_deg"], mesh["box_m"])
    arm = shoulder + np.array(trial.facts["view"]["arm_m"])
    return Shape(trial.subject, trial.side, trial.session, surface * mirror, arm * mirror)


_SCORE = "clinical score of the person; NaN if not given"
_REACH_MEASURE = _column_of_measures(
    "measure of reach", "measure", {name: label for name, (label, *_) in _REACH_MEASURES.items()}
)


def _level(level: str) -> ResultColumn:
    def read(trial: ArmTrial) -> int | None:
        reached = trial.value("workspace", "heights", "levels", level)
        return None if reached is None else int(reached)

    return count(level, f"1: reached the height of {level}; 0: not reached", read)


REACH_TABLES = declare_tables(
    people=(
        text("subject", "id of the person", head="person"),
        shown_as(number("score", "1", _SCORE), "score", lambda row: show_score(row["score"]), optional=True),
        _count_trials("with a known volume"),
        _OF_ALL_TRIALS,
        *(
            column
            for name, (label, unit, meaning, _) in _REACH_MEASURES.items()
            for column in estimate_columns(name, unit, meaning, None, label)
        ),
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
        _REACH_MEASURE,
        whole("people", "number of people whose score and measure are known", head="people"),
        *estimate_columns("spearman", "1", "Spearman's correlation with the score", head="Spearman's correlation"),
        number("p", "1", "two-sided permutation p-value of the hypothesis of no correlation", head="p"),
    ),
    differences=(
        text("comparison", "both sides or sessions: second minus first", head="difference"),
        _REACH_MEASURE,
        _SUBJECT,
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
        *(
            column
            for name, (label, unit, meaning, measure) in _REACH_MEASURES.items()
            for column in estimate_columns(name, unit, meaning, measure, label)
        ),
        *map(_level, ("waist", "mouth", "overhead")),
        text(
            "why",
            "why the volume is unknown; empty otherwise",
            lambda trial: "" if math.isfinite(_find_volume(trial).value) else trial.value("workspace", "why") or "",
            "",
        ),
    ),
)
REACHES = StudyKind(
    labels=("side", "session"),
    read=partial(_read_result, "reach"),
    tables=REACH_TABLES,
    rows={"people": person_rows, "correlation": correlation_rows, "differences": difference_rows},
    page=make_reach_page,
)
