"""Parameters of a device from a log of torque against angle, or from a trial of a relaxed person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.pneumatics.cylinder import Setting
from mocap_id.pneumatics.identification import ESTIMATED, TorqueLog, identify_cylinder
from mocap_id.recording.clock import SENSOR_HZ, check_times
from mocap_id.recording.text_tables import read_csv
from mocap_id.store import Table
from mocap_id.workflows.run_folder import open_run

ANGLE, TORQUE, TIME, VELOCITY = "angle_rad", "torque_Nm", "time_s", "velocity_rad_s"
PRESSURES = "flexion_Pa", "extension_Pa"
_KEYS = {
    "area_flexion": "area_flexion_m2",
    "area_extension": "area_extension_m2",
    "dead_flexion": "dead_flexion_m",
    "dead_extension": "dead_extension_m",
    "full_flexion": "full_flexion_deg",
    "exponent": "polytropic",
    "coulomb": "coulomb_Nm",
    "viscous": "viscous_Nms",
}
_LIMITS = {"area_flexion_m2": (0.25, True), "area_extension_m2": (0.25, True), "full_flexion_deg": (10.0, False)}
"""Largest plausible difference from the described value: as a fraction of this value (True), or in degrees (False)."""
_LEAST = 20  # least number of samples
_NOT_DETERMINED = "the log does not determine this parameter"
_IN_SPACE = "elbow_flexion", "delbow_flexion", "elbow_torque"


def identify_device(config: DeviceConfig, source: Path, joint: int = 1) -> dict[str, Any]:
    """Return the parameters of a device with their intervals; None for a parameter that the log does not determine.

    Parameters
    ----------
    config : DeviceConfig
    source : Path
        A CSV file, or the run folder or YAML file of a trial with joint torques and a relaxed person. The CSV file has
        the columns ``angle_rad`` and ``torque_Nm``. Optional columns are ``time_s`` or ``velocity_rad_s`` (for
        friction), and the sealed pressures ``flexion_Pa`` and ``extension_Pa``, by default those of `sealed:`. A trial
        in space needs `protocol: curl`; its condition determines the pressures.
    joint : int
        For a trial in the plane: the joint, from 1.

    Raises
    ------
    ConfigError, RecordingError, StoreError
        The log or the trial cannot be read, or has no torques.
    NumericalError
        As for :func:`~mocap_id.pneumatics.identification.identify_cylinder`.
    """
    described = config.keys.cylinder()
    is_csv = source.suffix.lower() == ".csv"
    log, left_out = _read_csv_log(config, source) if is_csv else _read_trial_log(config, source, joint)
    identified = identify_cylinder(described, log)
    parameters = []
    for name in ESTIMATED:
        unit = np.degrees(1.0) if name == "full_flexion" else 1.0
        ends = identified.interval.get(name)
        determined = identified.determined.get(name, False)
        value = unit * getattr(identified.cylinder, name)
        parameters.append(
            {
                "name": _KEYS[name],
                "value": value if determined else None,
                "interval": None if ends is None or not determined else [unit * ends[0], unit * ends[1]],
                "described": unit * getattr(described, name),
                "why": "" if determined else _NOT_DETERMINED if ends else "friction needs `time_s` or a velocity",
            }
        )
    return {
        "device": config.keys.device,
        "samples": len(log.angle),
        "left_out": left_out,
        "residual_Nm": identified.residual,
        "parameters": parameters,
        "cautions": _cautions(parameters),
    }


def _cautions(parameters: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return one caution with the parameters far from their description and the usual causes; empty if none is far."""
    far = []
    for each in parameters:
        if each["value"] is None or each["name"] not in _LIMITS:
            continue
        limit, relative = _LIMITS[each["name"]]
        difference = abs(each["value"] - each["described"])
        if difference > limit * (abs(each["described"]) if relative else 1.0):
            far.append(f"{each['name']} is {each['value']:.4g}, described as {each['described']:.4g}")
    if not far:
        return []
    return [
        f"{'; '.join(far)}: check the log (torque in N·m without an offset, angle in rad from the same zero, absolute "
        "pressures in Pa) and the file of the device"
    ]


