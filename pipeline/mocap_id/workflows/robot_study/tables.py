"""The thesis's tables 5.1 to 5.6: each cell from the trials' rows, beside the thesis's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting.results.columns import ResultTable, number
from mocap_id.reporting.robot_study.tables import Quantity
from mocap_id.store import TableSchema
from mocap_id.workflows.robot_study import published_values
from mocap_id.workflows.robot_study.trial_results import RobotTrialResult
from mocap_id.workflows.robot_study.trials_table import (
    CELL,
    PARAMETER_UNITS,
    REFERENCE,
    STATE_UNITS,
    TRIALS,
    WRENCH_UNITS,
    trial_rows,
)

OURS, THESIS = "this", "thesis"
_ORDER = ("shoulder", "elbow", "wrist"), ("slow", "fast")
_SYMBOLS = {
    "mass": "m₁+m₂", "mx1": "mx₁+Tₓm₂", "mx2": "mx₂", "my2": "my₂", "Izz2": "Izz₂",
    "theta": "ε_θ", "dtheta": "ε_θ̇", "ddtheta": "ε_θ̈", "Fx": "ε_Fx", "Fy": "ε_Fy", "tauz": "ε_τz",
}  # fmt: skip


@dataclass(frozen=True)
class ThesisTable:
    """A table of the thesis."""

    name: str
    title: str
    methods: Mapping[str, str]  # the thesis's label of each method in the table
    quantities: tuple[Quantity, ...]  # those of the thesis in its order, then ours
    by_orientation: bool = False  # orientations have rows of their own

    @cached_property
    def published(self) -> Mapping[published_values.Cell, published_values.Row]:
        """The thesis's rows."""
        return published_values.published(self.name)

    @property
    def schema(self) -> TableSchema:
        """Columns of the table's file."""
        pairs = (
            number(f"{one.name}_{part}", one.unit, f"{one.meaning}: {words}")
            for one in self.quantities
            for part, words in (("mean", "mean"), ("sd", "standard deviation"))
        )
        return TableSchema(f"{self.name}.parquet", 1, (*CELL, *pairs))


def _with_r2(name: str, unit: str, meaning: str, symbol: str) -> tuple[Quantity, Quantity]:
    return (
        Quantity(name, unit, meaning, symbol, "error"),
        Quantity(f"{name}_r2", "1", f"{meaning}: r²", f"{symbol} r²", decimals=5),
    )


_DYNAMICS = (
    Quantity("condition", "1", "condition number of the stacked regressor", "condition"),
    *(Quantity(name, unit, f"base parameter {name}", _SYMBOLS[name]) for name, unit in PARAMETER_UNITS.items()),
    *_with_r2("torque", "N*m", "torque of the model minus the encoder's", "ε_τ"),
)
_BOTH = {"encoder": "R", "cameras": "P"}
_ALL = {"reference": "Ref.", **_BOTH}

TABLES = (
    ThesisTable(
        "table_5_1",
        "Kinematic parameters and errors (thesis table 5.1)",
        {"cameras": "P"},
        (
            Quantity("base", "m", "distance of the joint from the plane's origin", "l₁", to_si=1e-3),
            Quantity("marker", "m", "distance of the markers from their prediction", "ε_M", "error", 1e-3),
            Quantity("theta", "rad", "angle minus that of the truth or the encoder", "ε_θ", "error", np.pi / 180),
            Quantity("dtheta", "rad/s", "velocity minus that of the truth or the encoder", "ε_θ̇", "error", np.pi / 180),
            Quantity("base_error", "m", "distance minus that of the reference", "l₁ − reference"),
        ),
        by_orientation=True,
    ),
    ThesisTable("table_5_2", "Dynamic parameters (thesis table 5.2)", _ALL, _DYNAMICS),
    ThesisTable(
        "table_5_3",
        "Joint states against the truth or the encoder (thesis table 5.3)",
        _BOTH,
        tuple(
            quantity
            for name, unit in STATE_UNITS.items()
            for quantity in _with_r2(name, unit, f"{name} minus the truth's", _SYMBOLS[name])
        ),
    ),
    ThesisTable(
        "table_5_4",
        "Contact wrench of the models minus the measured one (thesis table 5.4)",
        _ALL,
        tuple(
            quantity
            for name, unit in WRENCH_UNITS.items()
            for quantity in _with_r2(name, unit, f"{name} of the model minus the measured", _SYMBOLS[name])
        ),
    ),
    ThesisTable(
        "table_5_5_6",
        "Dynamic parameters by every method for the states (thesis tables 5.5 and 5.6)",
        {"cameras": "UKF", "differences": "Diff.", "differences-6": "Diff. 6 Hz", "spline": "Spline"},
        (
            *_DYNAMICS,
            Quantity(
                "ddtheta_r2", "1", "r² of the acceleration against the truth or the encoder", "ε_θ̈ r²", decimals=5
            ),
        ),
    ),
)


