"""Rows of the tables `parameters` and `variation`: base parameters, and their variation over trials (figure 6.8).

A segment's coordinate frame rotates slightly from trial to trial, which mixes mx and my. The modified parameters do not
depend on this rotation. If both mx and my of a segment are known, they are replaced by

    mr = |(mx, my)|

where mx and my include everything that is regrouped into them. The base segment has only mx, which does not change.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, mean_sd
from mocap_id.workflows.study.trial_results import BaseParameters, TrialResult

_ROUNDING = 1e-9  # kg, kg m, kg m²: the allometric body has its masses on the lines between the joints
_GROUP = ("set", "parameter", "expression", "unit", "segments")


@dataclass(frozen=True)
class ParameterValue:
    """One parameter of a trial."""

    symbol: str
    expression: str  # the parameters that are regrouped into this parameter
    unit: str
    value: float
    reference: float  # value for the allometric body


def parameter_rows(trials: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `parameters`: one for each base parameter of each trial."""
    for trial in trials:
        parameters = trial.parameters
        if parameters is None:
            continue
        labels = {"trial": trial.name, "subject": trial.subject, "strategy": trial.strategy}
        for one, sd, verdict in zip(_base(parameters), parameters.sd, parameters.verdicts, strict=True):
            yield labels | {
                "parameter": one.symbol,
                "expression": one.expression,
                "unit": one.unit,
                "value": one.value,
                "sd": float(sd),
                "verdict": verdict,
                "reference": one.reference,
            }


def variation_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `variation`: first the rows of all people, then the rows of the cohort."""
    rows = [
        row
        for subject, own in group_by(trials, lambda trial: trial.subject).items()
        for row in _person(subject, [trial.parameters for trial in own if trial.parameters is not None])
    ]
    return [*rows, *_cohort(rows)]


def _base(parameters: BaseParameters) -> list[ParameterValue]:
    columns = (parameters.symbols, parameters.expressions, parameters.units, parameters.value, parameters.reference)
    return [
        ParameterValue(symbol, expression, unit, float(value), float(reference))
        for symbol, expression, unit, value, reference in zip(*columns, strict=True)
    ]


def _modify(parameters: BaseParameters) -> list[ParameterValue]:
    """Return the modified parameters, in which the length mr replaces each pair (mx, my)."""
    by_symbol = {parameter.symbol: parameter for parameter in _base(parameters)}
    modified = []
    for symbol, mx in by_symbol.items():
        my = by_symbol.get(symbol.replace("mx", "my")) if symbol.startswith("mx") else None
        if my is not None:
            value, reference = math.hypot(mx.value, my.value), math.hypot(mx.reference, my.reference)
            expression = f"|({mx.expression}, {my.expression})|"
            modified.append(ParameterValue(symbol.replace("mx", "mr"), expression, mx.unit, value, reference))
        elif not (symbol.startswith("my") and symbol.replace("my", "mx") in by_symbol):
            modified.append(mx)
    return modified


def _person(subject: str, trials: Sequence[BaseParameters]) -> Iterator[dict[str, Any]]:
    """Yield a person's rows, from the trials whose chains have the most frequent number of segments."""
    if not trials:
        return
    segments = Counter(trial.segments for trial in trials).most_common(1)[0][0]
    counted = [trial for trial in trials if trial.segments == segments]
    left_out = len(trials) - len(counted)
    why = f"trials with a different number of segments, which do not count: {left_out}" if left_out else ""
    for kind, read in (("base", _base), ("modified", _modify)):
        for same in zip(*map(read, counted), strict=True):
            yield {
                "subject": subject,
                "set": kind,
                "parameter": same[0].symbol,
                "expression": same[0].expression,
                "unit": same[0].unit,
                "segments": segments,
                "subjects": 1,
                "trials": len(counted),
                **_variation("", [parameter.value for parameter in same]),
                **_variation("reference_", [parameter.reference for parameter in same]),
                "why": why if len(counted) > 1 else "a single trial has no variation",
            }


def _variation(prefix: str, values: Sequence[float]) -> dict[str, float]:
    """Return the columns mean, sd and cv; the coefficient of variation cv is NaN if the mean is zero."""
    mean, sd = mean_sd(values)
    cv = sd / abs(mean) if abs(mean) > _ROUNDING else math.nan
    return {f"{prefix}mean": mean, f"{prefix}sd": sd, f"{prefix}cv": cv}


def _cohort(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield rows with mean and standard deviation of the people's coefficients of variation."""
    known = [row for row in people if row["trials"] > 1]
    for group, rows in group_by(known, lambda row: tuple(row[name] for name in _GROUP)).items():
        cv, reference = mean_sd(row["cv"] for row in rows), mean_sd(row["reference_cv"] for row in rows)
        yield {
            **dict(zip(_GROUP, group, strict=True)),
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            "cv": cv[0],
            "cv_sd": cv[1],
            "reference_cv": reference[0],
            "reference_cv_sd": reference[1],
        }
