"""The output of a transfer: a table for spreadsheets and a JSON document for programs."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from mocap_id.dynamics.comparison import Agreement
from mocap_id.errors import ConfigError
from mocap_id.reporting.results.columns import finite
from mocap_id.store.atomic import write_files
from mocap_id.workflows.transfer.model_transfer import BodyErrors, Transfer, TrialTransfer, rms_error
from mocap_id.workflows.transfer.support import AT_HOME, SERIES, Support

FORMATS = (".csv", ".parquet")
"""Endings of the files that :func:`write` makes."""


def check_format(file: Path) -> None:
    """Raise ConfigError if a file has none of the endings :data:`FORMATS`, before anything is computed."""
    if file.suffix.lower() not in FORMATS:
        raise ConfigError(f"--out {file}: expected a file name that ends in {' or '.join(FORMATS)}")


def write(found: Transfer, file: Path) -> None:
    """Write the table as CSV or Parquet; the units are in the Parquet file's field metadata.

    Raises
    ------
    ConfigError
        The file has neither ending.
    StoreError
        The file cannot be written.
    """
    check_format(file)
    table = pa.Table.from_pandas(as_frame(found), preserve_index=False)
    fields = [field.with_metadata({"unit": _unit(field.name)}) for field in table.schema]
    table, stream = table.cast(pa.schema(fields)), io.BytesIO()
    if file.suffix.lower() == ".csv":
        pyarrow.csv.write_csv(table, stream)
    else:
        pyarrow.parquet.write_table(table, stream)
    write_files(file.parent, {file.name: stream.getvalue()})


def as_frame(found: Transfer) -> pd.DataFrame:
    """Return one row for each trial and body.

    The columns are trial, model (the trial that the body comes from), body, samples and condition_number; mean, sd and
    rms of the error, model less measurement, of each of Fx, Fy (N), tauz (N·m) and cop_x (m); mean and sd of the
    difference of each joint torque tau_1 … from that of the trial's own model (N·m); the largest residual of the
    registration (m); and whether the recordings support the transfer, empty where this could not be shown.
    """
    joints = range(1, found.joints + 1)
    frame = pd.DataFrame([_row(found, trial, body, joints) for trial in found.trials for body in trial.bodies])
    return frame.astype({"supported": "boolean"})


def as_json(found: Transfer) -> dict[str, Any]:
    """Return the same with the registration of every segment and the reasons; null for an unknown number."""
    return {
        "schema": "mocap-id/transfer",
        "version": 1,
        "model": found.model,
        "segments": list(found.segments),
        "trials": [_trial(found, trial) for trial in found.trials],
    }


def _trial(found: Transfer, trial: TrialTransfer) -> dict[str, Any]:
    registration = trial.registration
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
                "angle_deg": math.degrees(registration.angle[k]),
                "shift_m": registration.shift[k].tolist(),
                "markers": int(registration.markers[k]),
                "residual_m": finite(registration.residual[k]),
            }
            for k, name in enumerate(found.segments)
        ],
        "joint_apart_m": [finite(distance) for distance in registration.joint.tolist()],
        "supported": trial.supported,
        "support": None if trial.support is None else _support(trial.support),
        "intervals": {
            name: {"sd_rms": finite(trial.stated[name]), "inside": finite(trial.inside[name]), "unit": unit}
            for name, unit in SERIES.items()
        },
        "reasons": [reason.as_dict() for reason in trial.reasons],
    }


def _support(known: Support) -> dict[str, Any]:
    return {
        name: {
            "apart_rms": finite(known.apart[name]),
            "sd_rms": finite(known.sd[name]),
            "at_home": finite(known.at_home[name]),
            "unit": SERIES[name],
        }
        for name in AT_HOME
    }


def _numbers(error: Agreement | None) -> dict[str, float] | None:
    return None if error is None else {"mean": error.bias, "sd": error.sd, "rms": rms_error(error)}


def _row(found: Transfer, trial: TrialTransfer, body: BodyErrors, joints: range) -> dict[str, Any]:
    row: dict[str, Any] = {
        "trial": trial.trial,
        "model": found.model,
        "body": body.name,
        "samples": trial.samples,
        "condition_number": trial.condition,
    }
    unknown = {"mean": math.nan, "sd": math.nan, "rms": math.nan}
    for name in SERIES:
        row |= {f"{name}_{part}": value for part, value in (_numbers(body.errors.get(name)) or unknown).items()}
    for j in joints:
        torque = _numbers(body.torques[j - 1] if j <= len(body.torques) else None) or unknown
        row |= {f"tau_{j}_{part}": torque[part] for part in ("mean", "sd")}
    return row | {"registration_residual": trial.registration_residual, "supported": trial.supported}


def _unit(column: str) -> str:
    stem = column.rpartition("_")[0]
    return SERIES.get(stem) or ("N*m" if stem.startswith("tau_") else "m" if column == "registration_residual" else "")
