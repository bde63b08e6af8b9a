"""Rows of the tables `lengths` and `strategies` (thesis tables 6.1 and 6.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, mean_sd, named_mean_sd
from mocap_id.workflows.study.trial_results import LANDMARKS, SEGMENTS, TrialResult

FRAMEWORK, STATURE = "framework", "stature"
_NO_REFERENCE = "neither landmarks_m nor height is given in the study's file"
_QUANTITIES: Mapping[str, Callable[[TrialResult], float | None]] = {
    "shank_error": lambda trial: trial.length_error("shank"),
    "thigh_error": lambda trial: trial.length_error("thigh"),
    "reprojection": lambda trial: trial.metres("markers", "reprojection_rms_mm"),
    "condition_number": lambda trial: trial.value("dynamics", "condition_number"),
}


def length_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `lengths`: first the rows of all people, then the rows of the cohort."""
    people = group_by(trials, lambda trial: trial.subject)
    rows = [row for segment in SEGMENTS for own in people.values() for row in _person_lengths(own, segment)]
    return [*rows, *_cohort_lengths(rows)]


def _person_lengths(trials: Sequence[TrialResult], segment: str) -> Iterator[dict[str, Any]]:
    reference = trials[0].reference
    known = [length for trial in trials if (length := trial.length(segment)) is not None]
    yield _length_row(trials[0], segment, FRAMEWORK, known)
    if reference.kind == LANDMARKS:
        by_stature = reference.by_stature[segment]
        yield _length_row(trials[0], segment, STATURE, [] if by_stature is None else [by_stature])


def _length_row(trial: TrialResult, segment: str, method: str, lengths: Sequence[float]) -> dict[str, Any]:
    reference = trial.reference.lengths[segment]
    errors = [math.nan] if reference is None else [100 * (length / reference - 1) for length in lengths]
    return {
        "subject": trial.subject,
        "segment": segment,
        "reference": trial.reference.kind,
        "method": method,
        "subjects": int(bool(lengths)),
        "trials": len(lengths) if method == FRAMEWORK else 0,
        **named_mean_sd("length", lengths),
        "reference_length": reference,
        **named_mean_sd("error", errors),
        "why": _explain_missing(trial, segment, method, lengths),
    }


def _explain_missing(trial: TrialResult, segment: str, method: str, lengths: Sequence[float]) -> str:
    """Return why a row has no error; empty if the error is known."""
    if trial.reference.kind == "":
        return _NO_REFERENCE
    if trial.reference.lengths[segment] is None:
        return f"landmarks_m does not give the {segment}"
    if not lengths:
        return "the height is not given" if method == STATURE else f"no trial has a {segment}"
    return ""


def _cohort_lengths(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row with mean and standard deviation over the people for each segment, reference and method."""
    known = [row for row in people if not row["why"]]
    keys = ("segment", "reference", "method")
    for group, rows in group_by(known, lambda row: tuple(row[key] for key in keys)).items():
        yield {
            **dict(zip(keys, group, strict=True)),
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            **named_mean_sd("length", (row["length_mean"] for row in rows)),
            "reference_length": mean_sd(row["reference_length"] for row in rows)[0],
            **named_mean_sd("error", (row["error_mean"] for row in rows)),
        }


def strategy_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `strategies`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    groups = group_by(identified, lambda trial: (trial.subject, trial.strategy))
    subjects, strategies = (list(dict.fromkeys(key[k] for key in groups)) for k in (0, 1))
    rows = [
        _person_strategy(groups[subject, strategy])
        for subject in subjects
        for strategy in strategies
        if (subject, strategy) in groups
    ]
    return [*rows, *_cohort_strategies(rows)]


def _person_strategy(trials: Sequence[TrialResult]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "subject": trials[0].subject,
        "strategy": trials[0].strategy,
        "reference": trials[0].reference.kind,
        "subjects": 1,
        "trials": len(trials),
    }
    for name, quantity in _QUANTITIES.items():
        row |= named_mean_sd(name, map(quantity, trials))
    return row


def _cohort_strategies(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row with mean and standard deviation over the people for each strategy and kind of reference."""
    for (strategy, reference), rows in group_by(people, lambda row: (row["strategy"], row["reference"])).items():
        row: dict[str, Any] = {
            "subject": COHORT,
            "strategy": strategy,
            "reference": reference,
            "subjects": len(rows),
            "trials": sum(person["trials"] for person in rows),
        }
        for name in _QUANTITIES:
            row |= named_mean_sd(name, (person[f"{name}_mean"] for person in rows))
        yield row
