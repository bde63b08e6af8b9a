"""Curls of a trial: events.parquet, facts on compensation and fatigue, and torques about the elbow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.priors import look_up_arm
from mocap_id.geometry import so3
from mocap_id.protocols.curl import (
    Curl,
    CurlRules,
    ElbowTorque,
    Mass,
    SegmentMotion,
    compute_elbow_torque,
    find_curls,
    find_trial_end,
    fit_part_in_step,
    fit_trend,
    measure_compensation,
)
from mocap_id.stages.base import Context
from mocap_id.stages.curl_keys import Body
from mocap_id.stages.device import DeviceFile
from mocap_id.store import Table
from mocap_id.store.schemas import EVENTS
from mocap_id.store.views import MEANINGLESS_AT_POLE, NEAR_GIMBAL, MeasuredPoses, SpatialSkeleton
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
    poses = MeasuredPoses.from_table(context.table("poses.parquet"))
    skeleton = SpatialSkeleton.from_tree(context.tree("chain.h5"))
    measured = poses.find_measured("upper_arm", "forearm")
    curls = find_curls(time, angles[_FLEXION], angles[f"sd_{_FLEXION}"], rules, measured)
    axis = _find_elbow_axis(poses, skeleton)
    axis[~poses.find_measured("upper_arm")] = np.nan
    end = find_trial_end(time, axis, curls, rules)
    channels, in_step = _collect_angles(context, poses, curls), None
    if _AXIAL in channels:
        covariance = None  # of the elbow's axis along x and y of the upper arm, (2, 2) rad²
        if "forearm" in skeleton.segments:
            covariance = skeleton.chain.joints[skeleton.segments.index("forearm") - 1].axes_covariance[0, :2, :2]
            covariance = covariance if np.isfinite(covariance).all() else None
        in_step = fit_part_in_step(time, *channels[_AXIAL], angles[_FLEXION], covariance, curls)
        if in_step is not None:
            channels[_AXIAL] = (channels[_AXIAL][0] - in_step.curve, in_step.rest_sd)
    moved = {name: measure_compensation(time, *channel, curls, rules) for name, channel in channels.items()}
    torque = _compute_torques(context, poses, skeleton, axis)

    # what may change with fatigue: one value for every complete curl
    done = [k for k, curl in enumerate(curls) if curl.complete]
    quantities = {
        "duration_s": np.array([curls[k].end - curls[k].start for k in done]),
        "amplitude_rad": np.array([curls[k].amplitude for k in done]),
    }
    for name, found in moved.items():
        ranges = [one.range if one is not None else np.nan for one in (found[k] for k in done)]
        quantities[f"{name}_range_rad"] = np.array(ranges)
    trends = {name: fit_trend(values) for name, values in quantities.items()}
    counted = [curl.complete and np.nanmin([curl.start, curl.top, curl.end, np.inf]) < end.time for curl in curls]
    facts: dict[str, Any] = {
        "why": "" if any(counted) else "no complete curl was found",
        "count": sum(counted),
        "partial": sum(not (curl.complete or curl.unknown) for curl in curls),
        "after_end": sum(curl.complete for curl in curls) - sum(counted),
        "end": {"time_s": end.time, "rule": end.rule, "why": end.why},
        "condition": keys.condition,
        "tempo_s": [float(curl.end - curl.start) if curl.timed else None for curl in curls],
        "compensation": {
            name: [
                None
                if one is None
                else {
                    "range_rad": one.range,
                    "interval_rad": list(one.range_interval),
                    "offset_rad": one.offset,
                    "offset_sd_rad": one.offset_sd,
                    "floor_rad": one.floor,
                    "sustained_s": one.sustained,
                }
                for one in found
            ]
            for name, found in moved.items()
        },
        "in_step": {},
        "torque": None,
        "torque_why": "",
        "fatigue": {
            name: None if one is None else {"slope": one.slope, "interval": list(one.interval), "count": one.count}
            for name, one in trends.items()
        },
    }
    if in_step is not None:
        facts["in_step"] = {_AXIAL: {"range_rad": in_step.range, "interval_rad": list(in_step.interval)}}
    reasons = () if any(counted) else (Reason("no-curls", facts["why"]),)
    if isinstance(torque, str):
        return _make_table(curls, facts | {"torque_why": torque}, reasons), {}
    facts["torque"] = [_find_peak_torques(time, torque, curl) for curl in curls]
    columns: dict[str, FloatArray] = {}
    for part, one in torque.items():
        suffix = f"_{part}" if part else ""
        columns |= {f"elbow_torque{suffix}": one.torque, f"sd_elbow_torque{suffix}": one.sd}
    return _make_table(curls, facts, reasons), columns


def _find_elbow_axis(poses: MeasuredPoses, skeleton: SpatialSkeleton) -> FloatArray:
    """Return the flexion axis of the elbow in the trial's axes (T, 3), towards the right of the arm.

    It is the fitted axis of a hinge or two-axis joint, or the z axis of the upper arm if the elbow is a ball joint.
    """
    axis = np.array([0.0, 0.0, 1.0])
    if "forearm" in poses.segments:
        joint = skeleton.chain.joints[skeleton.segments.index("forearm") - 1]
        if joint.kind != "ball":
            axis = joint.first_axis * (1.0 if joint.first_axis[2] >= 0 else -1.0)
    return np.asarray(poses.rotation[:, poses.segments.index("upper_arm")] @ axis)


def _collect_angles(
    context: Context, poses: MeasuredPoses, curls: Sequence[Curl]
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


def _find_peak_torques(
    time: FloatArray, torques: Mapping[str, ElbowTorque], curl: Curl
) -> dict[str, float | None] | None:
    """Return the peaks of total and person's torque in a curl and their standard deviations, N·m; None if unknown.

    A curl in part of which the arm is not measured has no peak.
    """
    within = (time >= curl.start) & (time <= (curl.end if np.isfinite(curl.end) else time[-1]))
    if not np.isfinite(torques[""].torque[within]).all():
        return None
    found: dict[str, float | None] = {}
    for name, one in (("", torques[""]), ("person_", torques["person"])):
        there = np.flatnonzero(within & np.isfinite(one.torque))
        k = there[np.argmax(one.torque[there])] if len(there) else None
        found[f"{name}peak_Nm"] = None if k is None else float(one.torque[k])
        found[f"{name}sd_Nm"] = None if k is None else float(one.sd[k])
    return found if found["peak_Nm"] is not None else None


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


_ADDED_SD, _TABLE_SD = 0.02, 0.15  # relative standard deviation of a mass: weighed, and from a table


def _compute_torques(
    context: Context, poses: MeasuredPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> dict[str, ElbowTorque] | str:
    """Return the torques about the elbow's axis, or a text that says why they are unknown.

    The names are "" for the total torque, and "device" and "person" for its two parts, which are NaN if the trial has
    no file of a device.
    """
    total = _compute_total_torque(context, poses, skeleton, axis)
    if isinstance(total, str):
        return total
    keys, angles = context.trial.curl, context.table("angles.parquet")
    unknown = np.full(len(poses.time), np.nan)
    device = person = ElbowTorque(unknown, unknown)
    if keys.device is not None:
        file = DeviceFile.model_validate(keys.device)
        angle_sd = np.hypot(angles["sd_elbow_flexion"], angles["constant_sd_elbow_flexion"])
        device = ElbowTorque(*file.torque(file.sealed, angles["elbow_flexion"], angles["delbow_flexion"], angle_sd))
        person = ElbowTorque(total.torque - device.torque, np.hypot(total.sd, device.sd))
    hidden = ~poses.find_measured("upper_arm", "forearm", "hand")
    return {
        name: ElbowTorque(*(np.where(hidden, np.nan, each) for each in (one.torque, one.sd)))
        for name, one in (("", total), ("device", device), ("person", person))
    }


def _compute_total_torque(
    context: Context, poses: MeasuredPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> ElbowTorque | str:
    """Return the total torque about the elbow's axis, or a text that says why it is unknown."""
    keys, subject, table = context.trial.curl, context.trial.subject, context.table("poses.parquet")
    carried = [name for name in ("forearm", "hand") if name in poses.segments]
    if "forearm" not in carried:
        return "no segment is the forearm"
    if subject.mass is None and (keys.forearm is None or keys.hand is None):
        return "the inertia of forearm and hand is unknown; give `subject: {mass: …}`, or `curl: {forearm: …, hand: …}`"
    segments = []
    for name in carried:
        k = poses.segments.index(name)
        loads = [body for body in keys.loads.values() if body.segment == name or "hand" not in carried]
        own = _make_own_bodies(context, skeleton, name, alone="hand" not in carried)
        omega, alpha = (table.stack([f"{name}_{rate}_{axis}" for axis in "xyz"]) for rate in ("omega", "alpha"))
        bodies = [*own, *(_make_mass(body, _ADDED_SD) for body in loads)]
        segments.append(
            SegmentMotion(poses.origin[:, k], poses.rotation[:, k], omega, alpha, table[f"sd_{name}_alpha"], bodies)
        )
    tilt = float(np.nanmedian(table["sd_forearm_rotation"]))
    return compute_elbow_torque(poses.time, axis, segments, tilt=tilt)


