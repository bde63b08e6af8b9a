"""The tables of a sensitivity study: columns, units and meanings, and their rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable
from mocap_id.store import TableSchema
from mocap_id.workflows.sensitivity.responses import (
    STATE_NAMES,
    WRENCH_NAMES,
    Parameter,
    largest_ratio,
    tolerance_ratio,
)
from mocap_id.workflows.sensitivity.runs import PerturbationRun
from mocap_id.workflows.sensitivity.sentences import sentence
from mocap_id.workflows.sensitivity.tolerance import Point, Tolerance

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.study import SensitivityResult


@dataclass(frozen=True)
class Response:
    """The response of one parameter to one perturbation; ``after`` is None if the parameter is lost."""

    run: PerturbationRun
    before: Parameter
    after: Parameter | None
    tolerance: float

    @property
    def change(self) -> float:
        """Perturbed minus unperturbed value; NaN if the parameter is lost."""
        return math.nan if self.after is None else self.after.value - self.before.value

    def change_by(self, size: float, factor: float = 1.0) -> float:
        """Return the change relative to a size; NaN for a size of zero."""
        return factor * self.change / size if size > 0 else math.nan


def _broken(name: str, missing: Any) -> Any:
    def value(one: Tolerance) -> Any:
        point: Point | None = one.broken
        return missing if point is None else getattr(point, name)

    return value


_PERTURBATION = (
    Column("perturbation", "str", "", "kind, target and level", lambda row: row.run.perturbation.name),
    Column("kind", "str", "", "what was perturbed", lambda row: row.run.perturbation.kind),
    Column(
        "target",
        "str",
        "",
        "joint, component or marker sd (m) that it acted on; empty: everything alike",
        lambda row: row.run.perturbation.target,
    ),
    Column("level", "float64", "", "how much, in `level_unit`", lambda row: row.run.perturbation.level),
    Column(
        "level_unit",
        "str",
        "",
        "unit of the level; empty: a number of things",
        lambda row: row.run.perturbation.definition.unit,
    ),
)

RESPONSES = TableSchema(
    "responses.parquet",
    1,
    (
        *_PERTURBATION,
        Column("parameter", "str", "", "base parameter, or length of a segment", lambda row: row.before.name),
        Column("unit", "str", "", "of the parameter", lambda row: row.before.unit),
        Column("own_value", "float64", "", "unperturbed, in `unit`", lambda row: row.before.value),
        Column("own_sd", "float64", "", "its stated standard deviation, in `unit`", lambda row: row.before.sd),
        Column("value", "float64", "", "perturbed, in `unit`", lambda row: row.after and row.after.value),
        Column("sd", "float64", "", "its stated standard deviation, in `unit`", lambda row: row.after and row.after.sd),
        Column("change", "float64", "", "perturbed less unperturbed, in `unit`", lambda row: row.change),
        Column(
            "change_percent", "float64", "%", "of the parameter's size", lambda row: row.change_by(row.before.size, 100)
        ),
        Column(
            "change_sd",
            "float64",
            "1",
            "in stated standard deviations of the unperturbed parameter",
            lambda row: row.change_by(row.before.sd),
        ),
        Column(
            "ratio",
            "float64",
            "1",
            "size of the change over what is tolerated; infinite where it is lost",
            lambda row: tolerance_ratio(row.before, row.after, row.tolerance),
        ),
        Column(
            "judged",
            "str",
            "",
            "known, weak or not identifiable, by the perturbed trial",
            lambda row: row.after and row.after.verdict,
        ),
    ),
)

PERTURBATIONS = TableSchema(
    "perturbations.parquet",
    1,
    (
        *_PERTURBATION,
        Column("enters", "str", "", "the stage that saw it first"),
        Column("verdict", "str", "", "ok or caution, or refused or failed where there is no result"),
        Column("raised", "str", "", "codes that the unperturbed verdict has not"),
        Column("fallen", "str", "", "codes of the unperturbed verdict that are gone"),
        Column("ratio", "float64", "1", "largest change of a parameter over what is tolerated"),
        Column("parameter", "str", "", "whose change that is"),
        Column("tolerated", "bool", "", "ratio is at most 1"),
        Column("samples", "int64", "1", "of the fit"),
        Column("condition_number", "float64", "1", "of the regressor"),
        Column("clock_offset", "float64", "s", "that the program found"),
        *(Column(f"{name}_r2", "float64", "1", "of the model against the measurement") for name in WRENCH_NAMES),
        Column("cop_rms", "float64", "m", "rms error of the model's centre of pressure"),
        Column("theta_r2", "float64", "1", "worst joint's angle against the unperturbed one"),
        Column("dtheta_r2", "float64", "1", "worst joint's velocity against the unperturbed one"),
        Column("ddtheta_r2", "float64", "1", "worst joint's acceleration against the unperturbed one"),
        Column("theta_rms", "float64", "rad", "worst joint's angle off the unperturbed one, rms"),
    ),
    (Column("tau_{k}_rms", "float64", "N*m", "torque of the joint off the unperturbed one, rms"),),
    ((Column("why", "str", "", "why there is no result, or empty"),),),
)

TOLERATES = TableSchema(
    "tolerates.parquet",
    1,
    (
        Column("kind", "str", "", "what was perturbed", lambda one: one.kind.name),
        Column("target", "str", "", "what it acted on; empty: everything alike", lambda one: one.target),
        Column("low", "float64", "", "least tolerated level, in `level_unit`", lambda one: one.low),
        Column("high", "float64", "", "most tolerated level, interpolated, in `level_unit`", lambda one: one.high),
        Column("level_unit", "str", "", "unit of the levels; empty: a number of things", lambda one: one.kind.unit),
        Column(
            "least_tried", "float64", "", "mildest level tried", lambda one: one.points[0].level if one.points else None
        ),
        Column(
            "most_tried", "float64", "", "worst level tried", lambda one: one.points[-1].level if one.points else None
        ),
        Column("breaks_at", "float64", "", "level that is too much", _broken("level", None)),
        Column("parameter", "str", "", "the parameter that moves most there", _broken("parameter", "")),
        Column("change_percent", "float64", "%", "by so much of its size", _broken("percent", None)),
        Column(
            "silent",
            "str",
            "",
            "levels that are too much with no new caution in the verdict",
            lambda one: ", ".join(f"{level:g}" for level in one.silent),
        ),
        Column("sentence", "str", "", "the same for people", sentence),
    ),
)

TABLES: Mapping[str, TableSchema] = {
    "responses": RESPONSES,
    "perturbations": PERTURBATIONS,
    "tolerates": TOLERATES,
}
"""The schemas by table name."""


def make_tables(result: SensitivityResult) -> dict[str, ResultTable]:
    """Return every table of a sensitivity study."""
    return {
        "responses": ResultTable.of(RESPONSES, _responses(result)),
        "perturbations": ResultTable.of(PERTURBATIONS, (_perturbation(result, run) for run in result.runs)),
        "tolerates": ResultTable.of(TOLERATES, result.tolerances),
    }


def _responses(result: SensitivityResult) -> Iterator[Response]:
    for run in result.runs:
        after = {} if run.estimates is None else run.estimates.parameters
        for name, before in result.own.parameters.items():
            yield Response(run, before, after.get(name), result.options.tolerance)


def _perturbation(result: SensitivityResult, run: PerturbationRun) -> dict[str, Any]:
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
    row |= {f"{name}_r2": _least(r2) for name, r2 in zip(STATE_NAMES, run.changes.state_r2, strict=True)}
    row["theta_rms"] = -_least(-run.changes.angle_rms)
    if now is None:
        return row
    return row | {
        "verdict": now.level,
        "raised": ", ".join(sorted(now.codes - own.codes)),
        "fallen": ", ".join(sorted(own.codes - now.codes)),
        "samples": now.samples,
        "condition_number": now.condition,
        "clock_offset": now.offset,
        **{f"{name}_r2": r2 for name, r2 in zip(WRENCH_NAMES, now.wrench_r2, strict=True)},
        "cop_rms": now.cop_rms,
    }


def _least(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else math.nan
