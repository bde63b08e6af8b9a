"""The table `trials`: a row for each trial and method, and a row for each trial with the reference parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.robot_study.method_results import NO_ERRORS, STATES, WRENCH, MethodResult, SeriesErrors
from mocap_id.workflows.robot_study.methods import CAMERAS
from mocap_id.workflows.robot_study.trial_results import RobotTrialResult, predict_reference
from mocap_id.workflows.robot_study.truth import PARAMETERS

REFERENCE = "reference"
STATE_UNITS = dict(zip(STATES, ("rad", "rad/s", "rad/s^2"), strict=True))
WRENCH_UNITS = dict(zip(WRENCH, ("N", "N", "N*m"), strict=True))
PARAMETER_UNITS = dict(zip(PARAMETERS, ("kg", "kg*m", "kg*m", "kg*m", "kg*m^2"), strict=True))

CELL = (
    text("joint", "the joint that moves"),
    text("speed", "speed of the movement"),
    number("orientation", "deg", "angle of the robot about the vertical; NaN: all orientations"),
    text("obs", "P: states from the cameras; R: from the encoder; Ref.: reference parameters; else name of a method"),
    text("source", "`this` program, or the `thesis`"),
    whole("trials", "number of trials in the row; 0 for the thesis"),
)
"""Columns that identify the cell of the thesis's tables to which a row belongs."""


def _error_columns(name: str, unit: str, meaning: str) -> list[Column]:
    parts = (("bias", unit, "mean"), ("sd", unit, "standard deviation"), ("r2", "1", "r²"))
    return [number(f"{name}_{part}", of, f"{meaning}: {words}") for part, of, words in parts]


def _series_columns(units: Mapping[str, str], meaning: str) -> list[Column]:
    return [column for name, unit in units.items() for column in _error_columns(name, unit, f"{name} {meaning}")]


def _parameter_columns(name: str, unit: str) -> tuple[Column, ...]:
    return (
        number(name, unit, f"base parameter {name} in the robot's own frame"),
        number(f"{name}_sd", unit, "its standard deviation"),
        number(f"{name}_reference", unit, "value of the reference"),
        text(f"{name}_verdict", "known, weak or not identifiable"),
    )


TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        text("trial", "name of the trial and of its run folder"),
        *CELL[:3],
        text("method", "cameras, encoder, differences, differences-6, spline, or reference"),
        text("verdict", "verdict of the trial: ok, caution, refused or failed"),
        text("codes", "codes of the verdict's reasons"),
        text("against", "reference of the states: truth or encoder; empty without a reference"),
        number("base", "m", "distance of the joint from the plane's origin"),
        number("base_sd", "m", "its standard deviation"),
        number("base_error", "m", "distance minus the distance of the reference"),
        *_error_columns("marker", "m", "distance of the moving markers from their prediction")[:2],
        *_series_columns(STATE_UNITS, "minus the value of the truth or the encoder"),
        number("condition", "1", "condition number of the stacked regressor"),
        *(column for name, unit in PARAMETER_UNITS.items() for column in _parameter_columns(name, unit)),
        *_error_columns("torque", "N*m", "torque of the model minus the encoder's"),
        *_series_columns(WRENCH_UNITS, "of the model minus the measured"),
        number("clock_offset", "s", "clock offset, plates after cameras"),
        number("encoder_offset", "s", "offset of the encoder's clock: its sample at t is the state at t + this offset"),
        number("encoder_offset_sd", "s", "its standard deviation"),
        number("encoder_offset_truth", "s", "true offset, if known"),
    ),
)


