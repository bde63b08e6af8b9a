"""Curls of a trial: events.parquet with one row for each curl, and facts on compensation, torque and fatigue."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.protocols.curl.compensation import Compensation, fit_part_in_step, measure_compensation
from mocap_id.protocols.curl.repetitions import Curl, CurlRules, find_curls, fit_trend
from mocap_id.protocols.curl.trial_end import find_trial_end
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.curl_torques import CurlTorques, compute_curl_torques
from mocap_id.store import Table
from mocap_id.store.schemas import EVENTS
from mocap_id.store.spatial_views import MEANINGLESS_AT_POLE, NEAR_GIMBAL, SegmentPoses, SpatialSkeleton
from mocap_id.verdict import Reason

_FLEXION = "elbow_flexion"
_SHOULDER = ("shoulder_plane", "shoulder_elevation", "shoulder_axial")
_AXIAL = _SHOULDER[2]  # angle that contains the error of the elbow's axis
_THORAX = ("thorax_lateral", "thorax_axial", "thorax_flexion")  # rotations about x, y, z of the thorax


def find_curl_events(context: Context) -> tuple[Table, dict[str, FloatArray]]:
    """Return events.parquet of a trial with `protocol: curl`, and the torque columns of dynamics.parquet if known."""
    angles, keys = context.table("angles.parquet"), context.trial.curl
    time = angles["time"]
    if _FLEXION not in angles.names:
        why = (
            "the flexion of the elbow is unknown, because the chain has no upper arm and forearm with landmarks. Curls "
            "hardly move the shoulder: name a trial of the same person in which all joints move as `calibration:`"
        )
        return _make_table((), {"why": why}, (Reason("no-curls", why),)), {}
    rules = CurlRules(
        metronome=keys.metronome_hz,
        attempt=float(np.radians(keys.attempt_deg)),
        complete=keys.complete,
        tempo=keys.tempo,
        pause=keys.pause,
        plane=float(np.radians(keys.plane_deg)),
        compensation=float(np.radians(keys.compensation_deg)),
        sustained=keys.sustained_s,
    )
    poses = SegmentPoses.from_table(context.table("poses.parquet"))
    skeleton = SpatialSkeleton.from_tree(context.tree("chain.h5"))
    measured = poses.find_measured("upper_arm", "forearm")
    curls = find_curls(time, angles[_FLEXION], angles[f"sd_{_FLEXION}"], rules, measured)
    axis = _find_elbow_axis(poses, skeleton)
    axis[~poses.find_measured("upper_arm")] = np.nan
    end = find_trial_end(time, axis, curls, rules)
    channels, in_step = _collect_angles(context, poses, curls), None
    if _AXIAL in channels:
        covariance = _find_axis_covariance(skeleton)
        in_step = fit_part_in_step(time, *channels[_AXIAL], angles[_FLEXION], covariance, curls)
        if in_step is not None:
            channels[_AXIAL] = (channels[_AXIAL][0] - in_step.curve, in_step.rest_sd)
    moved = {name: measure_compensation(time, *channel, curls, rules) for name, channel in channels.items()}
    torque = compute_curl_torques(context, poses, skeleton, axis)
    if not isinstance(torque, str):
        torque = torque.leave_out(~poses.find_measured("upper_arm", "forearm", "hand"))
    counted = [curl.complete and np.nanmin([curl.start, curl.top, curl.end, np.inf]) < end.time for curl in curls]
    facts: dict[str, Any] = {
        "why": "" if any(counted) else "no complete curl was found",
        "count": sum(counted),
        "partial": sum(not (curl.complete or curl.unknown) for curl in curls),
        "after_end": sum(curl.complete for curl in curls) - sum(counted),
        "end": {"time_s": end.time, "rule": end.rule, "why": end.why},
        "condition": keys.condition,
        "tempo_s": [float(curl.end - curl.start) if curl.timed else None for curl in curls],
        "compensation": {name: [_describe_compensation(one) for one in found] for name, found in moved.items()},
        "in_step": {},
        "torque": None,
        "torque_why": "",
        "fatigue": {name: _describe_trend(values) for name, values in _collect_quantities(curls, moved).items()},
    }
    if in_step is not None:
        facts["in_step"] = {_AXIAL: {"range_rad": in_step.range, "interval_rad": list(in_step.interval)}}
    reasons = () if any(counted) else (Reason("no-curls", facts["why"]),)
    if isinstance(torque, str):
        return _make_table(curls, facts | {"torque_why": torque}, reasons), {}
    facts["torque"] = [_find_peak_torques(time, torque, curl) for curl in curls]
    return _make_table(curls, facts, reasons), torque.columns()


def _find_elbow_axis(poses: SegmentPoses, skeleton: SpatialSkeleton) -> FloatArray:
    """Return the flexion axis of the elbow in the trial's axes (T, 3), towards the right of the arm.

    It is the fitted axis of a hinge or two-axis joint, or the z axis of the upper arm if the elbow is a ball joint.
    """
    axis = np.array([0.0, 0.0, 1.0])
    if "forearm" in poses.segments:
        joint = skeleton.chain.joints[skeleton.segments.index("forearm") - 1]
        if joint.kind != "ball":
            axis = joint.first_axis * (1.0 if joint.first_axis[2] >= 0 else -1.0)
    return np.asarray(poses.rotation[:, poses.segments.index("upper_arm")] @ axis)


def _find_axis_covariance(skeleton: SpatialSkeleton) -> FloatArray | None:
    """Return the covariance (2, 2) of the elbow's axis along x and y of the upper arm, rad²; None if unknown."""
    if "forearm" not in skeleton.segments:
        return None
    covariance = skeleton.chain.joints[skeleton.segments.index("forearm") - 1].axes_covariance[0, :2, :2]
    return covariance if np.isfinite(covariance).all() else None


