"""Contents of events.parquet and phases.parquet in the plane: events, zeros of the angles, averages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import PreparedTrial, SampledWrench, TrialData
from mocap_id.errors import ConfigError, RecordingError
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
    Averaged,
    Movement,
    average_repetitions,
    compare_angles,
    find_facing,
    interpolate_at,
    resample_repetitions,
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
from mocap_id.stages.trial_keys import StaticTrial
from mocap_id.store import Column, Table
from mocap_id.store.schemas import EVENTS, PHASES, RISE
from mocap_id.store.views import Skeleton, joint_columns, joint_count
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

    Parameters
    ----------
    missing : sequence of (T,) arrays
        Vertical force of the ground predicted by a body model minus the measured force, N: one array for each plausible
        clock offset; empty without a model. Of the supports that follow from these arrays, the smallest is used.
    share : float
        Share of the standing weight under the feet at seat-off, by the rule of the thesis.
    seat_measured : bool
        Whether the chair's force is measured and therefore not part of ``missing``.
    measured, modelled : (T,) bool arrays
        False where markers of the legs are visible but not used, and where the low-passed motion contains such samples.
        An event there is NaN, and chair contact that a model shows there is unknown.
    speed_sd : (T,) array, optional
        Standard deviation of the speed in the posture, rad/s; without it, those of the five-times test are unknown.
    clock_offset : float
        Clock offset of the plates that the fit found, s; both wrenches are still without this correction.
    """
    assert movement.posture is not None
    posture, repetitions, contact = movement.posture, movement.repetitions, movement.contact
    chair = None if contact is None else contact.chair
    weight = float("nan") if contact is None else contact.weight
    time, rises = recorded.time, []

    def correct(force: FloatArray) -> FloatArray:  # a force of the plates at the times of their clock
        return SampledWrench.of(time, force[:, None])(time - clock_offset)[:, 0]

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
    """Return the vertical ground force predicted by a body model minus the measured force, (T,) N.

    The model is the reference body or, without one, the identified model. There is one array with the estimated clock
    offset and one without it, because a wrong offset looks like a missing force. The result is empty without a plate
    or a model.
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
    names = Skeleton.from_tree(context.tree("chain.h5")).joint_names
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

    The standard deviation contains the difference between the phases, or that within a single phase, and the standard
    deviation of the states, which a mean does not reduce.
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

    ``zeros`` and ``reasons`` are the results of :func:`find_zeros`. The angles of another system (``compare:``) are
    averaged too.

    Raises
    ------
    ConfigError
        A joint or column under ``compare:`` does not exist.
    RecordingError
        The file under ``compare:`` cannot be used or does not overlap with the recording.
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
        table = recording.read_angles(compare.angles, {name.removeprefix("-") for name in compare.columns.values()})
        for joint_name, given in compare.columns.items():
            if joint_name not in names:
                raise ConfigError(
                    f"compare: columns: there is no joint {joint_name!r} here; expected one of {', '.join(names)}"
                )
            column, sign = given.removeprefix("-"), -1.0 if given.startswith("-") else 1.0
            number = names.index(joint_name) + 1
            values = interpolate_at(table.time, sign * table.angles[column], time)
            agreement = compare_angles(angles[number], values)
            known = bool(np.isfinite(agreement.r))
            compared.append(
                {
                    "joint": joint_name,
                    "column": given,
                    "r": agreement.r if known else None,
                    "offset_rad": agreement.offset if known else None,
                    "rmse_rad": agreement.rmse if known else None,
                    "samples": agreement.samples,
                    "why": None if known else "the two systems have no common time in which the joint moves",
                }
            )
            signals.append((f"theta_{number}_other", "rad", time, values))

    averages: list[tuple[str, str, str, Averaged]] = []
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
    for name in ("mean", "sd", "count"):
        columns[name] = np.concatenate([np.zeros(0), *(getattr(each, name) for *_, each in averages)])
    return Table(PHASES, columns, facts, reasons)
