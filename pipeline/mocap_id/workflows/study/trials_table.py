"""`trials`: what came of each trial, a row a trial, failed ones too."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.cohort.material import Fate
from mocap_id.workflows.study.cases import SEGMENTS, Case

_SERIES = ("Fx", "Fy", "tauz", "cop_x")
_FIVE_TIMES = {
    "five_times": "to_fifth_stand_s",
    "five_times_seated": "to_fifth_seat_contact_s",
    "cycle": "mean_cycle_s",
    "failed_attempts": "failed_attempts",
}
"""Columns that a summary holds for movements that are timed so, and no other does."""


def rows(cases: Sequence[Case]) -> Iterator[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.TRIALS`."""
    for case in cases:
        yield {
            "trial": case.trial.name,
            "subject": case.subject,
            "strategy": case.strategy,
            "verdict": level(case),
            "codes": ", ".join(codes(case)),
            "exit_code": case.performed.exit_code,
            "message": case.performed.published,
            **_lengths(case),
            **({} if case.summary is None else _numbers(case.summary)),
            **_errors(case),
        }


def level(case: Case) -> Fate:
    """The verdict's level; `failed` where there is none."""
    if case.summary is None:
        return "failed"
    found: Fate = case.summary["verdict"]["level"]
    return found


def codes(case: Case) -> list[str]:
    """Codes of what colours the verdict."""
    return [] if case.summary is None else [str(reason["code"]) for reason in case.summary["verdict"]["reasons"]]


def length_error(case: Case, segment: str) -> float | None:
    """The length less its reference, in % of the reference; None where either is unknown."""
    length, reference = case.length(segment), case.reference.lengths[segment]
    return None if length is None or reference is None else 100 * (length / reference - 1)


def reprojection(case: Case) -> float | None:
    """rms distance between measured and predicted markers, m."""
    value = ((case.summary or {}).get("markers") or {}).get("reprojection_rms_mm")
    return None if value is None else value / 1e3


def condition(case: Case) -> float | None:
    """Condition number of the regressor."""
    value = ((case.summary or {}).get("dynamics") or {}).get("condition_number")
    return None if value is None else float(value)


def _lengths(case: Case) -> dict[str, Any]:
    row: dict[str, Any] = {"reference": case.reference.kind}
    for segment in SEGMENTS:
        row[segment], row[f"{segment}_sd"] = case.length_and_sd(segment)
        row[f"{segment}_reference"] = case.reference.lengths[segment]
        row[f"{segment}_error"] = length_error(case, segment)
    return row | {"reprojection": reprojection(case), "condition_number": condition(case)}


def _numbers(summary: Mapping[str, Any]) -> dict[str, Any]:
    dynamics, repetitions = summary["dynamics"], summary["repetitions"]
    timed = summary.get("five_times") or {}
    return {
        "segments": summary["segments"]["count"],
        "confidence": summary["segments"]["confidence"],
        "missing_fraction": summary["markers"]["missing_fraction"],
        "mass": dynamics["mass_kg"],
        "samples": dynamics["samples"],
        "clock_offset": dynamics["clock_offset_s"],
        "repetitions": None if repetitions is None else len(repetitions),
        "complete": None if repetitions is None else sum(bool(one["complete"]) for one in repetitions),
        **{name: timed.get(key) for name, key in _FIVE_TIMES.items()},
    }


def _errors(case: Case) -> dict[str, float]:
    """Of the own model, the same on repetitions left out, and the allometric body."""
    if case.done is None:
        return {}
    row: dict[str, float] = {}
    for body in case.at_home:
        suffix = {"own": "own", "own, held out": "held_out"}.get(body.name, "reference")
        for name in _SERIES:
            error = body.errors.get(name)
            if error is not None:
                row[f"{name}_{suffix}_mean"], row[f"{name}_{suffix}_sd"] = error.bias, error.sd
                row[f"{name}_{suffix}_rms"] = math.hypot(error.bias, error.sd)
    return row
