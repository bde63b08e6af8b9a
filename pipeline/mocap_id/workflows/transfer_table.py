"""What came of a transfer, for people, programs and spreadsheets."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from mocap_id.dynamics.predict import Agreement
from mocap_id.errors import ConfigError
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.transfer import Applied, Body, Transfer, rms
from mocap_id.workflows.transfer_support import AT_HOME, SERIES, Support

FORMATS = (".csv", ".parquet")
"""Endings of the files that :func:`write` makes."""


def check_format(file: Path) -> None:
    """ConfigError where a file's ending is none of :data:`FORMATS`; asked before anything is computed."""
    if file.suffix.lower() not in FORMATS:
        raise ConfigError(f"--out {file}: expected a file name that ends in {' or '.join(FORMATS)}")


def write(found: Transfer, file: Path) -> None:
    """Write the table as CSV or Parquet; the units are in the Parquet file's field metadata.

    Raises
    ------
    ConfigError
        The file's ending is neither.
    StoreError
        The file cannot be written.
    """
    check_format(file)
    table, stream = _arrow(found), io.BytesIO()
    if file.suffix.lower() == ".csv":
        pyarrow.csv.write_csv(table, stream)
    else:
        pyarrow.parquet.write_table(table, stream)
    with explained(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    replace_together(file.parent, {file.name: stream.getvalue()})


def as_frame(found: Transfer) -> pd.DataFrame:
    """One row a trial and body.

    Columns are trial, model (where the body comes from), body, samples, condition_number; mean, sd and rms of the
    error of each of Fx, Fy (N), tauz (N·m) and cop_x (m), model less measurement; mean and sd of what the joint torques
    tau_1 … differ from the trial's own model's (N·m); the largest residual of the registration (m); whether the
    recordings support the transfer, empty where it could not be shown.
    """
    joints = range(1, found.joints + 1)
    frame = pd.DataFrame([_row(found, trial, body, joints) for trial in found.trials for body in trial.bodies])
    return frame.astype({"supported": "boolean"})


def as_json(found: Transfer) -> dict[str, Any]:
    """The same with the registration of every segment and the reasons; null where a number is not known."""
    return {
        "schema": "mocap-id/transfer",
        "version": 1,
        "model": found.model,
        "segments": list(found.segments),
        "trials": [_trial(found, trial) for trial in found.trials],
    }


def _trial(found: Transfer, trial: Applied) -> dict[str, Any]:
    lie = trial.registration
    return {
        "trial": trial.trial,
        "samples": trial.samples,
        "condition_number": trial.condition,
        "bodies": [
            {
                "body": body.name,
                "errors": {name: _numbers(error) for name, error in body.errors.items()},
                "torques": [_numbers(difference) for difference in body.torques] or None,
            }
            for body in trial.bodies
        ],
        "registration": [
            {
                "segment": name,
                "angle_deg": math.degrees(lie.angle[k]),
                "shift_m": lie.shift[k].tolist(),
                "markers": int(lie.markers[k]),
                "residual_m": float(lie.residual[k]) if math.isfinite(lie.residual[k]) else None,
            }
            for k, name in enumerate(found.segments)
        ],
        "joint_apart_m": [_finite(distance) for distance in lie.joint.tolist()],
        "supported": trial.supported,
        "support": None if trial.support is None else _support(trial.support),
        "intervals": {
            name: {"sd_rms": _finite(trial.stated[name]), "inside": _finite(trial.inside[name]), "unit": unit}
            for name, unit in SERIES.items()
        },
        "reasons": [reason.as_dict() for reason in trial.reasons],
    }


def _support(known: Support) -> dict[str, Any]:
    """Carried less table over the trial's states, its standard deviation, and the error at home over the table's."""
    return {
        name: {
            "apart_rms": _finite(known.apart[name]),
            "sd_rms": _finite(known.sd[name]),
            "at_home": _finite(known.at_home[name]),
            "unit": SERIES[name],
        }
        for name in AT_HOME
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _numbers(error: Agreement | None) -> dict[str, float] | None:
    return None if error is None else {"mean": error.bias, "sd": error.sd, "rms": rms(error)}


def _row(found: Transfer, trial: Applied, body: Body, joints: range) -> dict[str, Any]:
    row: dict[str, Any] = {
        "trial": trial.trial,
        "model": found.model,
        "body": body.name,
        "samples": trial.samples,
        "condition_number": trial.condition,
    }
    for name in SERIES:
        error = body.errors.get(name)
        bias, sd = (error.bias, error.sd) if error else (math.nan, math.nan)
        row |= {f"{name}_mean": bias, f"{name}_sd": sd, f"{name}_rms": rms(error)}
    for j in joints:
        apart = body.torques[j - 1] if j <= len(body.torques) else None
        row |= {f"tau_{j}_mean": apart.bias if apart else math.nan, f"tau_{j}_sd": apart.sd if apart else math.nan}
    known = [value for value in trial.registration.residual[1:].tolist() if math.isfinite(value)]
    return row | {"registration_residual": max(known, default=math.nan), "supported": trial.supported}


def _arrow(found: Transfer) -> pa.Table:
    table = pa.Table.from_pandas(as_frame(found), preserve_index=False)
    fields = [field.with_metadata({"unit": unit}) for field, unit in zip(table.schema, _units(table), strict=True)]
    return table.cast(pa.schema(fields))


def _units(table: pa.Table) -> Iterator[str]:
    for name in table.column_names:
        stem = name.rpartition("_")[0]
        yield SERIES.get(stem) or ("N*m" if stem.startswith("tau_") else "m" if name == "registration_residual" else "")