def _make_own_bodies(context: Context, skeleton: SpatialSkeleton, name: str, *, alone: bool) -> list[Mass]:
    """Return the body of a segment, from the user or from the table by the person's mass and the segment's length.

    If the chain has no hand (``alone``), the result also contains the body of the hand, at the end of the forearm.
    """
    keys, subject = context.trial.curl, context.trial.subject
    length = skeleton.lengths.get("forearm", (np.nan, np.nan))[0]
    bodies = []
    for segment in (name, "hand") if alone else (name,):
        below = np.array([0.0, -length, 0.0]) if alone and segment == "hand" else np.zeros(3)
        given = keys.forearm if segment == "forearm" else keys.hand
        if given is not None:
            mass = _make_mass(given, _ADDED_SD)
        else:
            share = look_up_arm("forearm" if segment == "forearm" else "hand", subject.sex)
            own = length if segment == "forearm" else length * share.length / look_up_arm("forearm", subject.sex).length
            weight = share.mass * (subject.mass or np.nan)
            across = weight * (share.gyration * own) ** 2
            mass = Mass(weight, np.array([0.0, -share.centre * own, 0.0]), np.array([across, 0.0, across]), _TABLE_SD)
        bodies.append(Mass(mass.mass, mass.centre + below, mass.inertia, mass.relative_sd))
    return bodies


def _make_mass(body: Body, relative_sd: float) -> Mass:
    return Mass(body.mass, np.array(body.centre), np.array(body.inertia), relative_sd)
