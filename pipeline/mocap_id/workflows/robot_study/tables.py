"""The thesis's tables 5.1 to 5.6: each cell averaged over the trials, followed by the values in the thesis.

The values in the thesis come from ``thesis_tables.csv``, in the units of the thesis. A value is empty if the thesis
does not give it, or if it is illegible in our copy.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting.results.columns import ResultTable, number
from mocap_id.reporting.robot_study.tables import Quantity
from mocap_id.store import TableSchema
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
    """A table of the thesis with the quantities of its columns."""

    name: str
    title: str
    methods: Mapping[str, str]  # label in the thesis of each method
    quantities: tuple[Quantity, ...]  # quantities in the thesis in its order, then additional ones
    by_orientation: bool = False  # whether each orientation has its own row

    @property
    def schema(self) -> TableSchema:
        """Schema of the table's file."""
        pairs = (
            number(f"{one.name}_{part}", one.unit, f"{one.meaning}: {words}")
            for one in self.quantities
            for part, words in (("mean", "mean"), ("sd", "standard deviation"))
        )
        return TableSchema(f"{self.name}.parquet", 1, (*CELL, *pairs))


def _add_r2(name: str, unit: str, meaning: str, symbol: str) -> tuple[Quantity, Quantity]:
    return (
        Quantity(name, unit, meaning, symbol, "error"),
        Quantity(f"{name}_r2", "1", f"{meaning}: r²", f"{symbol} r²", decimals=5),
    )


_DYNAMICS = (
    Quantity("condition", "1", "condition number of the stacked regressor", "condition"),
    *(Quantity(name, unit, f"base parameter {name}", _SYMBOLS[name]) for name, unit in PARAMETER_UNITS.items()),
    *_add_r2("torque", "N*m", "torque of the model minus the encoder's", "ε_τ"),
)
_MEASURED = {"encoder": "R", "cameras": "P"}
_ALL = {"reference": "Ref.", **_MEASURED}

TABLES = (
    ThesisTable(
        "table_5_1",
        "Kinematic parameters and errors (thesis table 5.1)",
        {"cameras": "P"},
        (
            Quantity("base", "m", "distance of the joint from the plane's origin", "l₁", to_si=1e-3),
            Quantity("marker", "m", "distance of the markers from their prediction", "ε_M", "error", 1e-3),
            Quantity("theta", "rad", "angle minus the true or the encoder's angle", "ε_θ", "error", np.pi / 180),
            Quantity(
                "dtheta",
                "rad/s",
                "velocity minus the true or the encoder's velocity",
                "ε_θ̇",
                "error",
                np.pi / 180,
            ),
            Quantity("base_error", "m", "distance minus the distance of the reference", "l₁ − reference"),
        ),
        by_orientation=True,
    ),
    ThesisTable("table_5_2", "Dynamic parameters (thesis table 5.2)", _ALL, _DYNAMICS),
    ThesisTable(
        "table_5_3",
        "Joint states against the truth or the encoder (thesis table 5.3)",
        _MEASURED,
        tuple(
            quantity
            for name, unit in STATE_UNITS.items()
            for quantity in _add_r2(name, unit, f"{name} minus the truth's", _SYMBOLS[name])
        ),
    ),
    ThesisTable(
        "table_5_4",
        "Contact wrench of the models minus the measured one (thesis table 5.4)",
        _ALL,
        tuple(
            quantity
            for name, unit in WRENCH_UNITS.items()
            for quantity in _add_r2(name, unit, f"{name} of the model minus the measured", _SYMBOLS[name])
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
    """Return the table `trials` and the tables of the thesis by name."""
    table = ResultTable.of(TRIALS, trial_rows(trials))
    return {"trials": table} | {one.name: ResultTable.of(one.schema, _cell_rows(one, table.frame)) for one in TABLES}


def _cell_rows(table: ThesisTable, trials: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table: a row for each cell with trials, followed by the thesis's row for this cell."""
    in_thesis = read_published(table)
    passed = trials[trials["method"].isin(list(table.methods)) & (trials["verdict"] != "failed")]
    keys = ["joint", "speed"] + (["orientation"] if table.by_orientation else [])
    rows: list[dict[str, Any]] = []
    groups = [(key, group) for key, group in passed.groupby(keys, dropna=False, sort=False)]
    for key, group in sorted(groups, key=lambda one: _sort_key(one[0])):
        cell = dict(zip(keys, key, strict=True))
        for method, obs in table.methods.items():
            own = group[group["method"] == method]
            if own.empty:
                continue
            label = {"orientation": np.nan} | cell | {"obs": obs}
            rows.append(label | {"source": OURS, "trials": len(own)} | _average(table.quantities, own))
            orientation: Any = cell.get("orientation")
            published = in_thesis.get((str(cell["joint"]), str(cell["speed"]), orientation, obs))
            if published is not None:
                rows.append(label | {"source": THESIS, "trials": 0} | published)
    return rows


def read_published(table: ThesisTable) -> Mapping[tuple[str, str, float | None, str], dict[str, float]]:
    """Return the values in the thesis, SI, by joint, speed, orientation (degrees; None if unknown), and method."""
    text = files("mocap_id.workflows.robot_study").joinpath("thesis_tables.csv").read_text("utf-8")
    _, *lines = csv.reader(text.splitlines())
    rows = {}
    for name, joint, speed, orientation, obs, *cells in lines:
        if name == table.name:
            numbers = [float(cell or "nan") for cell in cells]
            key = (joint, speed, float(orientation) if orientation else None, obs)
            rows[key] = _name_published(table.quantities, numbers)
    return rows


def _name_published(quantities: Sequence[Quantity], numbers: Sequence[float]) -> dict[str, float]:
    """Return the columns of a row in SI units; ``numbers`` alternate between mean and standard deviation."""
    row: dict[str, float] = {}
    for one, mean, sd in zip(quantities, numbers[::2], numbers[1::2], strict=False):  # the thesis has fewer quantities
        row |= {f"{one.name}_mean": one.to_si * mean, f"{one.name}_sd": one.to_si * sd}
    return row


def _sort_key(key: tuple[Any, ...]) -> tuple[Any, ...]:
    known = [order.index(name) if name in order else len(order) for order, name in zip(_ORDER, key, strict=False)]
    return (*known, *(str(part) for part in key))


def _average(quantities: Sequence[Quantity], own: pd.DataFrame) -> dict[str, float]:
    row = {}
    for one in quantities:
        if one.kind == "value":
            values = _read_known(own[one.name])
            row[f"{one.name}_mean"] = float(np.mean(values)) if len(values) else np.nan
            # A reference parameter is given, not estimated, so it has no standard deviation.
            is_given = not one.name.endswith("_r2") and (own["method"] == REFERENCE).all()
            row[f"{one.name}_sd"] = float(np.std(values, ddof=1)) if len(values) > 1 and not is_given else np.nan
        else:
            bias, sd = _read_known(own[f"{one.name}_bias"]), _read_known(own[f"{one.name}_sd"])
            row[f"{one.name}_mean"] = float(np.mean(bias)) if len(bias) else np.nan
            row[f"{one.name}_sd"] = float(np.sqrt(np.mean(sd**2))) if len(sd) else np.nan
    return row


def _read_known(column: pd.Series[Any]) -> FloatArray:
    values = column.to_numpy(dtype=np.float64)
    return np.asarray(values[np.isfinite(values)])
