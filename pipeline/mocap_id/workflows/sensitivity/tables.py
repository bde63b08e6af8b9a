"""The rows of a sensitivity study's tables, and its document for programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.store import hash_bytes
from mocap_id.store.parquet import columns_of
from mocap_id.workflows.sensitivity.columns import TABLES
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.responses import STATE_NAMES, WRENCH_NAMES, Parameter, Result, ratio, worst
from mocap_id.workflows.sensitivity.studied import Studied
from mocap_id.workflows.sensitivity.telling import sentence
from mocap_id.workflows.sensitivity.tolerance import Tolerance
from mocap_id.workflows.sensitivity.trying import Tried
from mocap_id.workflows.study.columns import frame


def tables(studied: Studied) -> dict[str, pd.DataFrame]:
    """Every table of :data:`mocap_id.workflows.sensitivity.columns.TABLES`."""
    rows: Mapping[str, Iterable[Mapping[str, Any]]] = {
        "responses": (row for one in studied.tried for row in _responses(studied.own, one, studied.asked.tolerance)),
        "perturbations": (_perturbation(studied, one) for one in studied.tried),
        "tolerates": map(_tolerates, studied.tolerates),
    }
    return {name: frame(schema, rows[name]) for name, schema in TABLES.items()}


def _which(change: Perturbation) -> dict[str, Any]:
    unit = change.of.unit
    return {"kind": change.kind, "target": change.target, "level": change.level, "level_unit": unit}


def _responses(own: Result, one: Tried, share: float) -> Iterator[dict[str, Any]]:
    for name, before in own.parameters.items():
        now = one.result.parameters.get(name) if one.result is not None else None
        change = math.nan if now is None else now.value - before.value
        yield {
            "perturbation": one.change.name,
            **_which(one.change),
            "parameter": name,
            "unit": before.unit,
            "own_value": before.value,
            "own_sd": before.sd,
            "value": math.nan if now is None else now.value,
            "sd": math.nan if now is None else now.sd,
            "change": change,
            "change_percent": _over(100 * change, before.size),
            "change_sd": _over(change, before.sd),
            "ratio": ratio(before, now, share),
            "judged": "" if now is None else now.verdict,
        }


def _over(value: float, size: float) -> float:
    return value / size if size > 0 else math.nan


def _perturbation(studied: Studied, one: Tried) -> dict[str, Any]:
    own = studied.own
    beyond, parameter = worst(own, one.result, studied.counted, studied.asked.tolerance)
    row = {
        "perturbation": one.change.name,
        **_which(one.change),
        "enters": one.change.of.entry,
        "verdict": "refused" if one.refused else "failed",
        "ratio": beyond,
        "parameter": parameter,
        "tolerated": beyond <= 1,
        "samples": 0,
        "why": one.why,
    }
    row |= {f"tau_{j}_rms": float(rms) for j, rms in enumerate(one.moved.torque_rms, start=1)}
    row |= {f"{name}_r2": _least(r2) for name, r2 in zip(STATE_NAMES, one.moved.state_r2, strict=True)}
    row["theta_rms"] = -_least(-one.moved.angle_rms)
    return row if one.result is None else row | _found(own, one.result)


def _found(own: Result, now: Result) -> dict[str, Any]:
    return {
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


def _tolerates(one: Tolerance) -> dict[str, Any]:
    tried, broken = [point.level for point in one.points], one.broken
    return {
        "kind": one.kind.name,
        "target": one.target,
        "low": one.low,
        "high": one.high,
        "level_unit": one.kind.unit,
        "least_tried": tried[0] if tried else math.nan,
        "most_tried": tried[-1] if tried else math.nan,
        "breaks_at": math.nan if broken is None else broken.level,
        "parameter": "" if broken is None else broken.parameter,
        "change_percent": math.nan if broken is None else broken.percent,
        "silent": ", ".join(f"{level:g}" for level in one.silent),
        "sentence": sentence(one),
    }


def document(studied: Studied, frames: Mapping[str, pd.DataFrame], files: Mapping[str, bytes]) -> dict[str, Any]:
    """What sensitivity.json holds: the unperturbed trial, what it tolerates, and what every file and column is."""
    own = studied.own
    return {
        "schema": "mocap-id/sensitivity",
        "version": 1,
        "trial": studied.trial,
        "product": __version__,
        "seed": studied.asked.seed,
        "tolerance": {"share_of_size": studied.asked.tolerance, "or_stated_sd": 1.0},
        "note": studied.note or None,
        "verdict": {"level": own.level, "codes": sorted(own.codes)},
        "condition_number": _known(own.condition),
        "parameters": [_parameter(one) for one in own.parameters.values()],
        "tolerates": _records(frames["tolerates"]),
        "perturbations": _records(frames["perturbations"]),
        "tables": {
            name: [
                {"name": column.name, "unit": column.unit, "meaning": column.meaning}
                for column in columns_of(TABLES[name], list(table.columns))
            ]
            for name, table in frames.items()
        },
        "files": {file: hash_bytes(content) for file, content in files.items()},
    }


def _parameter(one: Parameter) -> dict[str, Any]:
    return {
        "name": one.name,
        "unit": one.unit,
        "value": _known(one.value),
        "sd": _known(one.sd),
        "size": _known(one.size),
        "verdict": one.verdict or None,
    }


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """JSON rows; null where a number is not known."""
    rows = table.to_dict(orient="records")
    return [{str(k): _known(v) if isinstance(v, float) else v for k, v in row.items()} for row in rows]


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
