"""`variation`: how much base and modified base parameters vary over a person's trials (thesis figure 6.8).

A segment's frame turns a little from trial to trial, which mixes mx and my. The modified parameters do not depend on
it. If both mx and my of a segment are known, they are replaced by

    mr = |(mx, my)|

where mx and my include everything that is regrouped into them. The base segment has only mx, which is kept.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, mean_sd
from mocap_id.workflows.study.trial_results import BaseParameters, TrialResult

_ROUNDING = 1e-9  # kg, kg m, kg m²: the table's body has its masses on the lines between the joints
_GROUP = ("set", "parameter", "expression", "unit", "segments")


@dataclass(frozen=True)
class ParameterValue:
    """One parameter of a trial: names, unit, value, and the value of the allometric body."""

    symbol: str
    expression: str
    unit: str
    value: float
    reference: float


def variation_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `variation`: those of each person, then those of the cohort."""
    own = [
        row
        for subject, theirs in group_by(trials, lambda trial: trial.subject).items()
        for row in _person(subject, [trial.parameters for trial in theirs if trial.parameters is not None])
    ]
    return [*own, *_cohort(own)]


def base(parameters: BaseParameters) -> list[ParameterValue]:
    """Return the base parameters."""
    columns = (parameters.symbols, parameters.expressions, parameters.units, parameters.value, parameters.reference)
    return [
        ParameterValue(symbol, expression, unit, float(value), float(reference))
        for symbol, expression, unit, value, reference in zip(*columns, strict=True)
    ]


def modified(parameters: BaseParameters) -> list[ParameterValue]:
    """Return the base parameters with every (mx, my) as one length mr."""
    by_name = {parameter.symbol: parameter for parameter in base(parameters)}
    found = []
    for symbol, parameter in by_name.items():
        other = by_name.get(symbol.replace("mx", "my")) if symbol.startswith("mx") else None
        if other is not None:
            found.append(_length(parameter, other))
        elif not (symbol.startswith("my") and symbol.replace("my", "mx") in by_name):
            found.append(parameter)
    return found


def _length(mx: ParameterValue, my: ParameterValue) -> ParameterValue:
    return ParameterValue(
        mx.symbol.replace("mx", "mr"),
        f"|({mx.expression}, {my.expression})|",
        mx.unit,
        math.hypot(mx.value, my.value),
        math.hypot(mx.reference, my.reference),
    )


def _person(subject: str, trials: Sequence[BaseParameters]) -> Iterator[dict[str, Any]]:
    """Return the variation over the trials whose chains have the most common number of segments."""
    if not trials:
        return
    segments = Counter(trial.segments for trial in trials).most_common(1)[0][0]
    counted = [trial for trial in trials if trial.segments == segments]
    left_out = len(trials) - len(counted)
    why = f"{left_out} trials have another number of segments and do not count" if left_out else ""
    for kind, parameters in (("base", base), ("modified", modified)):
        for same in zip(*map(parameters, counted), strict=True):
            yield {
                "subject": subject,
                "set": kind,
                "parameter": same[0].symbol,
                "expression": same[0].expression,
                "unit": same[0].unit,
                "segments": segments,
                "subjects": 1,
                "trials": len(counted),
                **_variation("", np.array([parameter.value for parameter in same])),
                **_variation("reference_", np.array([parameter.reference for parameter in same])),
                "why": why if len(counted) > 1 else "one trial shows no variation",
            }


def _variation(prefix: str, values: FloatArray) -> dict[str, float]:
    """Return mean, standard deviation and coefficient of variation; no coefficient for a value that is zero."""
    mean, sd = mean_sd(values.tolist())
    cv = sd / abs(mean) if abs(mean) > _ROUNDING else math.nan
    return {f"{prefix}mean": mean, f"{prefix}sd": sd, f"{prefix}cv": cv}


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Return mean and spread of the people's coefficients of variation."""
    known = [row for row in own if row["trials"] > 1]
    for rows in group_by(known, lambda row: tuple(row[name] for name in _GROUP)).values():
        cv, reference = mean_sd(row["cv"] for row in rows), mean_sd(row["reference_cv"] for row in rows)
        yield {
            **{name: rows[0][name] for name in _GROUP},
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            "cv": cv[0],
            "cv_sd": cv[1],
            "reference_cv": reference[0],
            "reference_cv_sd": reference[1],
        }
