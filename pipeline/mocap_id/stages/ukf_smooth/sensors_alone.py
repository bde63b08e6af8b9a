"""States of a trial of inertial sensors alone, for the stage ukf-smooth."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import NumericalError, RecordingError, Refused
from mocap_id.estimation import States
from mocap_id.estimation.dead_reckoning import FORCE_BIAS, SWITCHED_ON
from mocap_id.estimation.inertial import SensorSignals
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.inertial_tracking import ShownChain, Tracked, show_chain, track_alone
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.estimation.noise import FilterNoise
from mocap_id.geometry.planar import marker_positions
from mocap_id.recording.imu_log import read_imu
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import get_calibration, read_states
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.columns import state_columns
from mocap_id.stages.ukf_smooth.encoder_states import no_encoder
from mocap_id.stages.ukf_smooth.inertial import OBSERVABLE, SATURATED, check_method, clock_reason, saturated_reason
from mocap_id.stages.ukf_smooth.state_errors import SKIN, assumed_skin
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import ANGLES, MARKERS, POSES, STATES
from mocap_id.store.views import JointStates, Skeleton, Trajectories
from mocap_id.verdict import Reason

_LONGEST_GAP = 0.5  # s without samples of a sensor
_TURNED = np.radians(3.0)  # of a sensor out of the plane against the calibration
_FITTING, _CONTRADICTING = 0.1, 0.5  # m/s² rms between accelerometers and gyroscopes; 0.05 in simulated people
_LEFT = np.radians(15.0)  # turn about the vertical, beyond twice its standard deviation


def states_of_sensors(context: Context) -> Outputs:
    """Return the artefacts of the stage for a trial without markers.

    Raises
    ------
    ConfigError
        The method is not the usual one.
    RecordingError
        A log cannot be read or has a long gap, or the calibration does not show its sensors.
    Refused
        Accelerometers and gyroscopes contradict each other.
    """
    settings: UkfSmoothSettings = context.settings
    check_method(settings.method, settings.engine)
    skeleton = Skeleton.from_tree(context.tree("chain.h5"))
    view = Trajectories(context.long("planar.parquet"))
    names = skeleton.segments[1:]
    signals = [_signals(context, name, view.time) for name in names]
    shown, snap = _shown(context, skeleton)
    tracked = track_alone(signals, view.time, shown)
    worst = int(np.argmax(tracked.reckoning.residual))
    if tracked.reckoning.residual[worst] > _CONTRADICTING:
        raise Refused("imus-contradict", f"{_contradiction(tracked, worst, names)}: no angles are given. {_CAUSES}")
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
        "imus": {name: _facts(tracked, shown, k, signals[k]) for k, name in enumerate(names)},
    }
    states = _as_states(tracked, skeleton, snap)
    residual = context.tree("chain.h5").array("markers/residual")[skeleton.marker_segment > 0]
    skin = assumed_skin(states, residual, skeleton.covariance)
    labels = [label for label, k in zip(skeleton.markers, skeleton.marker_segment, strict=True) if k > 0]
    return (
        Table(
            STATES,
            state_columns(view.time, tracked.mean, tracked.sd, states.observed),
            facts,
            _reasons(context, tracked, names, signals),
        ),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, _markers(tracked, skeleton)),
        skin_artefact.make_skin_tree(skin, labels, None, "no markers"),
        no_encoder("the trial has inertial sensors alone"),
        Table(POSES, {"time": view.time}, {"bodies": []}),
        Table(ANGLES, {"time": view.time}),
    )


def _signals(context: Context, name: str, time: FloatArray) -> SensorSignals:
    """Return the log of a sensor without long gaps in the time of the trial."""
    file = context.trial.imus[name]
    log = read_imu(file)
    inside = log.time[(log.time >= time[0]) & (log.time <= time[-1])]
    gaps = np.diff(np.concatenate([[time[0]], inside, [time[-1]]]))
    if gaps.max() > _LONGEST_GAP:
        at = float(np.concatenate([[time[0]], inside])[np.argmax(gaps)])
        raise RecordingError(
            f"{file}: has no samples for {gaps.max():.1f} s after {at:.1f} s; without markers nothing bridges this. "
            "Choose a part without gaps by `window:`"
        )
    return SensorSignals(log.time, log.gyro, log.acc)


def _shown(context: Context, skeleton: Skeleton) -> tuple[ShownChain, FloatArray]:
    """Return the chain with its sensors from the trial with markers, and the snap (n,) of its joints, rad/s⁴."""
    calibration = get_calibration(context.trial)
    table = read_states(calibration)
    joints = JointStates.from_table(table)
    dt = float(joints.time[1] - joints.time[0])
    snap = np.array(table.facts["sigma_v"])
    mean = np.concatenate([joints.mean, np.zeros_like(joints.mean[..., :1])], axis=2)
    chain = MarkerChain(skeleton.centres.copy(), skeleton.marker_segment, skeleton.local)
    noise = FilterNoise(np.nan, snap)
    states = States(mean, joints.sd, joints.observed, np.zeros((0, 0), np.bool_), noise, np.nan, chain)
    sensors = {}
    for s, name in enumerate(skeleton.segments[1:], start=1):
        log = read_imu(calibration.imus[name])
        sensors[s] = SensorSignals(log.time, log.gyro, log.acc)
    try:
        return show_chain(states, joints.time, sensors, snap**2 * dt), snap
    except NumericalError as error:
        files = ", ".join(file.name for file in calibration.imus.values())
        message = f"its inertial sensors ({files}) do not fit its markers ({error}); check their segments and files"
        raise RecordingError(f"{calibration.trial}: {message}") from error


def _facts(tracked: Tracked, shown: ShownChain, k: int, signals: SensorSignals) -> dict[str, Any]:
    """Return the facts of one sensor: its clock against the first one, and what changed since the calibration."""
    found, reckoned = shown.known.carried[k].found, tracked.reckoning
    normal = found.mount.T @ [0.0, 0.0, 1.0]
    bias = found.gyro_bias + normal * float(reckoned.gyro_bias[:, k].mean())
    in_plane = np.sqrt(1.0 - normal**2)
    gyro_sd = np.hypot(normal * reckoned.gyro_bias_sd[:, k].mean(), in_plane * SWITCHED_ON)
    acc_sd = np.hypot(in_plane * reckoned.force_bias_sd[k].max(), normal * FORCE_BIAS)
    return {
        "used": True,
        "why": None,
        "clock_offset_s": -float(reckoned.shift[k]),
        "sd_s": float(reckoned.shift_sd[k]),
        "ppm": None,
        "observable": bool(reckoned.shift_sd[k] <= OBSERVABLE),
        "gyro_bias_rad_s": bias.tolist(),
        "gyro_bias_sd_rad_s": gyro_sd.tolist(),
        "acc_bias_m_s2": (found.acc_bias + found.mount.T @ [*reckoned.force_bias[k], 0.0]).tolist(),
        "acc_bias_sd_m_s2": acc_sd.tolist(),
        "mounting": found.mount.tolist(),
        "mounting_sd_deg": float(np.degrees(np.max(found.sd["turn"]))),
        "position_m": found.place.tolist(),
        "position_sd_m": found.sd["place"].tolist(),
        "skin_share": found.lag,
        "gyro_residual_rad_s": None,
        "acc_residual_m_s2": float(reckoned.residual[k]),
        "saturated": float(np.mean(signals.saturated)),
        "heading_deg": float(np.degrees(tracked.heading[k])),
        "heading_sd_deg": float(np.degrees(tracked.heading_sd[k])),
    }


def _reasons(
    context: Context, tracked: Tracked, names: tuple[str, ...], signals: list[SensorSignals]
) -> tuple[Reason, ...]:
    sd, name = np.degrees(np.nanmean(tracked.sd[..., 0])), get_calibration(context.trial).trial.name
    drift = float(np.degrees(np.max(tracked.heading_sd)))
    reasons = [
        Reason(
            "imus-alone",
            f"no camera saw this trial: the angles (standard deviation {sd:.1f}°) hold if every sensor sat as in "
            f"{name}. Directions about the vertical are unknown (after this trial by {drift:.0f}°), as are places and "
            "forces.",
            float(sd),
        )
    ]
    worst = int(np.argmax(tracked.reckoning.residual))
    off = float(tracked.reckoning.residual[worst])
    if off > _FITTING:
        text = f"{_contradiction(tracked, worst, names)}: the angles may be wrong by 5° and more. {_CAUSES}"
        reasons.append(Reason("imus-contradict", text, off, _FITTING))
    for k, segment in enumerate(names):
        reasons += _moved(tracked, k, segment) + _left(tracked, k, segment)
        if tracked.reckoning.shift_sd[k] > OBSERVABLE:
            reasons.append(clock_reason(segment, float(tracked.reckoning.shift_sd[k])))
        share = float(np.mean(signals[k].saturated))
        if share > SATURATED:
            reasons.append(saturated_reason(segment, share))
    return tuple(reasons)


def _contradiction(tracked: Tracked, worst: int, names: tuple[str, ...]) -> str:
    return (
        f"the accelerometers contradict the gyroscopes on the chain of the calibration, most on the {names[worst]}: by "
        f"{tracked.reckoning.residual[worst]:.2g} m/s² rms, expected at most {_FITTING:g}"
    )


_CAUSES = (
    "Check which sensor is on which segment, its units (rad/s and m/s²) and clock, that it was not turned since the "
    "calibration, and that the calibration is of the same person."
)


def _moved(tracked: Tracked, k: int, segment: str) -> list[Reason]:
    """Return a caution if gravity shows that a sensor was turned on its segment since the calibration."""
    turned = float(np.arcsin(np.clip(abs(tracked.level[k]) / GRAVITY, 0.0, 1.0)))
    if turned <= _TURNED:
        return []
    message = (
        f"the sensor on the {segment} leans {np.degrees(turned):.0f}° out of the plane against the calibration: it was "
        "turned on it, or the person leaned sideways. The angles may be wrong by more, which no interval includes."
    )
    return [Reason("imu-moved", message, float(np.degrees(turned)), float(np.degrees(_TURNED)))]


def _left(tracked: Tracked, k: int, segment: str) -> list[Reason]:
    """Return a caution if a segment turned about the vertical by more than its gyroscope's bias explains."""
    turn, sd = abs(float(tracked.heading[k])), float(tracked.heading_sd[k])
    limit = _LEFT + 2.0 * sd
    if turn <= limit:
        return []
    message = (
        f"the {segment} turned about the vertical by {np.degrees(turn):.0f}° (standard deviation "
        f"{np.degrees(sd):.0f}°): the motion left its plane, and angles between segments are not those in the plane."
    )
    return [Reason("imu-heading", message, float(np.degrees(turn)), float(np.degrees(limit)))]


def _as_states(tracked: Tracked, skeleton: Skeleton, snap: FloatArray) -> States:
    moves = skeleton.marker_segment > 0
    chain = MarkerChain(skeleton.centres, skeleton.marker_segment[moves], skeleton.local[moves])
    shape = tracked.mean.shape[:2]
    none, used = np.zeros(shape, np.bool_), np.zeros((shape[0], int(moves.sum())), np.bool_)
    return States(tracked.mean, tracked.sd, none, used, FilterNoise(np.nan, snap), np.nan, chain)


def _markers(tracked: Tracked, skeleton: Skeleton) -> dict[str, np.ndarray[Any, Any]]:
    """Return the places where the chain has its markers; none was seen."""
    place = marker_positions(tracked.mean[..., 0], skeleton.centres, skeleton.marker_segment, skeleton.local)
    x, y = (np.ascontiguousarray(place[..., i]) for i in range(2))
    return {"x": x, "y": y, "residual": np.full(x.shape, np.nan), "used": np.zeros(x.shape, np.bool_)}
