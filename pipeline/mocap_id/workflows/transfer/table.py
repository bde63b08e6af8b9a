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
from mocap_id.reporting.results.columns import to_finite
from mocap_id.store.atomic import write_files
from mocap_id.store.ownership import Owner, check_owner, store_owner
from mocap_id.workflows.transfer.model_transfer import BodyErrors, Transfer, TrialTransfer, rms_error
from mocap_id.workflows.transfer.support import AT_HOME, SERIES, Support

FORMATS = (".csv", ".parquet")
"""Endings of the files that :func:`write` writes."""


def check_format(file: Path) -> None:
    """Raise ConfigError if the file name does not have one of the endings in :data:`FORMATS`."""
    if file.suffix.lower() not in FORMATS:
        raise ConfigError(f"--out {file}: expected a file name that ends in {' or '.join(FORMATS)}")


def write(result: Transfer, file: Path, owner: Owner | None = None) -> None:
    """Write the table as CSV or Parquet; the units are in the Parquet file's field metadata.

    Raises
    ------
    StoreError
        The file cannot be written, or is a table of another ``owner``.
    """
    if owner is not None:
        check_owner(file.parent, owner, file.name)
    table = pa.Table.from_pandas(as_frame(result), preserve_index=False)
    fields = [field.with_metadata({"unit": _find_unit(field.name)}) for field in table.schema]
    table, stream = table.cast(pa.schema(fields)), io.BytesIO()
    if file.suffix.lower() == ".csv":
        pyarrow.csv.write_csv(table, stream)
    else:
        pyarrow.parquet.write_table(table, stream)
    write_files(file.parent, {file.name: stream.getvalue()})
    if owner is not None:
        store_owner(file.parent, owner, file.name)


def as_frame(result: Transfer) -> pd.DataFrame:
    """Return a data frame with one row for each trial and body.

    The columns are trial, model (the trial on which the body was identified), body, samples and condition_number; mean,
    sd and rms of the error (model minus measurement) of Fx, Fy (N), tauz (N·m) and cop_x (m); mean and sd of each joint
    torque tau_1 … minus the torque of the trial's own model (N·m); the largest residual of the registration (m); and
    whether the recordings support the transfer (missing if unknown).
    """
    joints = range(1, result.joints + 1)
    frame = pd.DataFrame([_make_row(result, trial, body, joints) for trial in result.trials for body in trial.bodies])
    return frame.astype({"supported": "boolean"})


def as_json(result: Transfer) -> dict[str, Any]:
    """Return the errors, the registration of every segment and the reasons as JSON; null for an unknown number."""
    return {
        "schema": "mocap-id/transfer",
        "version": 1,
        "model": result.model,
        "segments": list(result.segments),
        "trials": [_describe_trial(result, trial) for trial in result.trials],
    }


def _describe_trial(result: Transfer, trial: TrialTransfer) -> dict[str, Any]:
    registration = trial.registration
    return {
        "trial": trial.trial,
        "samples": trial.samples,
        "condition_number": trial.condition,
        "bodies": [
            {
                "body": body.name,
                "errors": {name: _describe_error(error) for name, error in body.errors.items()},
                "torques": [_describe_error(difference) for difference in body.torques] or None,
            }
            for body in trial.bodies
        ],
        "registration": [
            {
                "segment": name,
                "angle_deg": math.degrees(registration.angle[k]),
                "shift_m": registration.shift[k].tolist(),
                "markers": int(registration.markers[k]),
                "residual_m": to_finite(registration.residual[k]),
            }
            for k, name in enumerate(result.segments)
        ],
        "joint_apart_m": [to_finite(distance) for distance in registration.joint.tolist()],
        "supported": trial.supported,
        "support": None if trial.support is None else _describe_support(trial.support),
        "intervals": {
            name: {"sd_rms": to_finite(trial.stated[name]), "inside": to_finite(trial.inside[name]), "unit": unit}
            for name, unit in SERIES.items()
        },
        "reasons": [reason.as_dict() for reason in trial.reasons],
    }


def _describe_support(support: Support) -> dict[str, Any]:
    return {
        name: {
            "apart_rms": to_finite(support.apart[name]),
            "sd_rms": to_finite(support.sd[name]),
            "at_home": to_finite(support.at_home[name]),
            "unit": SERIES[name],
        }
        for name in AT_HOME
    }


def _describe_error(error: Agreement | None) -> dict[str, float] | None:
    return None if error is None else {"mean": error.bias, "sd": error.sd, "rms": rms_error(error)}


def _make_row(result: Transfer, trial: TrialTransfer, body: BodyErrors, joints: range) -> dict[str, Any]:
    row: dict[str, Any] = {
        "trial": trial.trial,
        "model": result.model,
        "body": body.name,
        "samples": trial.samples,
        "condition_number": trial.condition,
    }
    unknown = {"mean": math.nan, "sd": math.nan, "rms": math.nan}
    for name in SERIES:
        row |= {f"{name}_{part}": value for part, value in (_describe_error(body.errors.get(name)) or unknown).items()}
    for j in joints:
        torque = _describe_error(body.torques[j - 1] if j <= len(body.torques) else None) or unknown
        row |= {f"tau_{j}_{part}": torque[part] for part in ("mean", "sd")}
    return row | {"registration_residual": trial.registration_residual, "supported": trial.supported}


def _find_unit(column: str) -> str:
    stem = column.rpartition("_")[0]
    return SERIES.get(stem) or ("N*m" if stem.startswith("tau_") else "m" if column == "registration_residual" else "")
