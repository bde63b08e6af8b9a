"""`people`: the reach of every person beside the score (thesis table 7.1), and `correlation` of the two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, nan
from typing import Any

import numpy as np

from mocap_id.workflows.reach_study.correlation import spearman
from mocap_id.workflows.reach_study.trial_results import MEASURES, SIDES, Measure, ReachResult
from mocap_id.workflows.study.estimates import Estimate, mean_estimate
from mocap_id.workflows.study.statistics import group_by


def person_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for every person: those without a score first, then by score."""
    people = group_by(trials, lambda trial: trial.subject)
    for subject in sorted(people, key=lambda name: _order(people[name][0].score)):
        own = people[subject]
        volume = MEASURES["volume"]
        used = [trial for trial in own if np.isfinite(volume.of(trial).value)]
        row = {"subject": subject, "score": own[0].score, "trials": len(used), "of_trials": len(own)}
        for name, measure in MEASURES.items():
            row |= over_sides(own, measure).columns(name)
        yield row | {f"volume_{side}": of_side(own, side, volume).value for side in SIDES}


def of_side(trials: Sequence[ReachResult], side: str, measure: Measure) -> Estimate:
    """Return the mean of a measure over the trials of one side."""
    return mean_estimate(measure.of(trial) for trial in trials if trial.side == side)


def over_sides(trials: Sequence[ReachResult], measure: Measure) -> Estimate:
    """Return the mean over the sides of the means over their trials."""
    return mean_estimate(of_side(trials, side, measure) for side in SIDES)


def correlation_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield the correlation of every measure with the score over the people who have one."""
    rows = list(person_rows(trials))
    score = np.array([nan if row["score"] is None else row["score"] for row in rows], dtype=np.float64)
    for name in MEASURES:
        found = spearman(score, np.array([row[name] for row in rows], dtype=np.float64))
        low, high = found.interval
        yield {
            "measure": name,
            "people": found.people,
            "spearman": found.value,
            "spearman_low": low,
            "spearman_high": high,
            "p": found.p,
        }


def _order(score: float | None) -> float:
    return -inf if score is None else score
