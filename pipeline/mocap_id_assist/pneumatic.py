"""A pneumatic device as a spring: its torque, pressures, parameters from a log, and gas (thesis 8.1, 9.5)."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.dynamics.cylinder import ADIABATIC, ISOTHERMAL, Setting
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.sample_checks import SENSOR_HZ, check_times
from mocap_id.recording.text_tables import read_csv
from mocap_id.reporting import paper_figures, style
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results import CommandResult, to_finite
from mocap_id.stages.device import Condition
from mocap_id.store import Table
from mocap_id.workflows.run_folder import open_run
from mocap_id_assist.devices import (
    ESTIMATED,
    GAS_CONSTANT,
    NearestSpring,
    TorqueLog,
    find_nearest_setting,
    gas_of_change,
    identify_cylinder,
    normal_litres,
)

_SPAN_GRID = 361  # number of angles at which two springs are compared
_NO_ZERO = "the torque is not zero at any angle of the stroke"
_NO_TORQUE = "the device gives no torque in this condition"


def device_curve(
    config: DeviceConfig, condition: Condition, exponent: float | None = None, angles: int = 181
) -> CommandResult:
    """Return torque and stiffness of a device at equally spaced angles of its stroke.

    ``angles`` is their number. ``exponent`` replaces the polytropic exponent of the device.

    ConfigError is raised if the exponent is not between 1 and 1.4, or a pressure is not between zero and the pressure
    of the supply.
    """
    keys = config.keys
    if exponent is not None and not ISOTHERMAL <= exponent <= ADIABATIC:
        raise ConfigError(f"the exponent is {exponent:g}; expected 1 (isothermal) to 1.4 (adiabatic)")
    for pressure in (condition.flexion_Pa, condition.extension_Pa):
        if not isinstance(pressure, str) and not 0 < pressure <= keys.supply_Pa * (1 + 1e-9):
            supply = f"{keys.supply_Pa:g} Pa"
            raise ConfigError(
                f"a pressure is {pressure:g} Pa; expected an absolute pressure above 0, up to the supply's {supply}"
            )
    keys = keys if exponent is None else keys.model_copy(update={"polytropic": exponent})
    cylinder, setting = keys.cylinder(), condition.setting()
    angle = np.linspace(*cylinder.limits, angles)
    torque, sd = keys.torque(condition, angle)
    none = np.zeros(angles)
    slow, fast = (
        cylinder.at_exponent(n).torque(angle, setting) if condition.worn else none for n in (ISOTHERMAL, ADIABATIC)
    )
    rest = cylinder.rest_angle(setting) if condition.worn else None
    friction = cylinder.coulomb if condition.worn else 0.0
    content = {
        "product": __version__,
        "device": keys.device,
        "flexion_Pa": setting.flexion,
        "extension_Pa": setting.extension,
        "polytropic": cylinder.exponent,
        "angle_rad": angle.tolist(),
        "torque_Nm": torque.tolist(),
        "sd_torque_Nm": sd.tolist(),
        "torque_isothermal_Nm": slow.tolist(),
        "torque_adiabatic_Nm": fast.tolist(),
        "torque_flexing_Nm": (torque - friction).tolist(),
        "torque_extending_Nm": (torque + friction).tolist(),
        "stiffness_Nm_rad": (cylinder.stiffness(angle, setting) if condition.worn else none).tolist(),
        "rest_angle_rad": to_finite(np.nan if rest is None else rest),
        "why": "" if rest is not None else _NO_ZERO if torque.any() else _NO_TORQUE,
    }
    title = f"torque of the device: {keys.device}"
    return CommandResult(
        "pneumatic-curve",
        "curve.json",
        content,
        other_files=lambda: render("curve", title, lambda: draw_curve(angle, torque, sd, (slow, fast), friction)),
    )


def draw_curve(
    angle: FloatArray,
    torque: FloatArray,
    deviation: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    friction: float,
) -> Figure:
    """Draw the torque of a device against the angle: 95 % band, friction, isothermal and adiabatic ``limits``."""
    figure = paper_figures.make_figure(3.2)
    axes, degrees = figure.subplots(), np.degrees(angle)
    band: dict[str, Any] = {"color": style.BLUE, "alpha": 0.15, "lw": 0, "label": "95 % interval"}
    axes.fill_between(degrees, torque - NORMAL_95 * deviation, torque + NORMAL_95 * deviation, **band)
    axes.plot(degrees, torque, color=style.BLUE, label="torque")
    for sign, label in ((-1, "flexing"), (1, "extending")):
        axes.plot(degrees, torque + sign * friction, ":", color=style.INK, lw=0.8, label=label)
    for values, dash, label in zip(limits, ("--", "-."), ("isothermal", "adiabatic"), strict=True):
        axes.plot(degrees, values, dash, color=style.VERMILLION, lw=0.8, label=label)
    axes.axhline(0, color=style.INK, lw=0.6)
    axes.set(xlabel="angle, positive in flexion (°)", ylabel="torque on the joint (N·m)")
    paper_figures.add_legend(figure, [axes])
    return figure


def spring_pressures(
    config: DeviceConfig, stiffness: float, rest: float, span: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Return the pressures with which a device best approximates a spring, and the spring that results.

    The torques should agree in the range ``span``, rad, by default near the ``rest`` angle, rad. The ``stiffness`` is
    in N·m/rad. ConfigError is raised if it is not above zero, or the range is empty or beyond the stroke.
    """
    if not 0 < stiffness < np.inf or not np.isfinite(rest):
        raise ConfigError(
            f"the spring has {stiffness:g} N·m/rad and a rest angle of {rest:g} rad; expected a stiffness above zero "
            "and a finite rest angle"
        )
    if span is not None and not span[0] < span[1]:
        raise ConfigError(
            f"the range {span[0]:g} to {span[1]:g} rad is empty: the first angle must be below the second"
        )
    angles = None if span is None else np.linspace(*span, _SPAN_GRID)
    keys = config.keys
    try:
        nearest = find_nearest_setting(keys.cylinder(), stiffness, rest, keys.limits(), angles)
    except ValueError as error:
        raise ConfigError(f"{keys.device}: {error}") from error
    return {"device": keys.device, **spring_document(nearest)}


