"""Contents of events.parquet and phases.parquet: events of all movements, zeros of the angles, averages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from mocap_id import recording
from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.dynamics.preparation import PreparedTrial, SampledWrench, TrialData
from mocap_id.dynamics.priors import look_up_arm
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import so3
from mocap_id.protocols.curl import (
    CurlRules,
    Mass,
    SegmentMotion,
    compute_elbow_torque,
    find_curls,
    find_trial_end,
    fit_part_in_step,
    fit_trend,
    measure_compensation,
)
from mocap_id.protocols.five_times import (
    LOAD_PHASES,
    REQUIRED_RISES,
    LoadShare,
    Spread,
    compute_five_times,
    compute_load_share,
    find_failed_attempts,
    find_foot_plates,
)
from mocap_id.protocols.movement import (
    GRID,
    Movement,
    average_repetitions,
    compare_angles,
    find_facing,
    interpolate_at,
    resample_repetitions,
)
from mocap_id.protocols.reach import (
    ANGLES,
    HELD,
    AngleRange,
    Reach,
    RecordedArm,
    UnknownReach,
    compute_level_heights,
    compute_reach_surface,
    compute_workspace,
    find_reaches,
    find_usable_samples,
    find_visited_region,
    get_angle,
    locate_body_targets,
    measure_arm,
    measure_ranges,
)
from mocap_id.protocols.repetitions import (
    Posture,
    RiseDetails,
    find_greatest_height,
    find_model_agreement,
    find_share_crossing,
    find_standing_phases,
    measure_paused_time,
    measure_support,
)
from mocap_id.protocols.sit_to_stand import add_remarks, estimate_event_sd, explain_repetitions
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.device import DeviceFile
from mocap_id.stages.trial_keys import Body, StaticTrial
from mocap_id.store import Column, Table
from mocap_id.store.artefacts import (
    MEANINGLESS_AT_POLE,
    NEAR_GIMBAL,
    MeasuredPoses,
    Skeleton,
    SpatialAngles,
    SpatialSkeleton,
    joint_columns,
    joint_count,
)
from mocap_id.store.provenance import EVENTS, PHASES, RISE
from mocap_id.verdict import Reason


def make_sit_to_stand_events(
    plates: Table,
    recorded: TrialData,
    movement: Movement,
    missing: Sequence[FloatArray],
    *,
    share: float,
    seat_measured: bool,
    measured: BoolArray,
    modelled: BoolArray,
    speed_sd: FloatArray | None = None,
    clock_offset: float = 0.0,
) -> Table:
    """Return events.parquet of a sit-to-stand with a known posture; ``plates`` is wrench.parquet.

    ``missing`` are the vertical forces (T,) of a model minus the measured one, N, by :func:`compute_missing_force`; of
    the supports that follow from them, the smallest is used. ``share`` of the standing weight is under the feet at
    seat-off, by the rule of the thesis. ``seat_measured`` says whether the chair's force is measured and therefore not
    in ``missing``. ``measured`` and ``modelled`` (T,) are False where markers of the legs are visible but not used, and
    where the low-passed motion contains such samples: an event there is NaN, and chair contact that a model shows there
    is unknown. Without ``speed_sd`` (T,), rad/s, those of the five-times test are unknown. Both wrenches are still
    without the ``clock_offset`` of the plates, s, that the fit found.
    """
    assert movement.posture is not None
    posture, repetitions, contact = movement.posture, movement.repetitions, movement.contact
    chair = None if contact is None else contact.chair
    weight = float("nan") if contact is None else contact.weight
    time, rises = recorded.time, []

    def correct(force: FloatArray) -> FloatArray:  # a force of the plates at the times of their clock
        return SampledWrench(time, force[:, None])(time - clock_offset)[:, 0]

    vertical = correct(recorded.wrench[:, 1]) / weight
    attempts = tuple(
        each
        for each in find_failed_attempts(time, posture, vertical, repetitions, chair=chair)
        if measured[np.searchsorted(time, each.time_s)]
    )

    # the left foot's share of the load in each repetition by phase (R,), NaN where unknown, and over all repetitions
    across: list[tuple[int, float]] = []
    for plate in plates.facts.get("plates") or ():
        if plate.get("use") == "feet":
            z = plate.get("across_m")
            across.append((int(plate["index"]), float(z) if isinstance(z, (int, float)) else float("nan")))
    feet = find_foot_plates(across, find_facing(recorded))
    if isinstance(feet, str):
        load_share = LoadShare(why=feet)
        shares = {phase: np.full(len(repetitions), np.nan) for phase in LOAD_PHASES}
    else:
        left, right = (correct(plates[f"Fy_p{plate}"]) for plate in feet)
        shares = compute_load_share(time, posture, left, right, repetitions)
        spreads = {}
        for phase, values in shares.items():
            known = values[np.isfinite(values)]
            mean, sd = (known.mean() if len(known) else None), (known.std(ddof=1) if len(known) > 1 else None)
            spreads[phase] = Spread(mean=mean, sd=sd)
        load_share = LoadShare(left_plate=feet[0], right_plate=feet[1], left=spreads)

    # details of every rise
    for k, each in enumerate(repetitions):
        model = float("nan") if contact is None else find_model_agreement(time, contact.above_noise, each)
        at = int(np.searchsorted(time, model))  # the end if NaN
        rising = (time >= each.start) & (time <= each.stand)
        since = repetitions[k - 1].stand if k else -np.inf
        rise = RiseDetails(
            seat_off_72=find_share_crossing(time, vertical, share, each) if chair is True else float("nan"),
            seat_off_model=model if at < len(time) and modelled[at] else float("nan"),
            reached=find_greatest_height(time, posture, each, measured),
            held=measure_paused_time(time, posture, each) if measured[rising].all() else float("nan"),
            # failed attempts between the stand of the previous repetition and that of this one
            attempts=sum(since < attempt.time_s < each.stand for attempt in attempts),
            left_seated=float(shares["seated"][k]),
            left_rising=float(shares["rising"][k]),
            left_standing=float(shares["standing"][k]),
        )
        if missing and chair is not None:
            supports = [
                measure_support(time, posture, force, weight, each, seat_measured=seat_measured) for force in missing
            ]
            rise = replace(rise, support=min(supports))
        rises.append(rise)
    by_forces = contact is not None and contact.rule in {"seat-plate", "weight"}
    seat = () if by_forces else ("seat_off", "seat_on")
    repetitions = tuple(
        each.leave_out(time, measured, ("start", "stand", "end")).leave_out(time, modelled, seat)
        for each in repetitions
    )
    event_sd = None
    if speed_sd is not None and chair is not False:
        above_noise = None if contact is None else contact.above_noise
        event_sd = estimate_event_sd(time, posture, repetitions, speed_sd, above_noise)
    five_times = compute_five_times(repetitions, tuple(rises), chair=chair, event_sd=event_sd)
    facts = {
        "five_times": {"asked": REQUIRED_RISES, **five_times.model_dump()},
        "attempts": [attempt.model_dump() for attempt in attempts],
        "load_share": load_share.model_dump(),
    }
    reasons = explain_repetitions(repetitions, rises, attempts, posture)
    rows = [{**asdict(add_remarks(each, rise)), **asdict(rise)} for each, rise in zip(repetitions, rises, strict=True)]
    return make_events(rows, RISE, facts, reasons)


def make_events(
    rows: Sequence[Mapping[str, Any]],
    more: Sequence[Column] = (),
    facts: Mapping[str, Any] | None = None,
    reasons: tuple[Reason, ...] = (),
) -> Table:
    """Return events.parquet, one row for each repetition, with ``more`` columns than those of every movement."""
    columns = {}
    for column in (*EVENTS.columns, *more):
        kind = object if column.dtype == "str" else column.dtype
        columns[column.name] = np.array([row[column.name] for row in rows], dtype=kind)
    return Table(EVENTS, columns, facts or {}, reasons)


def make_arm_events(
    kind: Literal["reach", "curl"],
    rows: Sequence[Mapping[str, Any]],
    facts: dict[str, Any],
    reasons: tuple[Reason, ...],
) -> Table:
    """Return events.parquet of the reaches or curls of an arm, which have no events at a chair."""
    arm, reach, curl = EVENTS.optional[1:]
    usual = {"kind": kind, **dict.fromkeys(("seat_off", "stand", "seat_on"), np.nan)}
    more = (*arm, *(reach if kind == "reach" else curl))
    return make_events([{**usual, **row} for row in rows], more, {kind: facts}, reasons)


def compute_missing_force(prepared: PreparedTrial | None, columns: Mapping[str, FloatArray]) -> tuple[FloatArray, ...]:
    """Return the vertical ground force predicted by a body model minus the measured force, (T,) N; () without a model.

    The model is the reference body or, without one, the identified model. There is one array with the estimated clock
    offset and one without it, because a wrong offset looks like a missing force.
    """
    if prepared is None:
        return ()
    everything = prepared.recorded.surroundings[:, 1]
    for model in ("Fy_reference", "Fy_model"):
        expected = columns[model]
        if np.isfinite(expected).any():
            return expected - columns["Fy"], expected + columns.get("Fy_external", 0.0) - everything
    return ()


_STILL = np.radians(2.0)  # largest standard deviation of a joint angle in a still pose


def find_zeros(context: Context, posture: Posture | None) -> tuple[list[dict[str, Any]], tuple[Reason, ...]]:
    """Return the zero of every joint for JSON, in the order of the joints, and cautions about the static pose.

    Raises RecordingError if the times under ``static:`` are outside the states.
    """
    states, static = context.table("states.parquet"), context.trial.static
    names = Skeleton(context.tree("chain.h5")).joint_names
    time = states["time"]
    seen = joint_columns(states, "observed", len(names)).astype(np.bool_)
    q = np.where(seen, joint_columns(states, "theta", len(names)), np.nan)
    known: dict[str, tuple[FloatArray, FloatArray]] = {}
    out = Findings()
    if posture is not None:
        phases = find_standing_phases(posture)
        if phases:
            known["standing"] = _average(states, q, phases)
    if isinstance(static, StaticTrial):
        pose = context.tree("chain.h5").facts["static"]
        known["static"] = np.array(pose["theta"], dtype=np.float64), np.array(pose["sd_theta"], dtype=np.float64)
    elif static is not None:
        inside = np.flatnonzero((time >= static[0]) & (time <= static[1]))
        if len(inside) < 2:
            raise RecordingError(
                f"static: no motion is known from {static[0]:g} to {static[1]:g} s; the used part of the recording is "
                f"{time[0]:g} to {time[-1]:g} s. Give times in this part, or change `window:`"
            )
        known["static"] = _average(states, q, [slice(int(inside[0]), int(inside[-1]) + 1)])
        spread = [
            float(np.std(angle[shown])) if shown.any() else 0.0
            for angle, shown in zip(q[inside].T, np.isfinite(q[inside]).T, strict=True)
        ]
        moved = max(spread)
        if moved > _STILL:
            out.say(
                "static-moves",
                f"the person does not stand still from {static[0]:g} to {static[1]:g} s: the angle of the "
                f"{names[spread.index(moved)]} has a standard deviation of {np.degrees(moved):.1f}°, so the zero of "
                "the joint angles is uncertain. Give a still part in `static:`, or leave it out",
                moved,
                float(_STILL),
            )
    zeros: list[dict[str, Any]] = []
    for j, name in enumerate(names):
        source = next((each for each in ("static", "standing") if each in known and np.isfinite(known[each][0][j])), "")
        value, sd = (float(each[j]) for each in known[source]) if source else (0.0, 0.0)
        mean = np.nanmean(q[:, j]) if np.isfinite(q[:, j]).any() else value
        value += 2 * np.pi * round((mean - value) / (2 * np.pi))
        known_sd = sd if np.isfinite(sd) else None  # some methods give states without standard deviations
        zeros.append({"joint": name, "source": source or "segment line", "zero": float(value), "sd": known_sd})
    hidden = [each["joint"] for each in zeros if static is not None and each["source"] != "static"]
    if hidden:
        out.say(
            "static-hidden",
            f"the markers in the static pose do not show the angle of: {', '.join(hidden)}. The zero of these joints "
            "is not that of `static:`. Give a static pose in which the markers of all segments are visible",
            float(len(hidden)),
            0.0,
        )
    return zeros, tuple(out.reasons)


def _average(states: Table, q: FloatArray, phases: list[slice]) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the angles (T, n) over the means of some phases, (n,) rad, and its standard deviation.

    It contains the difference between the phases, or that within a single phase, and the standard deviation of the
    states, which a mean does not reduce.
    """
    known = f"sd_theta_{q.shape[1]}" in states.names
    sd = joint_columns(states, "sd_theta", q.shape[1]) if known else np.full(q.shape, np.nan)
    mean, own, between = np.full((3, q.shape[1]), np.nan)
    for j, angle in enumerate(q.T):
        seen = [phase for phase in phases if np.isfinite(angle[phase]).any()]
        if not seen:
            continue
        each = [float(np.nanmean(angle[phase])) for phase in seen]
        mean[j] = np.mean(each)
        between[j] = np.std(each, ddof=1) / np.sqrt(len(each)) if len(each) > 1 else np.nanstd(angle[seen[0]])
        own[j] = np.sqrt(np.mean(np.concatenate([sd[phase, j][np.isfinite(angle[phase])] ** 2 for phase in seen])))
    return mean, np.hypot(own, between)


