"""`strategies`: lengths, re-projection and condition number by strategy (thesis table 6.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.cohort.material import COHORT
from mocap_id.workflows.study.cases import Case
from mocap_id.workflows.study.statistics import groups, mean_sd
from mocap_id.workflows.study.trials_table import condition, length_error, reprojection

QUANTITIES = {
    "shank_error": lambda case: length_error(case, "shank"),
    "thigh_error": lambda case: length_error(case, "thigh"),
    "reprojection": reprojection,
    "condition_number": condition,
}


def rows(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.STRATEGIES`: every person's, then the cohort's."""
    done = [case for case in cases if case.done is not None]
    strategies = groups(done, lambda case: case.strategy)
    own = [
        _person(alike)
        for subject in groups(done, lambda case: case.subject)
        for strategy in strategies
        if (alike := [case for case in strategies[strategy] if case.subject == subject])
    ]
    return [*own, *_cohort(own)]


def _person(cases: Sequence[Case]) -> dict[str, Any]:
    first = cases[0]
    row: dict[str, Any] = {
        "subject": first.subject,
        "strategy": first.strategy,
        "reference": first.reference.kind,
        "subjects": 1,
        "trials": len(cases),
    }
    for name, quantity in QUANTITIES.items():
        row[f"{name}_mean"], row[f"{name}_sd"] = mean_sd(quantity(case) for case in cases)
    return row


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Mean and spread over the people; what is held against landmarks and what against stature stay apart."""
    for alike in groups(own, lambda row: "\n".join((row["strategy"], row["reference"]))).values():
        row: dict[str, Any] = {
            "subject": COHORT,
            "strategy": alike[0]["strategy"],
            "reference": alike[0]["reference"],
            "subjects": len(alike),
            "trials": sum(person["trials"] for person in alike),
        }
        for name in QUANTITIES:
            row[f"{name}_mean"], row[f"{name}_sd"] = mean_sd(person[f"{name}_mean"] for person in alike)
        yield row
