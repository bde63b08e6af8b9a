"""Contents of events.parquet of a trial in the plane: events of the repetitions, and details of a sit-to-stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.dynamics.preparation import PreparedTrial, TrialData
from mocap_id.protocols.attempts import Attempt, find_failed_attempts
from mocap_id.protocols.five_times import REQUIRED_RISES, compute_five_times
from mocap_id.protocols.load_share import LOAD_PHASES, LoadShare, Spread, compute_load_share, find_foot_plates
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.remarks import add_remarks, explain_repetitions
from mocap_id.protocols.repetitions import (
    Repetition,
    RiseDetails,
    find_greatest_height,
    find_model_agreement,
    find_share_crossing,
    measure_paused_time,
    measure_support,
)
from mocap_id.protocols.sit_to_stand import estimate_event_sd
from mocap_id.store import Column, Table
from mocap_id.store.schemas import EVENTS, RISE


def make_sit_to_stand_events(
    plates: Table,
    recorded: TrialData,
    movement: Movement,
    missing: Sequence[FloatArray],
    *,
    share: float,
    seat_measured: bool,
    measured: BoolArray | None = None,
    modelled: BoolArray | None = None,
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
    measured : (T,) array, optional
        False where markers of the legs are visible but not used. An event there is NaN.
    modelled : (T,) array, optional
        False where the low-passed motion contains such samples. Chair contact that a model shows there is unknown.
    speed_sd : (T,) array, optional
        Standard deviation of the speed in the posture, rad/s; without it, those of the five-times test are unknown.
    clock_offset : float
        Clock offset of the plates that the fit found, s; both wrenches are still without this correction.
    """
    assert movement.posture is not None
    posture, repetitions, contact = movement.posture, movement.repetitions, movement.contact
    chair = None if contact is None else contact.chair
    weight = float("nan") if contact is None else contact.weight
    stamped = recorded.time - clock_offset
    everything = np.ones(len(stamped), dtype=np.bool_)
    measured, modelled = (everything if each is None else each for each in (measured, modelled))
    vertical = _sample(recorded.time, recorded.wrench[:, 1], stamped) / weight
    attempts = tuple(
        each
        for each in find_failed_attempts(recorded.time, posture, vertical, repetitions, chair=chair)
        if measured[np.searchsorted(recorded.time, each.time_s)]
    )
    load_share, shares = _share_load(plates, recorded, posture, movement, stamped)
    rises = tuple(
        replace(
            _describe_rise(k, recorded.time, movement, vertical, share=share, measured=measured, modelled=modelled),
            attempts=_count_attempts_before(k, repetitions, attempts),
            left_seated=float(shares["seated"][k]),
            left_rising=float(shares["rising"][k]),
            left_standing=float(shares["standing"][k]),
        )
        for k in range(len(repetitions))
    )
    if missing and chair is not None:
        rises = tuple(
            replace(
                rise,
                support=min(
                    measure_support(recorded.time, posture, force, weight, each, seat_measured=seat_measured)
                    for force in missing
                ),
            )
            for each, rise in zip(repetitions, rises, strict=True)
        )
    by_forces = contact is not None and contact.rule in {"seat-plate", "weight"}
    seat = () if by_forces else ("seat_off", "seat_on")
    repetitions = tuple(
        each.leave_out(recorded.time, measured, ("start", "stand", "end")).leave_out(recorded.time, modelled, seat)
        for each in repetitions
    )
    event_sd = None
    if speed_sd is not None and chair is not False:
        above_noise = None if contact is None else contact.above_noise
        event_sd = estimate_event_sd(recorded.time, posture, repetitions, speed_sd, above_noise)
    five_times = compute_five_times(repetitions, rises, chair=chair, event_sd=event_sd)
    facts = {
        "five_times": {"asked": REQUIRED_RISES, **five_times.model_dump()},
        "attempts": [attempt.model_dump() for attempt in attempts],
        "load_share": load_share.model_dump(),
    }
    reasons = explain_repetitions(repetitions, rises, attempts, posture)
    return Table(EVENTS, _make_columns(repetitions, rises), facts, reasons)