def _collect_angles(
    context: Context, poses: SegmentPoses, curls: Sequence[Curl]
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the angles (T,) of shoulder and thorax and the standard deviations of their changes, rad, by name."""
    angles, table = context.table("angles.parquet"), context.table("poses.parquet")
    channels = {}
    clear = angles["isb_condition"] < NEAR_GIMBAL if "isb_condition" in angles.names else None
    for name in _SHOULDER:
        if name in angles.names:
            value = angles[name]
            if name in MEANINGLESS_AT_POLE and clear is not None:
                value = np.where(clear, value, np.nan)
            value = np.where(poses.find_measured("thorax", "upper_arm"), value, np.nan)
            channels[name] = (value, angles[f"sd_{name}"])
    done = [curl for curl in curls if curl.timed]
    if done and "thorax" in poses.segments:
        turn = poses.rotation[:, poses.segments.index("thorax")]
        turn = np.where(poses.find_measured("thorax")[:, None, None], turn, np.nan)
        known = np.flatnonzero(np.isfinite(turn).all(axis=(1, 2)) & (poses.time >= done[0].start))
        if len(known):
            lean = so3.log(turn[known[0]].T @ np.where(np.isfinite(turn), turn, np.eye(3)))
            lean[~np.isfinite(turn).all(axis=(1, 2))] = np.nan
            channels |= {name: (lean[:, i], table["sd_thorax_rotation"]) for i, name in enumerate(_THORAX)}
    return channels


def _find_peak_torques(time: FloatArray, torques: CurlTorques, curl: Curl) -> dict[str, float | None] | None:
    """Return the peaks of total and person's torque in a curl and their standard deviations, N·m; None if unknown.

    A curl in part of which the arm is not measured has no peak.
    """
    within = (time >= curl.start) & (time <= (curl.end if np.isfinite(curl.end) else time[-1]))
    if not np.isfinite(torques.total.torque[within]).all():
        return None
    found: dict[str, float | None] = {}
    for name, one in (("", torques.total), ("person_", torques.person)):
        there = np.flatnonzero(within & np.isfinite(one.torque))
        k = there[np.argmax(one.torque[there])] if len(there) else None
        found[f"{name}peak_Nm"] = None if k is None else float(one.torque[k])
        found[f"{name}sd_Nm"] = None if k is None else float(one.sd[k])
    return found if found["peak_Nm"] is not None else None


def _collect_quantities(
    curls: Sequence[Curl], moved: dict[str, tuple[Compensation | None, ...]]
) -> dict[str, FloatArray]:
    """Return the quantities that may change with fatigue by name, each with one value for every complete curl."""
    done = [k for k, curl in enumerate(curls) if curl.complete]
    quantities = {
        "duration_s": np.array([curls[k].end - curls[k].start for k in done]),
        "amplitude_rad": np.array([curls[k].amplitude for k in done]),
    }
    for name, found in moved.items():
        ranges = [one.range if one is not None else np.nan for one in (found[k] for k in done)]
        quantities[f"{name}_range_rad"] = np.array(ranges)
    return quantities


def _describe_compensation(one: Compensation | None) -> dict[str, Any] | None:
    if one is None:
        return None
    return {
        "range_rad": one.range,
        "interval_rad": list(one.range_interval),
        "offset_rad": one.offset,
        "offset_sd_rad": one.offset_sd,
        "floor_rad": one.floor,
        "sustained_s": one.sustained,
    }


def _describe_trend(values: FloatArray) -> dict[str, Any] | None:
    trend = fit_trend(values)
    return None if trend is None else {"slope": trend.slope, "interval": list(trend.interval), "count": trend.count}


def _make_table(curls: Sequence[Curl], facts: dict[str, Any], reasons: tuple[Reason, ...]) -> Table:
    nothing = np.full(len(curls), np.nan)
    columns = {
        "kind": np.array(["curl"] * len(curls), dtype=object),
        **{
            name: np.array([getattr(curl, name) for curl in curls], dtype=np.float64)
            for name in ("start", "top", "end")
        },
        **dict.fromkeys(("seat_off", "stand", "seat_on"), nothing),
        "amplitude": np.array([curl.amplitude for curl in curls], dtype=np.float64),
        "complete": np.array([curl.complete for curl in curls], dtype=np.bool_),
        "why": np.array([curl.why for curl in curls], dtype=object),
    }
    return Table(EVENTS, columns, {"curl": facts}, reasons)
