"""`comparisons`: each condition against each other, paired by person and number of the trial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.curl_study.trial_results import MEASURES, CurlResult, Measure
from mocap_id.workflows.study.estimates import over_people, sign_flip_p


def comparison_rows(trials: Sequence[CurlResult]) -> Iterator[dict[str, Any]]:
    """Yield, for every pair of conditions and measure, the row of the cohort and those of the people."""
    reference = trials[0].reference
    conditions = sorted(dict.fromkeys(trial.condition for trial in trials), key=lambda name: name != reference)
    for first, second in combinations(conditions, 2):
        for name, measure in MEASURES.items():
            people = _differences(trials, first, second, measure)
            if not people:
                continue
            row = {"comparison": f"{second} - {first}", "first": first, "second": second, "measure": name}
            yield row | {"subject": COHORT} | _of_cohort(people)
            for subject, found in people.items():
                yield row | {
                    "subject": subject,
                    "people": 1,
                    "pairs": len(found),
                    "difference": float(np.mean(found)),
                    "sd_within": float(np.std(found, ddof=1)) if len(found) > 1 else np.nan,
                }


def _differences(
    trials: Sequence[CurlResult], first: str, second: str, measure: Measure
) -> Mapping[str, Sequence[float]]:
    """Return the differences second minus first of each person, one for each number of a trial that has both."""
    values = {(one.condition, one.subject, one.number): measure.of(one) for one in trials}
    found: dict[str, list[float]] = {}
    for (condition, subject, number), value in values.items():
        difference = value - values.get((first, subject, number), np.nan)
        if condition == second and np.isfinite(difference):
            found.setdefault(subject, []).append(difference)
    return found


def _of_cohort(people: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return the mean over people with Student's interval, the permutation p-value, and both spreads."""
    means = [float(np.mean(found)) for found in people.values()]
    free = sum(len(found) - 1 for found in people.values())
    squares = sum(float(np.var(found)) * len(found) for found in people.values())
    return {
        "people": len(means),
        "pairs": sum(map(len, people.values())),
        **over_people(means).columns("difference"),
        "p": sign_flip_p(means),
        "sd_between": float(np.std(means, ddof=1)) if len(means) > 1 else np.nan,
        "sd_within": float(np.sqrt(squares / free)) if free else np.nan,
    }
