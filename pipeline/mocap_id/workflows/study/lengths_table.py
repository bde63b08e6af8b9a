"""`lengths`: shank and thigh against landmarks or stature, per person and over the cohort (thesis table 6.1)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.cohort.material import COHORT
from mocap_id.workflows.study.cases import LANDMARKS, SEGMENTS, Case
from mocap_id.workflows.study.statistics import groups, mean_sd

FRAMEWORK, STATURE = "framework", "stature"
_NOTHING = "neither landmarks_m nor height is given in the study's file"


def rows(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.LENGTHS`: every person's, then the cohort's."""
    persons = groups(cases, lambda case: case.subject)
    own = [row for segment in SEGMENTS for subject in persons for row in _person(subject, persons[subject], segment)]
    return [*own, *_cohort(own)]


def _person(subject: str, cases: Sequence[Case], segment: str) -> Iterator[dict[str, Any]]:
    reference = cases[0].reference
    found = [length for case in cases if (length := case.length(segment)) is not None]
    yield _row(subject, segment, FRAMEWORK, cases[0], found)
    if reference.kind == LANDMARKS:
        by_stature = reference.by_stature[segment]
        yield _row(subject, segment, STATURE, cases[0], [] if by_stature is None else [by_stature])


def _row(subject: str, segment: str, method: str, case: Case, lengths: Sequence[float]) -> dict[str, Any]:
    truth = case.reference.lengths[segment]
    mean, sd = mean_sd(lengths)
    error = (math.nan, math.nan) if truth is None else mean_sd([100 * (length / truth - 1) for length in lengths])
    return {
        "subject": subject,
        "segment": segment,
        "reference": case.reference.kind,
        "method": method,
        "subjects": int(bool(lengths)),
        "trials": len(lengths) if method == FRAMEWORK else 0,
        "length_mean": mean,
        "length_sd": sd,
        "reference_length": truth,
        "error_mean": error[0],
        "error_sd": error[1],
        "why": _why(case, segment, method, lengths),
    }


def _why(case: Case, segment: str, method: str, lengths: Sequence[float]) -> str:
    if case.reference.kind == "":
        return _NOTHING
    if case.reference.lengths[segment] is None:
        return f"landmarks_m does not give the {segment}"
    if not lengths:
        return "the height is not given" if method == STATURE else f"no trial has a {segment}"
    return ""


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Mean and spread over the people, for each segment, reference and method."""
    known = [row for row in own if not row["why"]]
    for alike in groups(known, lambda row: "\n".join((row["segment"], row["reference"], row["method"]))).values():
        error = mean_sd(row["error_mean"] for row in alike)
        length = mean_sd(row["length_mean"] for row in alike)
        yield {
            **{name: alike[0][name] for name in ("segment", "reference", "method")},
            "subject": COHORT,
            "subjects": len(alike),
            "trials": sum(row["trials"] for row in alike),
            "length_mean": length[0],
            "length_sd": length[1],
            "reference_length": mean_sd(row["reference_length"] for row in alike)[0],
            "error_mean": error[0],
            "error_sd": error[1],
        }