SPANS = {"repetition": ("start", "end"), "rise": ("start", "stand")}
_WRENCH = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
_SOURCES = ("", "_model", "_reference")


def average_signals(
    context: Context,
    events: Table,
    dynamics: Table,
    zeros: Sequence[Mapping[str, Any]] = (),
    reasons: tuple[Reason, ...] = (),
) -> Table:
    """Return phases.parquet: the average of every signal over the repetitions, at 0, 1 … 100 % of a repetition.

    ``zeros`` and ``reasons`` are those of :func:`find_zeros`. The angles of another system (``compare:``) are averaged
    too. Raises ConfigError if a joint or column under ``compare:`` does not exist, RecordingError if its file cannot be
    used or does not overlap with the recording.
    """
    states = context.table("states.parquet")
    time, wrench_time, joints = states["time"], dynamics["time"], range(1, joint_count(states) + 1)
    angles = {joint: np.where(states[f"observed_{joint}"], states[f"theta_{joint}"], np.nan) for joint in joints}
    signals = [(f"theta_{joint}", "rad", time, angle) for joint, angle in angles.items()]
    signals += [
        (f"{name}{source}", unit, wrench_time, dynamics[f"{name}{source}"])
        for name, unit in _WRENCH.items()
        for source in _SOURCES
    ]
    signals += [(f"tau_{joint}", "N*m", wrench_time, dynamics[f"tau_{joint}"]) for joint in joints]
    signals += [
        (f"angle_{joint}", "rad", time, angles[joint] - zero["zero"]) for joint, zero in enumerate(zeros, start=1)
    ]

    # angles of the other system at the times of the states, and their agreement
    compared, compare = [], context.trial.compare
    if compare is not None:
        names = context.tree("chain.h5").texts("joints/name")
        wanted = {name.removeprefix("-") for name in compare.columns.values()}
        stamps, others = recording.read_angles(compare.angles, wanted)
        for joint_name, given in compare.columns.items():
            if joint_name not in names:
                raise ConfigError(
                    f"compare: columns: there is no joint {joint_name!r} here; expected one of {', '.join(names)}"
                )
            column, sign = given.removeprefix("-"), -1.0 if given.startswith("-") else 1.0
            number = names.index(joint_name) + 1
            values = interpolate_at(stamps, sign * others[column], time)
            r, offset, rmse, samples = compare_angles(angles[number], values)
            known = bool(np.isfinite(r))
            compared.append(
                {
                    "joint": joint_name,
                    "column": given,
                    "r": r if known else None,
                    "offset_rad": offset if known else None,
                    "rmse_rad": rmse if known else None,
                    "samples": samples,
                    "why": None if known else "the two systems have no common time in which the joint moves",
                }
            )
            signals.append((f"theta_{number}_other", "rad", time, values))

    averages: list[tuple[str, str, str, tuple[FloatArray, FloatArray, FloatArray]]] = []
    counts: dict[str, int] = {}
    for span, (begin, finish) in SPANS.items():
        bounds = events.stack([begin, finish])
        bounds = bounds[bounds[:, 1] > bounds[:, 0]]  # False where either is NaN
        counts[span] = len(bounds)
        for name, unit, at, values in signals if len(bounds) else ():
            averages.append((span, name, unit, average_repetitions(resample_repetitions(at, values, bounds))))
    why = None if any(counts.values()) else "no repetition has both its beginning and its end in the recording"
    facts = {"repetitions": counts, "compared": compared, "why": why, "zeros": list(zeros)}
    # 101 rows for each pair of span and quantity
    columns: dict[str, Any] = {"percent": np.tile(100 * GRID, len(averages))}
    for k, name in enumerate(("span", "quantity", "unit")):
        columns[name] = np.repeat(np.array([row[k] for row in averages], dtype=object), len(GRID))
    for k, name in enumerate(("mean", "sd", "count")):
        columns[name] = np.concatenate([np.zeros(0), *(each[k] for *_, each in averages)])
    return Table(PHASES, columns, facts, reasons)


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
    poses = MeasuredPoses(context.table("poses.parquet"))
    skeleton = SpatialSkeleton(context.tree("chain.h5"))
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
    end, rule, observed = find_trial_end(time, axis, curls, rules)

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
            channels[_AXIAL] = (channels[_AXIAL][0] - in_step[0], in_step[1])
    moved = {name: measure_compensation(time, *channel, curls, rules) for name, channel in channels.items()}
    torque = _compute_torques(context, poses, skeleton, axis)

    # what may change with fatigue: one value for every complete curl
    done = [k for k, curl in enumerate(curls) if curl.complete]
    quantities = {
        "duration_s": [curls[k].end - curls[k].start for k in done],
        "amplitude_rad": [curls[k].amplitude for k in done],
    }
    for name, found in moved.items():
        ranges = [found[k] for k in done]
        quantities[f"{name}_range_rad"] = [np.nan if one is None else one["range_rad"] for one in ranges]
    counted = [curl.complete and np.nanmin([curl.start, curl.top, curl.end, np.inf]) < end for curl in curls]
    facts: dict[str, Any] = {
        "why": "" if any(counted) else "no complete curl was found",
        "count": sum(counted),
        "partial": sum(not (curl.complete or curl.unknown) for curl in curls),
        "after_end": sum(curl.complete for curl in curls) - sum(counted),
        "end": {"time_s": end, "rule": rule, "why": observed},
        "condition": keys.condition,
        "tempo_s": [float(curl.end - curl.start) if curl.timed else None for curl in curls],
        "compensation": moved,
        "in_step": {},
        "torque": None,
        "torque_why": "",
        "fatigue": {name: fit_trend(np.array(values)) for name, values in quantities.items()},
    }
    if in_step is not None:
        facts["in_step"] = {_AXIAL: {"range_rad": in_step[2], "interval_rad": in_step[3]}}
    reasons = () if any(counted) else (Reason("no-curls", facts["why"]),)
    rows = [asdict(curl) for curl in curls]
    if isinstance(torque, str):
        return make_arm_events("curl", rows, facts | {"torque_why": torque}, reasons), {}
    # peaks of total and person's torque in each curl, N·m; a curl in part of which the arm is not measured has none
    facts["torque"] = []
    for curl in curls:
        within = (time >= curl.start) & (time <= (curl.end if np.isfinite(curl.end) else time[-1]))
        peaks: dict[str, float | None] = {}
        for prefix, (one, sd) in (("", torque[""]), ("person_", torque["person"])):
            there = np.flatnonzero(within & np.isfinite(one))
            k = there[np.argmax(one[there])] if len(there) else None
            peaks[f"{prefix}peak_Nm"] = None if k is None else float(one[k])
            peaks[f"{prefix}sd_Nm"] = None if k is None else float(sd[k])
        whole = np.isfinite(torque[""][0][within]).all()
        facts["torque"].append(peaks if whole and peaks["peak_Nm"] is not None else None)
    columns: dict[str, FloatArray] = {}
    for part, (one, sd) in torque.items():
        suffix = f"_{part}" if part else ""
        columns |= {f"elbow_torque{suffix}": one, f"sd_elbow_torque{suffix}": sd}
    return make_arm_events("curl", rows, facts, reasons), columns


