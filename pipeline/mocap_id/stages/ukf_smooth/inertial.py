"""Inertial sensors in the stage ukf-smooth, beside markers and alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import GRAVITY, FloatArray
from mocap_id.errors import ConfigError, NumericalError, RecordingError, Refused
from mocap_id.estimation import States
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.inertial import OBSERVABLE_SD, Clock, SensorResult, SensorSignals
from mocap_id.estimation.inertial_tracking import (
    FORCE_BIAS,
    SWITCHED_ON,
    KnownChain,
    calibrate_chain,
    track_without_markers,
)
from mocap_id.geometry.planar import marker_positions
from mocap_id.recording.imu_log import read_imu
from mocap_id.recording.sample_checks import describe_held
from mocap_id.stages import skin_motion
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.calibration_trial import get_calibration, read_states
from mocap_id.stages.trial_keys import InertialSensor, list_sensors
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.plane import SKIN, assume_skin, empty_encoder_table, state_columns
from mocap_id.store import LongTable, Table
from mocap_id.store.artefacts import JointStates, Skeleton, Trajectories
from mocap_id.store.provenance import ANGLES, MARKERS, POSES, STATES

_SATURATED = 3e-3  # fraction of saturated samples above which they are reported
_DIFFERS, _LEAST_RATE = 0.15, 0.8  # fraction of the angular velocity from which a difference is reported; rad/s


def check_method(method: str, engine: str) -> None:
    """Raise ConfigError if inertial sensors in the plane cannot be used with these settings of ukf-smooth."""
    if method != "rts" or engine != "compiled":
        raise ConfigError("imus: inertial sensors need `ukf-smooth: {method: rts, engine: compiled}`")


def read_sensors(
    names: Sequence[str], sensors: Mapping[str, InertialSensor], mirrored: bool = False
) -> dict[int, SensorSignals]:
    """Read the log of each sensor by segment; return the signals by the index of the segment in ``names``.

    ``mirrored`` is as for :func:`read_sensor`. ConfigError is raised for a sensor on a segment that does not exist,
    RecordingError if a log cannot be read.
    """
    for name in sensors:
        if name not in names:
            raise ConfigError(
                f"imus: there is no segment {name!r}; the segments are {', '.join(names)}. If the motion is too small "
                "to separate all segments, name a trial in which all joints move as `calibration:`"
            )
    return {names.index(name): read_sensor(sensor, mirrored) for name, sensor in sensors.items()}


def describe_sensors(
    names: Sequence[str],
    sensors: Mapping[str, InertialSensor],
    signals: Mapping[int, SensorSignals],
    results: Mapping[int, SensorResult],
) -> Findings:
    """Return the facts of all sensors for the summary, by segment, and the reasons for the verdict.

    ``names`` are the segments and ``sensors`` the logs by segment; ``signals`` and ``results`` are those of the sensors
    by index of the segment.
    """
    out = Findings(reason for each in signals.values() for reason in each.reasons)
    for s, result in results.items():
        out.facts[names[s]] = describe_sensor(result)
        name, file, found = names[s].replace("_", " "), sensors[names[s]].file.name, result.calibration
        if result.why is not None:
            better = result.better_segment
            other = "" if better is None else f" It fits the motion of the {names[better].replace('_', ' ')}."
            out.say(
                "imu-disagrees",
                f"the sensor on the {name} ({file}) is left out: {result.why}.{other} Check its segment and its file.",
            )
            continue
        off = 0.0 if found is None else float(np.sqrt(3.0) * found.residual[0])
        limit = _DIFFERS * max(_LEAST_RATE, 0.0 if found is None else found.segment_rate)
        if off > limit:
            out.say(
                "imu-differs",
                f"the angular velocity of the {name} from its sensor ({file}) differs from that of its markers by "
                f"{off:.2f} rad/s rms; usual is less than {limit:.2f}. The markers may be on another segment or hidden "
                "for a long time, or the sensor may be loose.",
                off,
                limit,
            )
        if found is not None and not found.clock.observable:
            report_clock(out, name, found.clock.sd)
        report_saturation(out, name, result.saturated)
    return out


def read_sensor(sensor: InertialSensor, mirrored: bool = False) -> SensorSignals:
    """Read the log of a sensor.

    If ``mirrored``, as for a left arm, the signs of the force along z of the sensor and of the rotations about its x
    and y are reversed.
    """
    log = read_imu(sensor.file, sensor.rate_hz)
    reasons = describe_held(log.held)
    if not mirrored:
        return SensorSignals(log.time, log.gyro, log.acc, reasons)
    gyro, acc = log.gyro * np.array([-1.0, -1.0, 1.0]), log.acc * np.array([1.0, 1.0, -1.0])
    return SensorSignals(log.time, gyro, acc, reasons)


def describe_sensor(result: SensorResult) -> dict[str, Any]:
    """Return the facts of a sensor for the summary."""
    found = result.calibration
    facts: dict[str, Any] = {"used": result.used is not None, "why": result.why}
    if found is None:
        return facts
    known = bool(np.isfinite(found.clock.sd))
    return facts | {
        "clock_offset_s": found.clock.offset if known else None,
        "sd_s": found.clock.sd if known else None,
        "ppm": 1e6 * found.clock.drift if known else None,
        "observable": found.clock.observable and result.why is None,
        "gyro_bias_rad_s": found.gyro_bias.tolist(),
        "gyro_bias_sd_rad_s": found.sd["gyro_bias"].tolist(),
        "acc_bias_m_s2": found.acc_bias.tolist(),
        "acc_bias_sd_m_s2": found.sd["acc_bias"].tolist(),
        "mounting": found.mount.tolist(),
        "mounting_sd_deg": float(np.degrees(np.max(found.sd["turn"]))),
        "position_m": found.place.tolist(),
        "position_sd_m": found.sd["place"].tolist(),
        "skin_share": found.lag,
        "gyro_residual_rad_s": float(found.residual[0]),
        "acc_residual_m_s2": float(found.residual[1]),
        "saturated": result.saturated,
    }


def report_clock(out: Findings, segment: str, sd: float) -> None:
    """Add a note that the motion does not determine a sensor's clock; ``sd`` is its standard deviation, s."""
    message = (
        f"the motion of the {segment} does not determine the clock of its sensor to 2 ms (standard deviation "
        f"{1e3 * sd:.1f} ms)."
    )
    out.say("imu-clock", message, sd, OBSERVABLE_SD, "ok")


