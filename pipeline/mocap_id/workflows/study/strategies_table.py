"""`strategies`: lengths, re-projection and condition number by strategy (thesis table 6.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, named_mean_sd
from mocap_id.workflows.study.trial_results import TrialResult

QUANTITIES: Mapping[str, Callable[[TrialResult], float | None]] = {
    "shank_error": lambda trial: trial.length_error("shank"),
    "thigh_error": lambda trial: trial.length_error("thigh"),
    "reprojection": lambda trial: trial.metres("markers", "reprojection_rms_mm"),
    "condition_number": lambda trial: trial.value("dynamics", "condition_number"),
}


def strategy_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `strategies`: those of each person, then those of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    strategies = group_by(identified, lambda trial: trial.strategy)
    own = [
        _person(same)
        for subject in group_by(identified, lambda trial: trial.subject)
        for strategy in strategies
        if (same := [trial for trial in strategies[strategy] if trial.subject == subject])
    ]
    return [*own, *_cohort(own)]


def _person(trials: Sequence[TrialResult]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "subject": trials[0].subject,
        "strategy": trials[0].strategy,
        "reference": trials[0].reference.kind,
        "subjects": 1,
        "trials": len(trials),
    }
    for name, quantity in QUANTITIES.items():
        row |= named_mean_sd(name, map(quantity, trials))
    return row


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Return mean and spread over the people; landmarks and stature are not mixed."""
    for rows in group_by(own, lambda row: (row["strategy"], row["reference"])).values():
        row: dict[str, Any] = {
            "subject": COHORT,
            "strategy": rows[0]["strategy"],
            "reference": rows[0]["reference"],
            "subjects": len(rows),
            "trials": sum(person["trials"] for person in rows),
        }
        for name in QUANTITIES:
            row |= named_mean_sd(name, (person[f"{name}_mean"] for person in rows))
        yield row
