"""The tables of a robot study: the trials' rows, and their cells beside the thesis's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.workflows.robot_study.columns import OURS, TABLES, THESIS, TRIALS, Quantity, TableSpec
from mocap_id.workflows.robot_study.rows import REFERENCE, Case, trial_rows
from mocap_id.workflows.study.columns import frame

_ORDER = ("shoulder", "elbow", "wrist"), ("slow", "fast")


def tables(cases: Sequence[Case]) -> dict[str, pd.DataFrame]:
    """`trials` and every table of :data:`.columns.TABLES`."""
    trials = frame(TRIALS, trial_rows(cases))
    return {"trials": trials} | {spec.name: frame(spec.schema, _cells(spec, trials)) for spec in TABLES}


def _cells(spec: TableSpec, trials: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table: every cell that trials are there of, each with the thesis's below where it has one."""
    about = trials[trials["method"].isin(list(spec.methods)) & (trials["verdict"] != "failed")]
    keys = ["joint", "speed"] + (["orientation"] if spec.by_orientation else [])
    rows: list[dict[str, Any]] = []
    groups = [(key, group) for key, group in about.groupby(keys, dropna=False, sort=False)]
    for key, group in sorted(groups, key=lambda one: _place(one[0])):
        cell = dict(zip(keys, key, strict=True))
        for method, obs in spec.methods.items():
            own = group[group["method"] == method]
            if own.empty:
                continue
            label = {"orientation": np.nan} | cell | {"obs": obs}
            rows.append(label | {"source": OURS, "trials": len(own)} | _averages(spec.quantities, own))
            orientation: Any = cell.get("orientation")
            published = spec.published.get((str(cell["joint"]), str(cell["speed"]), orientation, obs))
            if published is not None:
                rows.append(label | {"source": THESIS, "trials": 0} | _published(spec.quantities, published))
    return rows


def _place(key: tuple[Any, ...]) -> tuple[Any, ...]:
    known = [order.index(name) if name in order else len(order) for order, name in zip(_ORDER, key, strict=False)]
    return (*known, *(str(part) for part in key))


def _averages(quantities: Sequence[Quantity], own: pd.DataFrame) -> dict[str, float]:
    row = {}
    for one in quantities:
        if one.kind == "value":
            values = _known(own[one.name])
            row[f"{one.name}_mean"] = float(np.mean(values)) if len(values) else np.nan
            given = not one.name.endswith("_r2") and (own["method"] == REFERENCE).all()  # not found, so without spread
            row[f"{one.name}_sd"] = float(np.std(values, ddof=1)) if len(values) > 1 and not given else np.nan
        else:
            bias, sd = _known(own[f"{one.name}_bias"]), _known(own[f"{one.name}_sd"])
            row[f"{one.name}_mean"] = float(np.mean(bias)) if len(bias) else np.nan
            row[f"{one.name}_sd"] = float(np.sqrt(np.mean(sd**2))) if len(sd) else np.nan
    return row


def _known(column: pd.Series[Any]) -> FloatArray:
    values = column.to_numpy(dtype=np.float64)
    return np.asarray(values[np.isfinite(values)])


def _published(quantities: Sequence[Quantity], row: Sequence[tuple[float, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one, (mean, sd) in zip(quantities, row, strict=False):  # ours may have more, at the end
        found |= {f"{one.name}_mean": one.to_si * mean, f"{one.name}_sd": one.to_si * sd}
    return found