def make_tables(trials: Sequence[RobotTrialResult]) -> dict[str, ResultTable]:
    """Return the table `trials` and the tables of the thesis."""
    own = ResultTable.of(TRIALS, trial_rows(trials))
    return {"trials": own} | {one.name: ResultTable.of(one.schema, _cell_rows(one, own.frame)) for one in TABLES}


def _cell_rows(table: ThesisTable, trials: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table's rows: every cell that has trials, followed by the thesis's row of the same cell."""
    passed = trials[trials["method"].isin(list(table.methods)) & (trials["verdict"] != "failed")]
    keys = ["joint", "speed"] + (["orientation"] if table.by_orientation else [])
    rows: list[dict[str, Any]] = []
    groups = [(key, group) for key, group in passed.groupby(keys, dropna=False, sort=False)]
    for key, group in sorted(groups, key=lambda one: _order(one[0])):
        cell = dict(zip(keys, key, strict=True))
        for method, obs in table.methods.items():
            own = group[group["method"] == method]
            if own.empty:
                continue
            label = {"orientation": np.nan} | cell | {"obs": obs}
            rows.append(label | {"source": OURS, "trials": len(own)} | _averages(table.quantities, own))
            orientation: Any = cell.get("orientation")
            published = table.published.get((str(cell["joint"]), str(cell["speed"]), orientation, obs))
            if published is not None:
                rows.append(label | {"source": THESIS, "trials": 0} | _in_si(table.quantities, published))
    return rows


def _order(key: tuple[Any, ...]) -> tuple[Any, ...]:
    known = [order.index(name) if name in order else len(order) for order, name in zip(_ORDER, key, strict=False)]
    return (*known, *(str(part) for part in key))


def _averages(quantities: Sequence[Quantity], own: pd.DataFrame) -> dict[str, float]:
    row = {}
    for one in quantities:
        if one.kind == "value":
            values = _known(own[one.name])
            row[f"{one.name}_mean"] = float(np.mean(values)) if len(values) else np.nan
            # a reference parameter is given, not estimated, so it has no spread
            given = not one.name.endswith("_r2") and (own["method"] == REFERENCE).all()
            row[f"{one.name}_sd"] = float(np.std(values, ddof=1)) if len(values) > 1 and not given else np.nan
        else:
            bias, sd = _known(own[f"{one.name}_bias"]), _known(own[f"{one.name}_sd"])
            row[f"{one.name}_mean"] = float(np.mean(bias)) if len(bias) else np.nan
            row[f"{one.name}_sd"] = float(np.sqrt(np.mean(sd**2))) if len(sd) else np.nan
    return row


def _known(column: pd.Series[Any]) -> FloatArray:
    values = column.to_numpy(dtype=np.float64)
    return np.asarray(values[np.isfinite(values)])


def _in_si(quantities: Sequence[Quantity], row: Sequence[tuple[float, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one, (mean, sd) in zip(quantities, row, strict=False):  # ours has more quantities, at the end
        found |= {f"{one.name}_mean": one.to_si * mean, f"{one.name}_sd": one.to_si * sd}
    return found