_ADDED_SD, _TABLE_SD = 0.02, 0.15  # relative standard deviation of a mass: weighed, and from a table


def _compute_torques(
    context: Context, poses: MeasuredPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]] | str:
    """Return the torques about the elbow's axis with their sd, (T,) N·m, or a text that says why they are unknown.

    The two parts are NaN if the trial has no file of a device.
    """
    keys, subject, table = context.trial.curl, context.trial.subject, context.table("poses.parquet")
    carried = [name for name in ("forearm", "hand") if name in poses.segments]
    if "forearm" not in carried:
        return "no segment is the forearm"
    if subject.mass is None and (keys.forearm is None or keys.hand is None):
        return "the inertia of forearm and hand is unknown; give `subject: {mass: …}`, or `curl: {forearm: …, hand: …}`"
    segments, alone = [], "hand" not in carried
    length = skeleton.lengths.get("forearm", (np.nan, np.nan))[0]

    def make_mass(body: Body) -> Mass:
        return Mass(body.mass, np.array(body.centre), np.array(body.inertia), _ADDED_SD)

    for name in carried:
        k = poses.segments.index(name)
        # bodies given by the user, or from the table by the person's mass and the segment's length; if the chain has no
        # hand, that of the hand is at the end of the forearm
        bodies = []
        for part in (name, "hand") if alone else (name,):
            below = np.array([0.0, -length, 0.0]) if alone and part == "hand" else np.zeros(3)
            given = keys.forearm if part == "forearm" else keys.hand
            if given is not None:
                mass = make_mass(given)
            else:
                arm, forearm = look_up_arm(part, subject.sex), look_up_arm("forearm", subject.sex)
                own = length if part == "forearm" else length * arm.length / forearm.length
                weight = arm.mass * (subject.mass or np.nan)
                across = weight * (arm.gyration * own) ** 2
                mass = Mass(weight, np.array([0.0, -arm.centre * own, 0.0]), np.array([across, 0.0, across]), _TABLE_SD)
            bodies.append(Mass(mass.mass, mass.centre + below, mass.inertia, mass.relative_sd))
        bodies += [make_mass(body) for body in keys.loads.values() if body.segment == name or alone]
        omega, alpha = (table.stack([f"{name}_{rate}_{axis}" for axis in "xyz"]) for rate in ("omega", "alpha"))
        segments.append(
            SegmentMotion(poses.origin[:, k], poses.rotation[:, k], omega, alpha, table[f"sd_{name}_alpha"], bodies)
        )
    tilt = float(np.nanmedian(table["sd_forearm_rotation"]))
    total = compute_elbow_torque(poses.time, axis, segments, tilt=tilt)

    # the parts of device and person
    angles, unknown = context.table("angles.parquet"), np.full(len(poses.time), np.nan)
    device = person = unknown, unknown
    if keys.device is not None:
        file = DeviceFile.model_validate(keys.device)
        angle_sd = np.hypot(angles["sd_elbow_flexion"], angles["constant_sd_elbow_flexion"])
        device = file.torque(file.sealed, angles["elbow_flexion"], angles["delbow_flexion"], angle_sd)
        person = total[0] - device[0], np.hypot(total[1], device[1])
    hidden = ~poses.find_measured("upper_arm", "forearm", "hand")
    return {
        name: (np.where(hidden, np.nan, one), np.where(hidden, np.nan, sd))
        for name, (one, sd) in (("", total), ("device", device), ("person", person))
    }


