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
        columns = (found.symbols, found.expressions, found.units, found.value, found.sd, found.reference)
        for symbol, expression, unit, value, sd, reference in zip(*columns, strict=True):
            yield {
                "trial": case.trial.name,
                "subject": case.subject,
                "strategy": case.strategy,
                "parameter": symbol,
                "expression": expression,
                "unit": unit,
                "value": float(value),
                "sd": float(sd),
                "reference": float(reference),
            }
