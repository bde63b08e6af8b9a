"""`parameters`: the base parameters of every trial with their deviations, beside the allometric body's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from mocap_id.workflows.study.cases import Case


def rows(cases: Sequence[Case]) -> Iterator[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.PARAMETERS`."""
    for case in cases:
        found = case.parameters
        if found is None:
            continue
        names, numbers = (found.symbols, found.expressions, found.units), (found.value, found.sd, found.reference)
        rows_of = zip(*names, found.verdicts, *numbers, strict=True)
        for symbol, expression, unit, verdict, value, sd, reference in rows_of:
            yield {
                "trial": case.trial.name,
                "subject": case.subject,
                "strategy": case.strategy,
                "parameter": symbol,
                "expression": expression,
                "unit": unit,
                "value": float(value),
                "sd": float(sd),
                "verdict": verdict,
                "reference": float(reference),
            }
