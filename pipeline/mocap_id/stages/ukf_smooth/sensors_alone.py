"""States of a trial that has inertial sensors but no markers, for the stage ukf-smooth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import NumericalError, RecordingError, Refused
from mocap_id.estimation import States
from mocap_id.estimation.dead_reckoning import FORCE_BIAS, SWITCHED_ON
from mocap_id.estimation.inertial import Clock, SensorResult, SensorSignals
from mocap_id.estimation.inertial.clock import OBSERVABLE_SD
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.inertial_tracking import CalibratedChain, TrackedStates, calibrate_chain, track_without_markers
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.estimation.noise import FilterNoise
from mocap_id.geometry.planar import marker_positions
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration_trial import get_calibration, read_states
from mocap_id.stages.trial_keys import InertialSensor, list_sensors
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.columns import state_columns
from mocap_id.stages.ukf_smooth.encoder_states import empty_encoder_table
from mocap_id.stages.ukf_smooth.inertial import (
    check_method,
    describe_sensor,
    read_sensor,
    report_clock,
    report_saturation,
)
from mocap_id.stages.ukf_smooth.state_errors import SKIN, assume_skin
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import ANGLES, MARKERS, POSES, STATES
from mocap_id.store.views import JointStates, Skeleton, Trajectories
from mocap_id.verdict import Reason

_LONGEST_GAP = 0.5  # s without samples of a sensor
_LARGEST_LEAN = np.radians(3.0)  # of a sensor out of the plane, relative to the calibration
_FITTING, _CONTRADICTING = 0.1, 0.5  # m/s² rms between accelerometers and gyroscopes; 0.05 in simulated people
_LARGEST_HEADING = np.radians(15.0)  # rotation about the vertical, in addition to twice its standard deviation


def states_of_sensors(context: Context) -> Outputs:
    """Return the artefacts of the stage for a trial without markers.

    Raises
    ------
    ConfigError
        The method or engine is not the default.
    RecordingError
        A log cannot be read or has a long gap, or the sensors of the calibration do not agree with its markers.
    Refused
        Accelerometers and gyroscopes contradict each other.
    """
    settings: UkfSmoothSettings = context.settings
    check_method(settings.method, settings.engine)
    skeleton = Skeleton.from_tree(context.tree("chain.h5"))
    view = Trajectories(context.long("planar.parquet"))
    names = skeleton.segments[1:]
    worn = list_sensors(context.trial.imus)
    signals = [_read_complete_log(worn[name], view.time) for name in names]
    chain, snap = _calibrate_chain(context, skeleton)
    tracked = track_without_markers(signals, view.time, chain)
    worst = int(np.argmax(tracked.reckoning.residual))
    if tracked.reckoning.residual[worst] > _CONTRADICTING:
        message = f"{_describe_contradiction(tracked, worst, names)}: no angles are given. {_CAUSES}"
        raise Refused("imus-contradict", message)
    uncertain = tracked.sd[..., 0] > settings.angle_sd_limit
    tracked.mean[uncertain], tracked.sd[uncertain] = np.nan, np.nan
    facts = {
        "marker_sd_m": None,
        "sigma_v": snap.tolist(),
        "reprojection_rms_m": None,
        "outlier_fraction": None,
        "bridged_fraction": [1.0] * len(names),
        "method": settings.method,
        "engine": settings.engine,
        "sd_holds": SKIN,
        "cut_off_hz": None,
        "imus": {name: _facts(tracked, chain, k, signals[k]) for k, name in enumerate(names)},
    }
    states = _make_states(tracked, skeleton, snap)
    residual = context.tree("chain.h5").array("markers/residual")[skeleton.marker_segment > 0]
    skin = assume_skin(states, residual, skeleton.covariance)
    labels = [label for label, k in zip(skeleton.markers, skeleton.marker_segment, strict=True) if k > 0]
    return (
        Table(
            STATES,
            state_columns(view.time, tracked.mean, tracked.sd, states.observed),
            facts,
            _reasons(context, tracked, names, signals),
        ),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, _marker_columns(tracked, skeleton)),
        skin_artefact.make_skin_tree(skin, labels, None, "no markers"),
        empty_encoder_table("the trial has inertial sensors alone"),
        Table(POSES, {"time": view.time}, {"bodies": []}),
        Table(ANGLES, {"time": view.time}),
    )


def _read_complete_log(sensor: InertialSensor, time: FloatArray) -> SensorSignals:
    """Return the log of a sensor; raise RecordingError if it has a long gap within the trial."""
    log = read_sensor(sensor)
    inside = log.time[(log.time >= time[0]) & (log.time <= time[-1])]
    gaps = np.diff(np.concatenate([[time[0]], inside, [time[-1]]]))
    if gaps.max() > _LONGEST_GAP:
        at = float(np.concatenate([[time[0]], inside])[np.argmax(gaps)])
        raise RecordingError(
            f"{sensor.file}: there are no samples for {gaps.max():.1f} s after {at:.1f} s, and without markers this "
            "gap cannot be bridged. Choose a part of the trial without gaps by `window:`"
        )
    return log


def _calibrate_chain(context: Context, skeleton: Skeleton) -> tuple[CalibratedChain, FloatArray]:
    """Return the chain with its sensors, calibrated on the trial with markers, and the joints' snap (n,), rad/s⁴."""
    calibration = get_calibration(context.trial)
    table = read_states(calibration)
    joints = JointStates.from_table(table)
    dt = float(joints.time[1] - joints.time[0])
    snap = np.array(table.facts["sigma_v"])
    mean = np.concatenate([joints.mean, np.zeros_like(joints.mean[..., :1])], axis=2)
    chain = MarkerChain(skeleton.centres.copy(), skeleton.marker_segment, skeleton.local)
    noise = FilterNoise(np.nan, snap)
    states = States(mean, joints.sd, joints.observed, np.zeros((0, 0), np.bool_), noise, np.nan, chain)
    worn = list_sensors(calibration.imus)
    sensors = {s: read_sensor(worn[name]) for s, name in enumerate(skeleton.segments[1:], start=1)}
    try:
        return calibrate_chain(states, joints.time, sensors, snap**2 * dt), snap
    except NumericalError as error:
        files = ", ".join(sensor.file.name for sensor in worn.values())
        message = f"its inertial sensors ({files}) do not fit its markers ({error}); check their segments and files"
        raise RecordingError(f"{calibration.trial}: {message}") from error