def report_saturation(out: Findings, segment: str, share: float) -> None:
    """Add a caution if too many samples of a segment's sensor are saturated; ``share`` is their fraction."""
    if share > _SATURATED:
        message = f"{100 * share:.1f} % of the samples of the sensor on the {segment} are saturated and left out."
        out.say("imu-saturated", message, share, _SATURATED)


_LONGEST_GAP = 0.5  # s without samples of a sensor
_LARGEST_LEAN = np.radians(3.0)  # of a sensor out of the plane, relative to the calibration
_FITTING, _CONTRADICTING = 0.1, 0.5  # m/s² rms between accelerometers and gyroscopes; 0.05 in simulated people
_LARGEST_HEADING = np.radians(15.0)  # rotation about the vertical, in addition to twice its standard deviation


def states_of_sensors(context: Context) -> Outputs:
    """Return the artefacts of the stage for a trial without markers.

    Refused is raised if accelerometers and gyroscopes contradict each other, RecordingError if a log cannot be read or
    has a long gap, or if the sensors of the calibration do not agree with its markers.
    """
    settings: UkfSmoothSettings = context.settings
    check_method(settings.method, settings.engine)
    tree, view = context.tree("chain.h5"), Trajectories(context.long("planar.parquet"))
    skeleton = Skeleton(tree)
    names = skeleton.segments[1:]
    worn = list_sensors(context.trial.imus)
    signals = []
    for name in names:
        log = read_sensor(worn[name])
        inside = log.time[(log.time >= view.time[0]) & (log.time <= view.time[-1])]
        gaps = np.diff(np.concatenate([[view.time[0]], inside, [view.time[-1]]]))
        if gaps.max() > _LONGEST_GAP:
            at = float(np.concatenate([[view.time[0]], inside])[np.argmax(gaps)])
            raise RecordingError(
                f"{worn[name].file}: there are no samples for {gaps.max():.1f} s after {at:.1f} s, and without markers "
                "this gap cannot be bridged. Choose a part of the trial without gaps by `window:`"
            )
        signals.append(log)
    chain, snap = _calibrate_chain(context, skeleton)
    mean, sds, reckoned, (levels, headings, heading_sds) = track_without_markers(signals, view.time, chain)
    worst = int(np.argmax(reckoned.residual))
    contradiction = (
        f"the accelerometers contradict the gyroscopes on the chain of the calibration, most on the {names[worst]}: by "
        f"{reckoned.residual[worst]:.2g} m/s² rms, expected at most {_FITTING:g}"
    )
    if reckoned.residual[worst] > _CONTRADICTING:
        raise Refused("imus-contradict", f"{contradiction}: no angles are given. {_CAUSES}")
    uncertain = sds[..., 0] > settings.angle_sd_limit
    mean[uncertain], sds[uncertain] = np.nan, np.nan

    out = Findings()
    sd, calibration = np.degrees(np.nanmean(sds[..., 0])), get_calibration(context.trial).trial.name
    drift = float(np.degrees(np.max(heading_sds)))
    out.say(
        "imus-alone",
        f"no camera recorded this trial: the angles (standard deviation {sd:.1f}°) are valid if every sensor was worn "
        f"as in {calibration}. Directions about the vertical, which drift by {drift:.0f}° in this trial, positions and "
        "forces are unknown.",
        float(sd),
    )
    off = float(reckoned.residual[worst])
    if off > _FITTING:
        text = f"{contradiction}: the angles may be wrong by 5° and more. {_CAUSES}"
        out.say("imus-contradict", text, off, _FITTING)
    imus: dict[str, dict[str, Any]] = {}
    for k, segment in enumerate(names):
        # clock relative to the first sensor, biases in this trial and mounting of the sensor
        found = chain.calibrations[k]
        normal = found.mount.T @ [0.0, 0.0, 1.0]
        in_plane = np.sqrt(1.0 - normal**2)
        gyro_sd = np.hypot(normal * reckoned.gyro_bias_sd[:, k].mean(), in_plane * SWITCHED_ON)
        acc_sd = np.hypot(in_plane * reckoned.force_bias_sd[k].max(), normal * FORCE_BIAS)
        clock_sd, saturated = float(reckoned.shift_sd[k]), float(np.mean(signals[k].saturated))
        present = replace(
            found,
            clock=Clock(-float(reckoned.shift[k]), 0.0, clock_sd, clock_sd <= OBSERVABLE_SD),
            gyro_bias=found.gyro_bias + normal * float(reckoned.gyro_bias[:, k].mean()),
            acc_bias=found.acc_bias + found.mount.T @ [*reckoned.force_bias[k], 0.0],
            sd=found.sd | {"gyro_bias": gyro_sd, "acc_bias": acc_sd},
            residual=np.array([np.nan, reckoned.residual[k]]),
        )
        heading, heading_sd = float(headings[k]), float(heading_sds[k])
        imus[segment] = describe_sensor(SensorResult(present, saturated)) | {
            "ppm": None,
            "gyro_residual_rad_s": None,
            "heading_deg": float(np.degrees(heading)),
            "heading_sd_deg": float(np.degrees(heading_sd)),
        }
        # the direction of gravity shows whether the sensor was rotated on its segment
        lean = float(np.arcsin(np.clip(abs(levels[k]) / GRAVITY, 0.0, 1.0)))
        if lean > _LARGEST_LEAN:
            out.say(
                "imu-moved",
                f"the sensor on the {segment} leans {np.degrees(lean):.0f}° out of the plane relative to the "
                "calibration: it was rotated on the segment, or the person leaned sideways. The errors of the angles "
                "may be larger than this, and no interval includes them.",
                float(np.degrees(lean)),
                float(np.degrees(_LARGEST_LEAN)),
            )
        # rotation of the segment about the vertical by more than its gyroscope's bias explains
        limit = _LARGEST_HEADING + 2.0 * heading_sd
        if abs(heading) > limit:
            out.say(
                "imu-heading",
                f"the {segment} rotated about the vertical by {np.degrees(abs(heading)):.0f}° (standard deviation "
                f"{np.degrees(heading_sd):.0f}°): the motion left its plane, so the angles in the plane are not the "
                "angles between the segments.",
                float(np.degrees(abs(heading))),
                float(np.degrees(limit)),
            )
        if reckoned.shift_sd[k] > OBSERVABLE_SD:
            report_clock(out, segment, clock_sd)
        report_saturation(out, segment, saturated)
        out.reasons += signals[k].reasons
    out.fact(
        marker_sd_m=None,
        sigma_v=snap.tolist(),
        reprojection_rms_m=None,
        outlier_fraction=None,
        bridged_fraction=[1.0] * len(names),
        method=settings.method,
        engine=settings.engine,
        sd_holds=SKIN,
        cut_off_hz=None,
        imus=imus,
    )

    moves = skeleton.marker_segment > 0
    moving = MarkerChain(skeleton.centres, skeleton.marker_segment[moves], skeleton.local[moves])
    skin = assume_skin(moving, mean[..., 0], tree.array("markers/residual")[moves], skeleton.covariance)
    labels = [label for label, k in zip(skeleton.markers, skeleton.marker_segment, strict=True) if k > 0]
    # the calibration's markers on the moving chain, with residuals of NaN
    places = marker_positions(mean[..., 0], skeleton.centres, skeleton.marker_segment, skeleton.local)
    x, y = (np.ascontiguousarray(places[..., i]) for i in range(2))
    markers = {"x": x, "y": y, "residual": np.full(x.shape, np.nan), "used": np.zeros(x.shape, np.bool_)}
    none = np.zeros((len(view.time), len(names)), np.bool_)
    values = state_columns(view.time, mean, sds, none)
    return (
        Table(STATES, values, out.facts, tuple(out.reasons)),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, markers),
        skin_motion.make_skin_tree(skin, labels, None, "no markers"),
        empty_encoder_table("the trial has inertial sensors alone"),
        Table(POSES, {"time": view.time}, {"bodies": []}),
        Table(ANGLES, {"time": view.time}),
    )


