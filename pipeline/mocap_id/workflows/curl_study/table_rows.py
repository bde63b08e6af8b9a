"""Rows of the tables `conditions` and `comparisons` of a study of curls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.curl_study.trial_results import MEASURES, CurlMeasure, CurlResult
from mocap_id.workflows.study.statistics import average_people, group_by, sign_flip_p


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
    for (condition, subject, number), value in values.items():
        difference = value - values.get((first, subject, number), np.nan)
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
