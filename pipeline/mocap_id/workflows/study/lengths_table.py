"""`lengths`: shank and thigh against landmarks or stature, for each person and the cohort (thesis table 6.1)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, mean_sd, named_mean_sd
from mocap_id.workflows.study.trial_results import LANDMARKS, SEGMENTS, TrialResult

FRAMEWORK, STATURE = "framework", "stature"
_NO_REFERENCE = "neither landmarks_m nor height is given in the study's file"
_GROUP = ("segment", "reference", "method")


def length_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `lengths`: those of each person, then those of the cohort."""
    people = group_by(trials, lambda trial: trial.subject)
    own = [row for segment in SEGMENTS for subject in people for row in _person(subject, people[subject], segment)]
    return [*own, *_cohort(own)]


def _person(subject: str, trials: Sequence[TrialResult], segment: str) -> Iterator[dict[str, Any]]:
    reference = trials[0].reference
    found = [length for trial in trials if (length := trial.length(segment)) is not None]
    yield _row(subject, segment, FRAMEWORK, trials[0], found)
    if reference.kind == LANDMARKS:
        by_stature = reference.by_stature[segment]
        yield _row(subject, segment, STATURE, trials[0], [] if by_stature is None else [by_stature])


def _row(subject: str, segment: str, method: str, trial: TrialResult, lengths: Sequence[float]) -> dict[str, Any]:
    reference = trial.reference.lengths[segment]
    errors = [math.nan] if reference is None else [100 * (length / reference - 1) for length in lengths]
    return {
        "subject": subject,
        "segment": segment,
        "reference": trial.reference.kind,
        "method": method,
        "subjects": int(bool(lengths)),
        "trials": len(lengths) if method == FRAMEWORK else 0,
        **named_mean_sd("length", lengths),
        "reference_length": reference,
        **named_mean_sd("error", errors),
        "why": _why(trial, segment, method, lengths),
    }


def _why(trial: TrialResult, segment: str, method: str, lengths: Sequence[float]) -> str:
    if trial.reference.kind == "":
        return _NO_REFERENCE
    if trial.reference.lengths[segment] is None:
        return f"landmarks_m does not give the {segment}"
    if not lengths:
        return "the height is not given" if method == STATURE else f"no trial has a {segment}"
    return ""


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Return mean and spread over the people, for each segment, reference and method."""
    known = [row for row in own if not row["why"]]
    for rows in group_by(known, lambda row: tuple(row[name] for name in _GROUP)).values():
        yield {
            **{name: rows[0][name] for name in _GROUP},
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            **named_mean_sd("length", (row["length_mean"] for row in rows)),
            "reference_length": mean_sd(row["reference_length"] for row in rows)[0],
            **named_mean_sd("error", (row["error_mean"] for row in rows)),
        }
