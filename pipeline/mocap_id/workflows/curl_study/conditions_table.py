"""`conditions`: every measure in every condition, over people and trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mocap_id.workflows.curl_study.trial_results import MEASURES, CurlResult
from mocap_id.workflows.study.estimates import over_people
from mocap_id.workflows.study.statistics import group_by


def condition_rows(trials: Sequence[CurlResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for every measure and condition in which it is known."""
    for name, measure in MEASURES.items():
        for condition, own in group_by(trials, lambda trial: trial.condition).items():
            known = [(trial.subject, value) for trial in own if np.isfinite(value := measure.of(trial))]
            if not known:
                continue
            people = group_by(known, lambda one: one[0])
            means = [float(np.mean([value for _, value in values])) for values in people.values()]
            ends = np.quantile([value for _, value in known], (0, 0.25, 0.5, 0.75, 1)).tolist()
            counts = {"people": len(people), "trials": len(known), "of_trials": len(own)}
            spread = dict(zip(("lowest", "q1", "median", "q3", "highest"), ends, strict=True))
            yield {"condition": condition, "measure": name} | counts | over_people(means).columns("mean") | spread
