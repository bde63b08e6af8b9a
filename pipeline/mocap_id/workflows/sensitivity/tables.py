"""The tables of a sensitivity study: columns, units and meanings, and their rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.sensitivity.kinds import COMPONENTS
from mocap_id.workflows.sensitivity.responses import STATE_NAMES, Parameter, largest_ratio, tolerance_ratio
from mocap_id.workflows.sensitivity.runs import PerturbationRun
from mocap_id.workflows.sensitivity.tolerance import Tolerance, describe_tolerance

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.study import SensitivityResult


@dataclass(frozen=True)
class Response:
    """The response of one parameter to one perturbation."""

    run: PerturbationRun
    before: Parameter
    after: Parameter | None  # None if the perturbed trial does not have the parameter
    tolerance: float

    @property
    def change(self) -> float:
        """Perturbed minus unperturbed value; NaN if there is no perturbed value."""
        return math.nan if self.after is None else self.after.value - self.before.value

    def divide_change(self, size: float, factor: float = 1.0) -> float:
        """Return ``factor`` times the change, divided by ``size``; NaN if ``size`` is zero or NaN."""
        return factor * self.change / size if size > 0 else math.nan


def _broken(name: str, missing: Any) -> Callable[[Tolerance], Any]:
    """Return a function that reads an attribute of a tolerance's ``broken`` level; ``missing`` without this level."""
    return lambda one: missing if one.broken is None else getattr(one.broken, name)


_KIND = "kind of the perturbation"
_PERTURBATION = (
    text("perturbation", "kind, target and level", lambda row: row.run.perturbation.name),
    text("kind", _KIND, lambda row: row.run.perturbation.kind),
    text(
        "target",
        "joint, component or marker sd (m) that was perturbed; empty: everything",
        lambda row: row.run.perturbation.target,
    ),
    number("level", "", "level of the perturbation, in `level_unit`", lambda row: row.run.perturbation.level),
    text("level_unit", "unit of the level; empty: a count", lambda row: row.run.perturbation.definition.unit),
)
_SD = "its stated standard deviation, in `unit`"

