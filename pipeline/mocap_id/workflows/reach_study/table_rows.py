"""Rows of the tables of a reach study: people (thesis table 7.1), correlation with the score, and differences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, nan
from typing import Any

import numpy as np

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.reach_study.correlation import correlate_ranks
from mocap_id.workflows.reach_study.trial_results import MEASURES, SIDES, ReachMeasure, ReachResult
from mocap_id.workflows.study.statistics import Estimate, average_estimates, average_people, group_by


def person_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each person: first people without a score, then people with a score in ascending order."""
    people = group_by(trials, lambda trial: trial.subject)
    volume = MEASURES["volume"]
    for subject, own in sorted(people.items(), key=lambda item: -inf if item[1][0].score is None else item[1][0].score):
        with_volume = [trial for trial in own if np.isfinite(volume.of(trial).value)]
        row = {"subject": subject, "score": own[0].score, "trials": len(with_volume), "of_trials": len(own)}
        for name, measure in MEASURES.items():
            row |= average_estimates(_average_side(own, side, measure) for side in SIDES).columns(name)
        yield row | {f"volume_{side}": _average_side(own, side, volume).value for side in SIDES}


def _average_side(trials: Sequence[ReachResult], side: str, measure: ReachMeasure) -> Estimate:
    return average_estimates(measure.of(trial) for trial in trials if trial.side == side)


def correlation_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each measure: its correlation with the score, from people for whom both are known."""
    rows = list(person_rows(trials))
    score = np.array([nan if row["score"] is None else row["score"] for row in rows], dtype=np.float64)
    for name in MEASURES:
        result = correlate_ranks(score, np.array([row[name] for row in rows], dtype=np.float64))
        yield {"measure": name, "people": result.people, "p": result.p} | result.estimate.columns("spearman")


@dataclass(frozen=True)
class _Pair:
    """Two groups of trials of one person that differ only in side or in session."""

    comparison: str  # both sides or sessions: second minus first, such as ``left - right``
    subject: str
    label: str  # the session in which two sides, or the side in which two sessions are compared
    first: Sequence[ReachResult]
    second: Sequence[ReachResult]

    def difference(self, measure: ReachMeasure) -> Estimate:
        """Return the second group's mean of a measure minus the first group's mean."""
        first, second = (_average_side(own, own[0].side, measure) for own in (self.first, self.second))
        return second.minus(first)


def difference_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield, for each comparison and measure, the row of the cohort and then the rows of the people."""
    for comparison, pairs in group_by(_pair_trials(trials), lambda pair: pair.comparison).items():
        for name, measure in MEASURES.items():
            differences = [(pair, pair.difference(measure)) for pair in pairs]
            known = [(pair, difference) for pair, difference in differences if np.isfinite(difference.value)]
            if not known:
                continue
            labels = {"comparison": comparison, "measure": name}
            yield labels | {"subject": COHORT} | _average_differences(known)
            for pair, difference in known:
                person = {"subject": pair.subject, "label": pair.label, "people": 1}
                yield labels | person | difference.columns("difference")


def _pair_trials(trials: Sequence[ReachResult]) -> Iterator[_Pair]:
    """Yield the pairs of each person: right and left of each session, then successive sessions of each side."""
    sessions = list(dict.fromkeys(trial.session for trial in trials if trial.session))
    for subject, own in group_by(trials, lambda trial: trial.subject).items():
        groups = group_by(own, lambda trial: (trial.session, trial.side))
        for session in dict.fromkeys(trial.session for trial in own):
            right, left = (groups.get((session, side), []) for side in SIDES)
            if right and left:
                yield _Pair("left - right", subject, session, right, left)
        for side in SIDES:
            recorded = [session for session in sessions if (session, side) in groups]
            for before, after in pairwise(recorded):
                yield _Pair(f"{after} - {before}", subject, side, groups[before, side], groups[after, side])


def _average_differences(differences: Sequence[tuple[_Pair, Estimate]]) -> dict[str, Any]:
    """Return the columns of the cohort: mean over the people with its interval, and sd of all differences."""
    people = group_by(differences, lambda one: one[0].subject)
    means = [float(np.mean([difference.value for _, difference in own])) for own in people.values()]
    values = np.array([difference.value for _, difference in differences])
    sd = float(values.std(ddof=1)) if len(values) > 1 else np.nan
    return {"people": len(means), "sd": sd} | average_people(means).columns("difference")