def trial_rows(trials: Sequence[RobotTrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `trials`; a trial without results has a single row without numbers."""
    for trial in trials:
        orientation = trial.labels.orientation
        labels = {
            "trial": trial.name,
            "joint": trial.labels.joint,
            "speed": trial.labels.speed,
            "orientation": np.nan if orientation is None else orientation,
            "verdict": trial.level,
            "codes": ", ".join(trial.codes),
        }
        if not trial.by_method:
            yield labels | {"method": CAMERAS.name}
        for name, result in trial.by_method.items():
            yield labels | {"method": name} | _describe_result(trial, result)
        through = trial.method_of_reference
        if through is not None:
            yield labels | {"method": REFERENCE} | _describe_reference(trial, through)


def _describe_result(trial: RobotTrialResult, result: MethodResult) -> dict[str, Any]:
    row: dict[str, Any] = {
        "against": result.against,
        "condition": result.condition,
        "clock_offset": result.clock_offset,
    }
    for k, name in enumerate(PARAMETERS):
        row |= {name: result.parameters[k], f"{name}_sd": result.sds[k], f"{name}_verdict": result.verdicts[k]}
        row[f"{name}_reference"] = trial.reference.get(name, np.nan)
    for name, errors in {**result.states, **result.wrench, "torque": result.torque}.items():
        row |= _name_errors(name, errors)
    return row | _describe_kinematics(trial, result)


def _describe_kinematics(trial: RobotTrialResult, result: MethodResult) -> dict[str, Any]:
    base, sd = (trial.value("lengths_m", "base", key) for key in ("value", "sd"))
    encoder = result.folder.read("encoder.parquet").facts
    truth = {} if trial.truth is None else trial.truth.document.get("encoder", {})
    return {
        "base": base,
        "base_sd": sd,
        "base_error": np.nan if base is None else base - trial.reference.get("base", np.nan),
        **_average_marker_errors(result),
        "encoder_offset": encoder.get("clock_offset_s"),
        "encoder_offset_sd": encoder.get("clock_offset_sd_s"),
        "encoder_offset_truth": truth.get("clock_offset_s"),
    }


def _average_marker_errors(result: MethodResult) -> dict[str, float]:
    """Return the mean and standard deviation of the moving markers' distances from their prediction, m."""
    markers, skeleton = result.folder.long_table("markers.parquet"), result.identified.skeleton
    moving = [name for name, segment in zip(skeleton.markers, skeleton.segment, strict=True) if segment > 0]
    residual = markers.values["residual"]
    own = np.isin(markers.labels, moving) & markers.values["used"].astype(np.bool_)
    known = residual[own & np.isfinite(residual)]
    return {"marker_bias": float(np.mean(known)), "marker_sd": float(np.std(known))} if len(known) else {}


def _name_errors(name: str, errors: SeriesErrors) -> dict[str, float]:
    return {f"{name}_bias": errors.bias, f"{name}_sd": errors.sd, f"{name}_r2": errors.r2}


def _describe_reference(trial: RobotTrialResult, result: MethodResult) -> dict[str, Any]:
    """Return the reference parameters, and the errors of the wrench and torque that they predict for the states."""
    wrench, torque = predict_reference(trial, result)
    row: dict[str, Any] = {name: trial.reference[name] for name in PARAMETERS}
    row |= {f"{name}_reference": trial.reference[name] for name in PARAMETERS}
    dynamics = result.identified.dynamics
    fitted = dynamics["in_fit"].to_numpy(dtype=np.bool_)
    for k, name in enumerate(WRENCH):
        measured = dynamics[name].to_numpy(dtype=np.float64)[fitted]
        row |= _name_errors(name, SeriesErrors.of(wrench[fitted, k] - measured, measured))
    return row | _name_errors("torque", _compare_torque(trial, result, torque))


def _compare_torque(trial: RobotTrialResult, result: MethodResult, torque: FloatArray) -> SeriesErrors:
    """Return the errors of a torque (T,) in the plane relative to the torque in the encoder's file, at its times."""
    file, encoder = trial.trial.trial.keys.encoder, result.folder.read("encoder.parquet").facts
    log = None if file is None else recording.read_encoder(file)
    if log is None or log.torque is None or encoder.get("sign") is None:
        return NO_ERRORS
    measured = encoder["sign"] * log.torque
    model = SampledWrench.of(result.time, torque[:, None])(log.time + encoder["clock_offset_s"])[:, 0]
    return SeriesErrors.of(model - measured, measured)
