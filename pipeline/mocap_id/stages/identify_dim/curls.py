"""Curls of a trial: events.parquet, facts on compensation and fatigue, and torques about the elbow."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.priors import look_up_arm
from mocap_id.geometry import so3
from mocap_id.protocols.curl import (
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
from mocap_id.stages.identify_dim.events import make_arm_events
from mocap_id.store import Table
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
        return make_arm_events("curl", (), {"why": why}, (Reason("no-curls", why),)), {}
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
    # the flexion axis of the elbow in the trial's axes (T, 3), towards the right of the arm: the fitted axis of a hinge
    # or two-axis joint, or the z axis of the upper arm if the elbow is a ball joint
    forearm = skeleton.segments.index("forearm") if "forearm" in skeleton.segments else 0
    elbow = skeleton.chain.joints[forearm - 1] if forearm else None  # a forearm that is the base has no elbow
    fixed = np.array([0.0, 0.0, 1.0])
    if elbow is not None and elbow.kind != "ball":
        fixed = elbow.first_axis * (1.0 if elbow.first_axis[2] >= 0 else -1.0)
    axis = np.asarray(poses.rotation[:, poses.segments.index("upper_arm")] @ fixed)
    axis[~poses.find_measured("upper_arm")] = np.nan
    end = find_trial_end(time, axis, curls, rules)

    # angles (T,) of shoulder and thorax, and the standard deviations of their changes, rad
    channels: dict[str, tuple[FloatArray, FloatArray]] = {}
    clear = angles["isb_condition"] < NEAR_GIMBAL if "isb_condition" in angles.names else None
    for name in _SHOULDER:
        if name in angles.names:
            value = angles[name]
            if name in MEANINGLESS_AT_POLE and clear is not None:
                value = np.where(clear, value, np.nan)
            value = np.where(poses.find_measured("thorax", "upper_arm"), value, np.nan)
            channels[name] = (value, angles[f"sd_{name}"])
    timed = [curl for curl in curls if curl.timed]
    if timed and "thorax" in poses.segments:
        turn = poses.rotation[:, poses.segments.index("thorax")]
        turn = np.where(poses.find_measured("thorax")[:, None, None], turn, np.nan)
        known = np.flatnonzero(np.isfinite(turn).all(axis=(1, 2)) & (poses.time >= timed[0].start))
        if len(known):
            lean = so3.log(turn[known[0]].T @ np.where(np.isfinite(turn), turn, np.eye(3)))
            lean[~np.isfinite(turn).all(axis=(1, 2))] = np.nan
            sd = context.table("poses.parquet")["sd_thorax_rotation"]
            channels |= {name: (lean[:, i], sd) for i, name in enumerate(_THORAX)}
    in_step = None
    if _AXIAL in channels:
        covariance = None  # of the elbow's axis along x and y of the upper arm, (2, 2) rad²
        if elbow is not None:
            covariance = elbow.axes_covariance[0, :2, :2]
            covariance = covariance if np.isfinite(covariance).all() else None
        in_step = fit_part_in_step(time, *channels[_AXIAL], angles[_FLEXION], covariance, curls)
        if in_step is not None:
            channels[_AXIAL] = (channels[_AXIAL][0] - in_step.curve, in_step.rest_sd)
    moved = {name: measure_compensation(time, *channel, curls, rules) for name, channel in channels.items()}
    torque = _compute_torques(context, poses, skeleton, axis)

    # what may change with fatigue: one value for every complete curl
    done = [k for k, curl in enumerate(curls) if curl.complete]
    quantities = {
        "duration_s": [curls[k].end - curls[k].start for k in done],
        "amplitude_rad": [curls[k].amplitude for k in done],
    }
    for name, found in moved.items():
        quantities[f"{name}_range_rad"] = [np.nan if one is None else one.range for one in (found[k] for k in done)]
    trends = {name: fit_trend(np.array(values)) for name, values in quantities.items()}
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
    rows = [asdict(curl) for curl in curls]
    if isinstance(torque, str):
        return make_arm_events("curl", rows, facts | {"torque_why": torque}, reasons), {}
    # peaks of total and person's torque in each curl, N·m; a curl in part of which the arm is not measured has none
    facts["torque"] = []
    for curl in curls:
        within = (time >= curl.start) & (time <= (curl.end if np.isfinite(curl.end) else time[-1]))
        peaks: dict[str, float | None] = {}
        for prefix, one in (("", torque[""]), ("person_", torque["person"])):
            there = np.flatnonzero(within & np.isfinite(one.torque))
            k = there[np.argmax(one.torque[there])] if len(there) else None
            peaks[f"{prefix}peak_Nm"] = None if k is None else float(one.torque[k])
            peaks[f"{prefix}sd_Nm"] = None if k is None else float(one.sd[k])
        whole = np.isfinite(torque[""].torque[within]).all()
        facts["torque"].append(peaks if whole and peaks["peak_Nm"] is not None else None)
    columns: dict[str, FloatArray] = {}
    for part, one in torque.items():
        suffix = f"_{part}" if part else ""
        columns |= {f"elbow_torque{suffix}": one.torque, f"sd_elbow_torque{suffix}": one.sd}
    return make_arm_events("curl", rows, facts, reasons), columns


_ADDED_SD, _TABLE_SD = 0.02, 0.15  # relative standard deviation of a mass: weighed, and from a table


def _compute_torques(
    context: Context, poses: MeasuredPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> dict[str, ElbowTorque] | str:
    """Return the torques about the elbow's axis, or a text that says why they are unknown.

    The names are "" for the total torque, and "device" and "person" for its two parts, which are NaN if the trial has
    no file of a device.
    """
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
    total = compute_elbow_torque(poses.time, axis, segments, tilt=tilt)

    # the parts of device and person
    angles, unknown = context.table("angles.parquet"), np.full(len(poses.time), np.nan)
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
