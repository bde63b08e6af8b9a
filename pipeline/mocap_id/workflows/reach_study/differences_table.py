"""`differences`: left against right, and session against session, of every person and on average."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.reach_study.people_table import of_side
from mocap_id.workflows.reach_study.trial_results import MEASURES, SIDES, Measure, ReachResult
from mocap_id.workflows.study.estimates import Estimate, over_people
from mocap_id.workflows.study.statistics import group_by


@dataclass(frozen=True)
class _Pair:
    """Two groups of trials of one person, equal in all but side or session."""

    comparison: str  # such as ``left - right``
    subject: str
    label: str  # session or side that both have
    first: Sequence[ReachResult]
    second: Sequence[ReachResult]

    def difference(self, measure: Measure) -> Estimate:
        """Return second minus first."""
        return _mean(self.second, measure).minus(_mean(self.first, measure))


def difference_rows(trials: Sequence[ReachResult]) -> Iterator[dict[str, Any]]:
    """Yield, for every comparison and measure, the row of the cohort and those of the people."""
    for comparison, pairs in group_by(_pairs(trials), lambda pair: pair.comparison).items():
        for name, measure in MEASURES.items():
            found = [(pair, pair.difference(measure)) for pair in pairs]
            known = [(pair, each) for pair, each in found if np.isfinite(each.value)]
            if not known:
                continue
            yield {"comparison": comparison, "measure": name, "subject": COHORT} | _over_people(known)
            for pair, each in known:
                labels = {"comparison": comparison, "measure": name, "subject": pair.subject, "label": pair.label}
                yield labels | {"people": 1} | each.columns("difference")


def _pairs(trials: Sequence[ReachResult]) -> Iterator[_Pair]:
    sessions = list(dict.fromkeys(trial.session for trial in trials if trial.session))
    for subject, own in group_by(trials, lambda trial: trial.subject).items():
        groups = group_by(own, lambda trial: (trial.session, trial.side))
        for session in dict.fromkeys(trial.session for trial in own):
            right, left = (groups.get((session, side), []) for side in SIDES)
            if right and left:
                yield _Pair("left - right", subject, session, right, left)
        for side in SIDES:
            done = [session for session in sessions if (session, side) in groups]
            for before, after in pairwise(done):
                yield _Pair(f"{after} - {before}", subject, side, groups[before, side], groups[after, side])


def _over_people(found: Sequence[tuple[_Pair, Estimate]]) -> dict[str, Any]:
    """Return the mean over the people of their mean differences, with Student's interval, and the spread of all."""
    of_person = group_by(found, lambda one: one[0].subject)
    means = [float(np.mean([each.value for _, each in own])) for own in of_person.values()]
    every = np.array([each.value for _, each in found])
    sd = float(every.std(ddof=1)) if len(every) > 1 else np.nan
    return {"people": len(means), "sd": sd} | over_people(means).columns("difference")


def _mean(trials: Sequence[ReachResult], measure: Measure) -> Estimate:
    return of_side(trials, trials[0].side, measure)