def _facts(tracked: TrackedStates, chain: CalibratedChain, k: int, signals: SensorSignals) -> dict[str, Any]:
    """Return the facts of sensor k: its clock relative to the first sensor, its biases in this trial, its mounting."""
    found, reckoned = chain.known.sensors[k].calibration, tracked.reckoning
    normal = found.mount.T @ [0.0, 0.0, 1.0]
    in_plane = np.sqrt(1.0 - normal**2)
    gyro_sd = np.hypot(normal * reckoned.gyro_bias_sd[:, k].mean(), in_plane * SWITCHED_ON)
    acc_sd = np.hypot(in_plane * reckoned.force_bias_sd[k].max(), normal * FORCE_BIAS)
    clock_sd = float(reckoned.shift_sd[k])
    present = replace(
        found,
        clock=Clock(-float(reckoned.shift[k]), 0.0, clock_sd, clock_sd <= OBSERVABLE_SD),
        gyro_bias=found.gyro_bias + normal * float(reckoned.gyro_bias[:, k].mean()),
        acc_bias=found.acc_bias + found.mount.T @ [*reckoned.force_bias[k], 0.0],
        sd=found.sd | {"gyro_bias": gyro_sd, "acc_bias": acc_sd},
        residual=np.array([np.nan, reckoned.residual[k]]),
    )
    return describe_sensor(SensorResult(present, float(np.mean(signals.saturated)))) | {
        "ppm": None,
        "gyro_residual_rad_s": None,
        "heading_deg": float(np.degrees(tracked.heading[k])),
        "heading_sd_deg": float(np.degrees(tracked.heading_sd[k])),
    }