def _count_attempts_before(k: int, repetitions: Sequence[Repetition], attempts: Sequence[Attempt]) -> int:
    """Return the number of failed attempts between the stand of the previous repetition and the stand of ``k``."""
    since = repetitions[k - 1].stand if k else -np.inf
    return sum(since < attempt.time_s < repetitions[k].stand for attempt in attempts)


def _describe_rise(
    k: int,
    time: FloatArray,
    movement: Movement,
    vertical: FloatArray,
    *,
    share: float,
    measured: BoolArray,
    modelled: BoolArray,
) -> RiseDetails:
    """Return the details of repetition ``k``; ``vertical`` (T,) is the vertical force as a share of the weight."""
    assert movement.posture is not None
    each, contact = movement.repetitions[k], movement.contact
    chair = contact is not None and contact.chair is True
    model = float("nan") if contact is None else find_model_agreement(time, contact.above_noise, each)
    at = int(np.searchsorted(time, model))  # the end if NaN
    rising = (time >= each.start) & (time <= each.stand)
    return RiseDetails(
        seat_off_72=find_share_crossing(time, vertical, share, each) if chair else float("nan"),
        seat_off_model=model if at < len(time) and modelled[at] else float("nan"),
        reached=find_greatest_height(time, movement.posture, each, measured),
        held=measure_paused_time(time, movement.posture, each) if measured[rising].all() else float("nan"),
    )


def make_events(repetitions: Sequence[Repetition]) -> Table:
    """Return events.parquet of a movement other than sit-to-stand, one row for each repetition."""
    return Table(EVENTS, _stack_rows([asdict(each) for each in repetitions], EVENTS.columns))


def _make_columns(repetitions: Sequence[Repetition], rises: Sequence[RiseDetails]) -> dict[str, Any]:
    rows = [{**asdict(add_remarks(each, rise)), **asdict(rise)} for each, rise in zip(repetitions, rises, strict=True)]
    return _stack_rows(rows, (*EVENTS.columns, *RISE))


def _stack_rows(rows: Sequence[Mapping[str, Any]], columns: Sequence[Column]) -> dict[str, Any]:
    kinds = [object if column.dtype == "str" else column.dtype for column in columns]
    names = [column.name for column in columns]
    return {name: np.array([row[name] for row in rows], dtype=kind) for name, kind in zip(names, kinds, strict=True)}


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


def _sample(time: FloatArray, force: FloatArray, stamped: FloatArray) -> FloatArray:
    """Return a force (T,) of the plates at the times ``stamped`` (T,) of their clock, s."""
    return SampledWrench.of(time, force[:, None])(stamped)[:, 0]


def _share_load(
    plates: Table, recorded: TrialData, posture: Posture, movement: Movement, stamped: FloatArray
) -> tuple[LoadShare, dict[str, FloatArray]]:
    """Return the load share over all repetitions, and in each one by phase, (R,), NaN where unknown."""
    across: list[tuple[int, float]] = []
    for plate in plates.facts.get("plates") or ():
        if plate.get("use") == "feet":
            z = plate.get("across_m")
            across.append((int(plate["index"]), float(z) if isinstance(z, (int, float)) else float("nan")))
    found = find_foot_plates(across, find_facing(recorded))
    if isinstance(found, str):
        return LoadShare(why=found), {phase: np.full(len(movement.repetitions), np.nan) for phase in LOAD_PHASES}
    left, right = (_sample(recorded.time, plates[f"Fy_p{plate}"], stamped) for plate in found)
    shares = compute_load_share(recorded.time, posture, left, right, movement.repetitions)
    known = {phase: values[np.isfinite(values)] for phase, values in shares.items()}
    averages = {
        phase: Spread(mean=values.mean() if len(values) else None, sd=values.std(ddof=1) if len(values) > 1 else None)
        for phase, values in known.items()
    }
    return LoadShare(left_plate=found[0], right_plate=found[1], left=averages), shares