def _read_csv_log(config: DeviceConfig, path: Path) -> tuple[TorqueLog, int]:
    """Return the log in a CSV file, and the number of rows with empty cells, which are left out."""
    table = read_csv(path)
    columns = dict(zip(table.names, table.numbers().T, strict=True))
    known = (ANGLE, TORQUE, TIME, VELOCITY, *PRESSURES)
    missing = [name for name in (ANGLE, TORQUE) if name not in columns]
    unknown = [name for name in columns if name not in known]
    if missing or unknown or (PRESSURES[0] in columns) != (PRESSURES[1] in columns):
        raise RecordingError(
            f"{path}: the file has the columns {', '.join(columns)[:120]}; expected {ANGLE}, {TORQUE} and optionally "
            f"{TIME}, {VELOCITY}, and {' with '.join(PRESSURES)}"
        )
    complete = np.all([np.isfinite(column) for column in columns.values()], axis=0)
    columns = {name: column[complete] for name, column in columns.items()}
    if len(columns[ANGLE]) < _LEAST:
        raise RecordingError(
            f"{path}: the file has {len(columns[ANGLE])} rows without empty cells; expected at least {_LEAST}"
        )
    velocity = columns.get(VELOCITY)
    if velocity is None and TIME in columns:
        check_times(path, columns[TIME], f"`{TIME}`", SENSOR_HZ, pauses=True)
        velocity = np.gradient(columns[ANGLE], columns[TIME])
    if PRESSURES[0] in columns:
        pairs, which = np.unique(np.stack([columns[name] for name in PRESSURES], axis=1), axis=0, return_inverse=True)
        settings = tuple(Setting(float(flexion), float(extension)) for flexion, extension in pairs)
    else:
        settings, which = (config.keys.sealed.setting(),), np.zeros(len(columns[ANGLE]), dtype=np.int64)
    log = TorqueLog(columns[ANGLE], columns[TORQUE], velocity, settings, which.reshape(-1))
    return log, int((~complete).sum())


def _read_trial_log(config: DeviceConfig, source: Path, joint: int) -> tuple[TorqueLog, int]:
    """Return the log of a joint in a trial, and the number of samples without a value, which are left out."""
    run = open_run(source)
    names = _IN_SPACE if run.in_space else (f"theta_{joint}", f"dtheta_{joint}", f"tau_{joint}")
    motion, dynamics = (
        run.artefacts.get(file) for file in ("angles.parquet" if run.in_space else "states.parquet", "dynamics.parquet")
    )
    if not isinstance(motion, Table) or not isinstance(dynamics, Table) or names[2] not in dynamics.columns:
        what = "the elbow, which needs `protocol: curl`" if run.in_space else f"joint {joint}"
        raise ConfigError(f"{source}: the trial has no torque of {what}: {run.why_missing('dynamics.parquet')}")
    angle, velocity, torque = _column(motion, names[0]), _column(motion, names[1]), _column(dynamics, names[2])
    good = np.isfinite(torque) & np.isfinite(angle) & np.isfinite(velocity)
    if good.sum() < _LEAST:
        where = "the elbow" if run.in_space else f"joint {joint}"
        raise ConfigError(f"{source}: {where} has {int(good.sum())} samples with a torque; expected at least {_LEAST}")
    state = config.keys.sealed
    lasting = None
    if run.in_space:
        name = (run.facts("events.parquet").get("curl") or {}).get("condition")
        state = config.condition(str(name) if name is not None and config.keys.conditions else None)
        if not state.worn:
            raise ConfigError(f"{source}: the device is not worn in condition `{name}`: choose a trial with the device")
        lasting = _lasting_errors(config, state.setting(), angle[good], motion, dynamics, good)
    which = np.zeros(int(good.sum()), dtype=np.int64)
    return TorqueLog(angle[good], torque[good], velocity[good], (state.setting(),), which, lasting), int((~good).sum())


def _lasting_errors(  # noqa: PLR0917
    config: DeviceConfig, setting: Setting, angle: FloatArray, angles: Table, dynamics: Table, good: BoolArray
) -> FloatArray:
    """Return the persistent errors (N, 2) of the elbow's torque, N·m: from the forearm's direction, and the flexion.

    Each row belongs to one of the N ``good`` samples; ``angle`` (N,) is the flexion in these samples, rad.
    """
    by_direction = _column(dynamics, "sd_elbow_torque")[good]
    slope = -np.nan_to_num(config.keys.cylinder().stiffness(angle, setting))
    by_flexion = slope * _column(angles, "constant_sd_elbow_flexion")[good]
    return np.nan_to_num(np.stack([by_direction, by_flexion], axis=1))


def _column(table: Table, name: str) -> FloatArray:
    return np.asarray(table.columns[name], dtype=np.float64)
