"""`variation`: how much base and modified base parameters vary over a person's trials (thesis figure 6.8).

A segment's frame turns a little from trial to trial, and takes mx into my. The modified parameters are free of that:
for each segment of which both are known they hold

    mr = |(mx, my)|

with all that is regrouped into mx and my. Of the base only mx is a base parameter; it stays as it is.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.cohort.material import COHORT
from mocap_id.workflows.study.cases import Case, Parameters
from mocap_id.workflows.study.statistics import groups, mean_sd

BASE, MODIFIED = "base", "modified"
_ROUNDING = 1e-9  # kg, kg m, kg m²: the table's body has its masses on the lines between the joints


@dataclass(frozen=True)
class Parameter:
    """One parameter of a trial: its names, unit and value, and what the allometric body has."""

    symbol: str
    expression: str
    unit: str
    value: float
    reference: float


def rows(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.VARIATION`: every person's, then the cohort's."""
    own = [
        row
        for subject, theirs in groups(cases, lambda case: case.subject).items()
        for row in _person(subject, [case.parameters for case in theirs if case.parameters is not None])
    ]
    return [*own, *_cohort(own)]


def base(parameters: Parameters) -> list[Parameter]:
    """The base parameters as they are."""
    columns = (parameters.symbols, parameters.expressions, parameters.units, parameters.value, parameters.reference)
    return [
        Parameter(symbol, expression, unit, float(value), float(reference))
        for symbol, expression, unit, value, reference in zip(*columns, strict=True)
    ]


def modified(parameters: Parameters) -> list[Parameter]:
    """The same with every (mx, my) as one length."""
    by_name = {parameter.symbol: parameter for parameter in base(parameters)}
    found = []
    for symbol, parameter in by_name.items():
        other = by_name.get(symbol.replace("mx", "my")) if symbol.startswith("mx") else None
        if other is not None:
            found.append(_length(parameter, other))
        elif not (symbol.startswith("my") and symbol.replace("my", "mx") in by_name):
            found.append(parameter)
    return found


def _length(mx: Parameter, my: Parameter) -> Parameter:
    return Parameter(
        mx.symbol.replace("mx", "mr"),
        f"|({mx.expression}, {my.expression})|",
        mx.unit,
        math.hypot(mx.value, my.value),
        math.hypot(mx.reference, my.reference),
    )


def _person(subject: str, trials: Sequence[Parameters]) -> Iterator[dict[str, Any]]:
    """Over the trials whose chains have as many segments as most have."""
    if not trials:
        return
    segments = Counter(trial.segments for trial in trials).most_common(1)[0][0]
    alike = [trial for trial in trials if trial.segments == segments]
    left_out = len(trials) - len(alike)
    why = f"{left_out} trials have another number of segments and do not count" if left_out else ""
    for kind, of in ((BASE, base), (MODIFIED, modified)):
        for same in zip(*map(of, alike), strict=True):
            mean, sd, cv = _variation(np.array([parameter.value for parameter in same]))
            expected, spread, share = _variation(np.array([parameter.reference for parameter in same]))
            yield {
                "subject": subject,
                "set": kind,
                "parameter": same[0].symbol,
                "expression": same[0].expression,
                "unit": same[0].unit,
                "segments": segments,
                "subjects": 1,
                "trials": len(alike),
                "mean": mean,
                "sd": sd,
                "cv": cv,
                "reference_mean": expected,
                "reference_sd": spread,
                "reference_cv": share,
                "why": why if len(alike) > 1 else "one trial shows no variation",
            }


def _variation(values: FloatArray) -> tuple[float, float, float]:
    """Mean, standard deviation and coefficient of variation; none of what is zero by construction, but for rounding."""
    mean, sd = mean_sd(values.tolist())
    return mean, sd, sd / abs(mean) if abs(mean) > _ROUNDING else math.nan


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Mean and spread of the people's coefficients of variation."""
    known = [row for row in own if row["trials"] > 1]
    keys = ("set", "parameter", "expression", "unit", "segments")
    for alike in groups(known, lambda row: "\n".join(str(row[key]) for key in keys)).values():
        cv, reference = mean_sd(row["cv"] for row in alike), mean_sd(row["reference_cv"] for row in alike)
        yield {
            **{key: alike[0][key] for key in keys},
            "subject": COHORT,
            "subjects": len(alike),
            "trials": sum(row["trials"] for row in alike),
            "cv": cv[0],
            "cv_sd": cv[1],
            "reference_cv": reference[0],
            "reference_cv_sd": reference[1],
        }