def _reasons(
    context: Context, tracked: TrackedStates, names: tuple[str, ...], signals: list[SensorSignals]
) -> tuple[Reason, ...]:
    sd, name = np.degrees(np.nanmean(tracked.sd[..., 0])), get_calibration(context.trial).trial.name
    drift = float(np.degrees(np.max(tracked.heading_sd)))
    message = (
        f"no camera recorded this trial: the angles (standard deviation {sd:.1f}°) are valid if every sensor was worn "
        f"as in {name}. Directions about the vertical, which drift by {drift:.0f}° in this trial, positions and "
        "forces are unknown."
    )
    reasons = [Reason("imus-alone", message, float(sd))]
    worst = int(np.argmax(tracked.reckoning.residual))
    off = float(tracked.reckoning.residual[worst])
    if off > _FITTING:
        text = f"{_describe_contradiction(tracked, worst, names)}: the angles may be wrong by 5° and more. {_CAUSES}"
        reasons.append(Reason("imus-contradict", text, off, _FITTING))
    for k, segment in enumerate(names):
        reasons += _check_lean(tracked, k, segment) + _check_heading(tracked, k, segment)
        if tracked.reckoning.shift_sd[k] > OBSERVABLE_SD:
            reasons.append(report_clock(segment, float(tracked.reckoning.shift_sd[k])))
        reasons += [*report_saturation(segment, float(np.mean(signals[k].saturated))), *signals[k].reasons]
    return tuple(reasons)


def _describe_contradiction(tracked: TrackedStates, worst: int, names: tuple[str, ...]) -> str:
    return (
        f"the accelerometers contradict the gyroscopes on the chain of the calibration, most on the {names[worst]}: by "
        f"{tracked.reckoning.residual[worst]:.2g} m/s² rms, expected at most {_FITTING:g}"
    )


_CAUSES = (
    "Check that each sensor is on the configured segment, that its units are rad/s and m/s², that its clock is right, "
    "that it was not rotated on its segment since the calibration, and that the calibration is of the same person."
)


def _check_lean(tracked: TrackedStates, k: int, segment: str) -> list[Reason]:
    """Return a caution if the direction of gravity implies that sensor k was rotated on its segment."""
    lean = float(np.arcsin(np.clip(abs(tracked.level[k]) / GRAVITY, 0.0, 1.0)))
    if lean <= _LARGEST_LEAN:
        return []
    message = (
        f"the sensor on the {segment} leans {np.degrees(lean):.0f}° out of the plane relative to the calibration: it "
        "was rotated on the segment, or the person leaned sideways. The errors of the angles may be larger than this, "
        "and no interval includes them."
    )
    return [Reason("imu-moved", message, float(np.degrees(lean)), float(np.degrees(_LARGEST_LEAN)))]


def _check_heading(tracked: TrackedStates, k: int, segment: str) -> list[Reason]:
    """Return a caution if a segment rotated about the vertical by more than its gyroscope's bias explains."""
    angle, sd = abs(float(tracked.heading[k])), float(tracked.heading_sd[k])
    limit = _LARGEST_HEADING + 2.0 * sd
    if angle <= limit:
        return []
    message = (
        f"the {segment} rotated about the vertical by {np.degrees(angle):.0f}° (standard deviation "
        f"{np.degrees(sd):.0f}°): the motion left its plane, so the angles in the plane are not the angles between the "
        "segments."
    )
    return [Reason("imu-heading", message, float(np.degrees(angle)), float(np.degrees(limit)))]


def _make_states(tracked: TrackedStates, skeleton: Skeleton, snap: FloatArray) -> States:
    moves = skeleton.marker_segment > 0
    chain = MarkerChain(skeleton.centres, skeleton.marker_segment[moves], skeleton.local[moves])
    shape = tracked.mean.shape[:2]
    none, used = np.zeros(shape, np.bool_), np.zeros((shape[0], int(moves.sum())), np.bool_)
    return States(tracked.mean, tracked.sd, none, used, FilterNoise(np.nan, snap), np.nan, chain)


def _marker_columns(tracked: TrackedStates, skeleton: Skeleton) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of markers.parquet: the calibration's markers on the moving chain, with residuals of NaN."""
    angles = tracked.mean[..., 0]
    positions = marker_positions(angles, skeleton.centres, skeleton.marker_segment, skeleton.local)
    x, y = (np.ascontiguousarray(positions[..., i]) for i in range(2))
    return {"x": x, "y": y, "residual": np.full(x.shape, np.nan), "used": np.zeros(x.shape, np.bool_)}