def _calibrate_chain(context: Context, skeleton: Skeleton) -> tuple[KnownChain, FloatArray]:
    """Return the chain with its sensors, calibrated on the trial with markers, and the joints' snap (n,), rad/s⁴."""
    calibration = get_calibration(context.trial)
    table = read_states(calibration)
    joints = JointStates.from_table(table)
    dt = float(joints.time[1] - joints.time[0])
    snap = np.array(table.facts["sigma_v"])
    mean = np.concatenate([joints.mean, np.zeros_like(joints.mean[..., :1])], axis=2)
    chain = MarkerChain(skeleton.centres.copy(), skeleton.marker_segment, skeleton.local)
    unused = np.zeros((0, 0), np.bool_)
    states = States(mean, joints.sd, joints.observed, unused, np.nan, snap, np.nan, chain)
    worn = list_sensors(calibration.imus)
    sensors = {s: read_sensor(worn[name]) for s, name in enumerate(skeleton.segments[1:], start=1)}
    try:
        return calibrate_chain(states, joints.time, sensors, snap**2 * dt), snap
    except NumericalError as error:
        files = ", ".join(sensor.file.name for sensor in worn.values())
        message = f"its inertial sensors ({files}) do not fit its markers ({error}); check their segments and files"
        raise RecordingError(f"{calibration.trial}: {message}") from error


_CAUSES = (
    "Check that each sensor is on the configured segment, that its units are rad/s and m/s², that its clock is right, "
    "that it was not rotated on its segment since the calibration, and that the calibration is of the same person."
)
