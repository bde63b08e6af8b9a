"""`parameters`: the base parameters of every trial with their deviations, beside those of the allometric body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from mocap_id.workflows.study.trial_results import TrialResult


def parameter_rows(trials: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `parameters`."""
    for trial in trials:
        found = trial.parameters
        if found is None:
            continue
        for k, symbol in enumerate(found.symbols):
            yield {
                "trial": trial.name,
                "subject": trial.subject,
                "strategy": trial.strategy,
                "parameter": symbol,
                "expression": found.expressions[k],
                "unit": found.units[k],
                "value": float(found.value[k]),
                "sd": float(found.sd[k]),
                "verdict": found.verdicts[k],
                "reference": float(found.reference[k]),
            }