TABLES: Mapping[str, TableSchema] = {
    "responses": TableSchema(
        "responses.parquet",
        1,
        (
            *_PERTURBATION,
            text("parameter", "base parameter, or length of a segment", lambda row: row.before.name),
            text("unit", "unit of the parameter", lambda row: row.before.unit),
            number("own_value", "", "unperturbed value, in `unit`", lambda row: row.before.value),
            number("own_sd", "", _SD, lambda row: row.before.sd),
            number("value", "", "perturbed value, in `unit`", lambda row: row.after and row.after.value),
            number("sd", "", _SD, lambda row: row.after and row.after.sd),
            number("change", "", "perturbed minus unperturbed value, in `unit`", lambda row: row.change),
            number(
                "change_percent",
                "%",
                "change relative to the parameter's size",
                lambda row: row.divide_change(row.before.size, 100),
            ),
            number(
                "change_sd",
                "1",
                "change in stated standard deviations of the unperturbed parameter",
                lambda row: row.divide_change(row.before.sd),
            ),
            number(
                "ratio",
                "1",
                "absolute change divided by the tolerated change; infinite if there is no perturbed value",
                lambda row: tolerance_ratio(row.before, row.after, row.tolerance),
            ),
            text(
                "judged",
                "verdict in the perturbed trial: known, weak or not identifiable",
                lambda row: row.after and row.after.verdict,
            ),
        ),
    ),
    "perturbations": TableSchema(
        "perturbations.parquet",
        1,
        (
            *_PERTURBATION,
            text("enters", "the first stage that the perturbation affects"),
            text("verdict", "ok or caution; refused or failed if there is no result"),
            text("raised", "codes that are new in the perturbed verdict"),
            text("fallen", "codes of the unperturbed verdict that no longer occur"),
            number("ratio", "1", "largest change of a parameter divided by the tolerated change"),
            text("parameter", "the parameter with the largest change"),
            Column("tolerated", "bool", "", "whether the ratio is at most 1"),
            whole("samples", "number of samples of the fit"),
            number("condition_number", "1", "condition number of the regressor"),
            number("clock_offset", "s", "clock offset that the program estimated"),
            *(number(f"{name}_r2", "1", "r² of the model relative to the measurement") for name in COMPONENTS),
            number("cop_rms", "m", "rms error of the model's centre of pressure"),
            number("theta_r2", "1", "r² of the worst joint's angle relative to the unperturbed angle"),
            number("dtheta_r2", "1", "r² of the worst joint's velocity relative to the unperturbed velocity"),
            number("ddtheta_r2", "1", "r² of the worst joint's acceleration relative to the unperturbed one"),
            number("theta_rms", "rad", "change of the worst joint's angle, rms"),
        ),
        (number("tau_{k}_rms", "N*m", "change of the joint's torque, rms"),),
        ((text("why", "why there is no result; empty otherwise"),),),
    ),
    "tolerates": TableSchema(
        "tolerates.parquet",
        1,
        (
            text("kind", _KIND, lambda one: one.kind.name),
            text("target", "what was perturbed; empty: everything", lambda one: one.target),
            number("low", "", "lowest tolerated level, in `level_unit`", lambda one: one.low),
            number("high", "", "highest tolerated level, interpolated, in `level_unit`", lambda one: one.high),
            text("level_unit", "unit of the levels; empty: a count", lambda one: one.kind.unit),
            number("least_tried", "", "mildest level tried", lambda one: one.points[0].level if one.points else None),
            number("most_tried", "", "worst level tried", lambda one: one.points[-1].level if one.points else None),
            number("breaks_at", "", "mildest level that is not tolerated", _broken("level", None)),
            text("parameter", "the parameter with the largest change at this level", _broken("parameter", "")),
            number("change_percent", "%", "its change, relative to its size", _broken("percent", None)),
            text(
                "silent",
                "levels that are not tolerated and give no new caution in the verdict",
                lambda one: ", ".join(f"{level:g}" for level in one.silent),
            ),
            text("sentence", "the content of the row as a sentence", describe_tolerance),
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(result: SensitivityResult) -> dict[str, ResultTable]:
    """Return the tables of a sensitivity study by name."""
    rows = {
        "responses": _list_responses(result),
        "perturbations": (_describe_run(result, run) for run in result.runs),
        "tolerates": result.tolerances,
    }
    return {name: ResultTable.of(schema, rows[name]) for name, schema in TABLES.items()}


def _list_responses(result: SensitivityResult) -> Iterator[Response]:
    for run in result.runs:
        after = {} if run.estimates is None else run.estimates.parameters
        for name, before in result.own.parameters.items():
            yield Response(run, before, after.get(name), result.options.tolerance)


def _describe_run(result: SensitivityResult, run: PerturbationRun) -> dict[str, Any]:
    """Return the row of a run in the table `perturbations`."""
    own, now, change = result.own, run.estimates, run.perturbation
    ratio, parameter = largest_ratio(own, now, result.judged_parameters, result.options.tolerance)
    row = {
        "perturbation": change.name,
        "kind": change.kind,
        "target": change.target,
        "level": change.level,
        "level_unit": change.definition.unit,
        "enters": change.definition.entry,
        "verdict": "refused" if run.refused else "failed",
        "ratio": ratio,
        "parameter": parameter,
        "tolerated": ratio <= 1,
        "samples": 0,
        "why": run.why,
    }
    row |= {f"tau_{j}_rms": float(rms) for j, rms in enumerate(run.changes.torque_rms, start=1)}
    row |= {f"{name}_r2": _find_least(r2) for name, r2 in zip(STATE_NAMES, run.changes.state_r2, strict=True)}
    row["theta_rms"] = -_find_least(-run.changes.angle_rms)
    if now is None:
        return row
    return row | {
        "verdict": now.level,
        "raised": ", ".join(sorted(now.codes - own.codes)),
        "fallen": ", ".join(sorted(own.codes - now.codes)),
        "samples": now.samples,
        "condition_number": now.condition,
        "clock_offset": now.offset,
        **{f"{name}_r2": r2 for name, r2 in zip(COMPONENTS, now.wrench_r2, strict=True)},
        "cop_rms": now.cop_rms,
    }


def _find_least(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else math.nan