def spring_document(spring: NearestSpring) -> dict[str, Any]:
    """Return the approximation of a spring by a device as JSON values."""
    return {
        "flexion_Pa": spring.setting.flexion,
        "extension_Pa": spring.setting.extension,
        "achieved": {
            "stiffness_Nm_rad": to_finite(spring.stiffness),
            "rest_angle_rad": to_finite(spring.rest),
            "range_rad": list(spring.range),
            "largest_torque_error_Nm": spring.largest_error,
            "rms_torque_error_Nm": spring.rms_error,
        },
        "why": spring.why,
    }


def gas_budget(config: DeviceConfig) -> dict[str, Any]:
    """Return the gas of each change between two worn conditions, and how often a reservoir allows this change.

    ConfigError is raised if the device is worn in fewer than two conditions.
    """
    keys = config.keys
    worn = {name: one.setting() for name, one in keys.conditions.items() if one.worn}
    if len(worn) < 2:
        where = config.source.where(("conditions",))
        raise ConfigError(f"{where}: a budget needs at least two worn conditions in `conditions:`; found {len(worn)}")
    cylinder, store = keys.cylinder(), keys.reservoir
    usable = None  # kg, until the pressure of the reservoir is down to that of the supply
    if store is not None:
        usable = max(store.pressure_Pa - keys.supply_Pa, 0.0) * store.volume_m3 / (GAS_CONSTANT * keys.temperature_K)
    changes = []
    for before, after in itertools.permutations(worn, 2):
        gas = gas_of_change(cylinder, worn[before], worn[after], keys.temperature_K)
        changes.append(
            {
                "from": before,
                "to": after,
                "gas_g": 1e3 * gas,
                "normal_litres": normal_litres(gas),
                "changes_per_reservoir": None if usable is None or gas == 0 else int(usable / gas),
            }
        )
    return {"device": keys.device, "reservoir_g": None if usable is None else 1e3 * usable, "changes": changes}


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

    ``source`` is a CSV file, or the run folder or YAML file of a trial with joint torques and a relaxed person. The CSV
    file has the columns ``angle_rad`` and ``torque_Nm``. Optional columns are ``time_s`` or ``velocity_rad_s`` (for
    friction), and the sealed pressures ``flexion_Pa`` and ``extension_Pa``, by default those of `sealed:`. A trial in
    space needs `protocol: curl`; its condition determines the pressures. For a trial in the plane, ``joint`` is the
    number of the joint, from 1.

    Raises
    ------
    ConfigError, RecordingError, StoreError
        The log or the trial cannot be read, or has no torques.
    NumericalError
        As for :func:`~mocap_id_assist.devices.identify_cylinder`.
    """
    described = config.keys.cylinder()
    is_csv = source.suffix.lower() == ".csv"
    log, left_out = _read_csv_log(config, source) if is_csv else _read_trial_log(config, source, joint)
    cylinder, intervals, known, residual = identify_cylinder(described, log)
    parameters: list[dict[str, Any]] = []
    for name in ESTIMATED:
        unit = np.degrees(1.0) if name == "full_flexion" else 1.0
        ends = intervals.get(name)
        determined = known.get(name, False)
        value = unit * getattr(cylinder, name)
        parameters.append(
            {
                "name": _KEYS[name],
                "value": value if determined else None,
                "interval": None if ends is None or not determined else [unit * ends[0], unit * ends[1]],
                "described": unit * getattr(described, name),
                "why": "" if determined else _NOT_DETERMINED if ends else "friction needs `time_s` or a velocity",
            }
        )
    far = []  # parameters far from their description
    for each in parameters:
        if each["value"] is None or each["name"] not in _LIMITS:
            continue
        limit, relative = _LIMITS[each["name"]]
        if abs(each["value"] - each["described"]) > limit * (abs(each["described"]) if relative else 1.0):
            far.append(f"{each['name']} is {each['value']:.4g}, described as {each['described']:.4g}")
    caution = (
        f"{'; '.join(far)}: check the log (torque in N·m without an offset, angle in rad from the same zero, absolute "
        "pressures in Pa) and the file of the device"
    )
    return {
        "device": config.keys.device,
        "samples": len(log.angle),
        "left_out": left_out,
        "residual_Nm": residual,
        "parameters": parameters,
        "cautions": [caution] if far else [],
    }


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
        # the persistent errors (N, 2) of the elbow's torque, N·m: from the forearm's direction, and from the flexion
        slope = -np.nan_to_num(config.keys.cylinder().stiffness(angle[good], state.setting()))
        by_flexion = slope * _column(motion, "constant_sd_elbow_flexion")[good]
        lasting = np.nan_to_num(np.stack([_column(dynamics, "sd_elbow_torque")[good], by_flexion], axis=1))
    which = np.zeros(int(good.sum()), dtype=np.int64)
    return TorqueLog(angle[good], torque[good], velocity[good], (state.setting(),), which, lasting), int((~good).sum())


def _column(table: Table, name: str) -> FloatArray:
    return np.asarray(table.columns[name], dtype=np.float64)