_LEAST_RANGE = np.radians(2.0)  # smallest range of an angle that moves
_CLEARLY = 0.005  # m, least distance by which the hand is beyond its known ends while the arm is not measured
_PATH = 600  # approximate number of points of the path of the wrist
_NO_REGION = "the visited postures have no volume in joint space: an angle hardly moves independently of the others"


def find_reach_events(context: Context) -> Table:
    """Return events.parquet of a trial with `protocol: reach`."""
    angles = SpatialAngles(context.table("angles.parquet"))
    poses = MeasuredPoses(context.table("poses.parquet"))
    chain = context.tree("chain.h5")
    skeleton = SpatialSkeleton(chain)
    ranges = measure_ranges(angles, poses, skeleton=chain.facts.get("frames") == "skeleton")
    facts: dict[str, Any] = {"why": "", "ranges": {}}
    for name, own in ranges.items():
        # the errors of both ends add, because a tilt of the thorax or sliding skin often moves them apart
        low, high, low_sd, high_sd, spread = np.degrees(
            [own.low, own.high, own.low_sd, own.high_sd, own.low_sd + own.high_sd]
        ).tolist()
        width = high - low
        facts["ranges"][name] = {
            "low_deg": low,
            "high_deg": high,
            "range_deg": width,
            "interval_deg": [max(width - NORMAL_95 * spread, 0.0), width + NORMAL_95 * spread],
            "low_sd_deg": low_sd,
            "high_sd_deg": high_sd,
            "used_share": own.used_share,
        }
    reaches: tuple[Reach, ...] = ()
    try:
        arm = measure_arm(angles, poses, skeleton, context.trial.subject.height)
        reaches = find_reaches(angles.time, arm)
        misses: dict[str, list[float]] = {}
        for one in reaches:
            if one.target != "none":
                misses.setdefault(one.target, []).append(one.miss)
        # path of the wrist, arm at its furthest reach and targets, for the view on the page
        known = np.flatnonzero(arm.measured & np.isfinite(arm.wrists).all(axis=1))
        if not len(known):
            raise UnknownReach("no frame has markers of the whole arm")
        far = known[np.argmax(np.linalg.norm(arm.wrists[known], axis=1))]
        path = arm.wrists[known[:: max(len(known) // _PATH, 1)]]
        facts |= {
            "lengths_m": {"upper_arm": float(np.linalg.norm(arm.arm.elbow)), "forearm": arm.arm.forearm},
            "arm_length_m": arm.arm.length,
            "shoulder_m": arm.shoulder.tolist(),
            "glide_m": arm.glide.tolist(),
            "view": {
                "path_m": path.round(3).tolist(),
                "arm_m": np.stack([np.zeros(3), arm.elbows[far], arm.wrists[far]]).round(3).tolist(),
                "targets_m": {name: place.round(3).tolist() for name, place in locate_body_targets(arm).items()},
            },
            "heights": _measure_heights(angles.time, arm),
            "tasks": {
                name: {"count": len(each), "best_miss_m": min(each), "median_miss_m": float(np.median(each))}
                for name, each in misses.items()
            },
        }
        facts |= _compute_volumes(angles, poses, arm, ranges)
    except UnknownReach as unknown:
        facts["why"] = str(unknown)
    reasons = (Reason("no-reach", f"the reachable volume is unknown: {facts['why']}"),) if facts["why"] else ()
    return make_arm_events("reach", [asdict(one) | {"miss_m": one.miss} for one in reaches], facts, reasons)


def _measure_heights(time: FloatArray, arm: RecordedArm) -> dict[str, Any]:
    """Return the highest and lowest position of the wrist, and the levels that the middle of the hand reached.

    They are None if the hand was probably higher or lower, or at this level, only while the arm is not measured.
    """
    rank = max(round(HELD / float(np.median(np.diff(time)))), 1)
    ends = {}
    for name, path in (("wrist", arm.wrists), ("palm", arm.palms)):
        for side, sign in (("high", 1.0), ("low", -1.0)):
            height = sign * path[:, 1]
            seen = np.sort(height[arm.measured & np.isfinite(height)])
            hidden = height[~arm.measured & np.isfinite(height)]
            end = float(seen[-rank]) if len(seen) >= rank else np.nan
            ends[name, side] = sign * end, bool(np.any(hidden > end + _CLEARLY))
    highest, lowest = (None if beyond else end for end, beyond in (ends["wrist", "high"], ends["wrist", "low"]))
    palm, beyond = ends["palm", "high"]
    return {
        "highest_m": highest,
        "lowest_m": lowest,
        "highest_share": None if highest is None else highest / arm.arm.length,
        "lowest_share": None if lowest is None else lowest / arm.arm.length,
        "levels": {
            name: True if palm >= height else None if beyond else False
            for name, height in compute_level_heights(arm).items()
        },
    }


def _compute_volumes(
    angles: SpatialAngles, poses: MeasuredPoses, arm: RecordedArm, ranges: Mapping[str, AngleRange]
) -> dict[str, Any]:
    """Return facts on the reachable volume and surface, within the box of the ranges and within the visited region.

    Raises UnknownReach if an angle has no range, or if the elbow bends the wrong way.
    """
    still = [name for name in ANGLES if name not in ranges or ranges[name].high - ranges[name].low < _LEAST_RANGE]
    if still:
        names = " and ".join(name.replace("_", " ") for name in still)
        raise UnknownReach(f"{names} change by less than {np.degrees(_LEAST_RANGE):.0f}° where they are defined")
    flexion = ranges["elbow_flexion"]
    if flexion.low + flexion.high < 0:
        raise UnknownReach(
            f"the elbow bends backwards (flexion from {np.degrees(flexion.low):.0f}° to "
            f"{np.degrees(flexion.high):.0f}°), as if it were the arm of the other side: correct `side:`"
        )
    usable = np.logical_and.reduce([find_usable_samples(angles, poses, name) for name in ANGLES])
    postures = np.stack([get_angle(angles, name, usable) for name in ANGLES], axis=1)
    limits = np.array([(ranges[name].low, ranges[name].high) for name in ANGLES])
    region = find_visited_region(postures, limits)
    box, within, sd, sources = compute_workspace(arm, ranges, region)
    surfaces = {"box": compute_reach_surface(arm.arm, limits)}
    if region is not None:
        surfaces["visited"] = compute_reach_surface(arm.arm, *region)

    # the part of the box between the recorded postures
    visited: dict[str, Any] = dict.fromkeys(("volume_m3", "interval_m3", "share"))
    visited |= {"meaning": _NO_REGION, "why": _NO_REGION}
    if within is not None:
        share = within["volume_m3"] / box["volume_m3"]
        visited = within | {
            "share": share,
            "why": None,
            "meaning": (
                "In the box, every angle has its whole range at all values of the other angles. The postures between "
                f"the recorded postures reach {100 * share:.0f} % of its volume; whether the rest can be reached is "
                "unknown. The true volume is between both volumes, nearer to the box if the angles can be combined "
                "more freely."
            ),
        }
    polar, azimuth, *_ = surfaces["box"]
    directions = {"theta_deg": polar, "psi_deg": azimuth}
    radii = {
        f"{name}_m": [[round(r, 3) if np.isfinite(r) else None for r in row] for row in radius.tolist()]
        for name, (_, _, radius, _) in surfaces.items()
    }
    return {
        **box,
        "sd_m3": sd,
        "relative_volume": box["volume_m3"] / (4 / 3 * np.pi * arm.arm.length**3),  # of a sphere with the arm's length
        "sources": sources,
        "box_deg": {name.split("_")[1]: np.degrees(pair).tolist() for name, pair in zip(ANGLES, limits, strict=True)},
        "visited": visited,
        "surface": {name: areas for name, (*_, areas) in surfaces.items()},
        "mesh": {name: np.degrees(each).round(2).tolist() for name, each in directions.items()} | radii,
    }
