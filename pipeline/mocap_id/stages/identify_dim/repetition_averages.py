"""Averages of angles, wrench, centre of pressure and torques over the repetitions: phases.parquet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.protocols.phases import (
    GRID,
    Agreement,
    Averaged,
    average_repetitions,
    compare_angles,
    interpolate_at,
    resample_repetitions,
)
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_skeleton
from mocap_id.store import Table
from mocap_id.store.schemas import PHASES
from mocap_id.store.views import joint_count
from mocap_id.verdict import Reason

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

    ``zeros`` and ``reasons`` are the results of :func:`mocap_id.stages.identify_dim.joint_zeros.find_zeros`.

    Raises
    ------
    ConfigError
        A joint or column under ``compare:`` does not exist.
    RecordingError
        The file under ``compare:`` cannot be used or does not overlap with the recording.
    """
    signals, compared = list(_list_signals(context.table("states.parquet"), dynamics, zeros)), []
    for name, unit, time, values, facts in _read_other_system(context):
        signals.append((name, unit, time, values))
        compared.append(facts)
    averages: list[tuple[str, str, str, Averaged]] = []
    counts = {}
    for span, (begin, finish) in SPANS.items():
        bounds = events.stack([begin, finish])
        bounds = bounds[bounds[:, 1] > bounds[:, 0]]  # False where either is NaN
        counts[span] = len(bounds)
        for name, unit, time, values in signals if len(bounds) else ():
            averages.append((span, name, unit, average_repetitions(resample_repetitions(time, values, bounds))))
    why = None if any(counts.values()) else "no repetition has both its beginning and its end in the recording"
    facts = {"repetitions": counts, "compared": compared, "why": why, "zeros": list(zeros)}
    return Table(PHASES, _make_columns(averages), facts, reasons)


def _make_columns(averages: Sequence[tuple[str, str, str, Averaged]]) -> dict[str, Any]:
    """Return the columns of phases.parquet, with 101 rows for each pair of span and quantity."""
    columns: dict[str, Any] = {"percent": np.tile(100 * GRID, len(averages))}
    for k, name in enumerate(("span", "quantity", "unit")):
        columns[name] = np.repeat(np.array([row[k] for row in averages], dtype=object), len(GRID))
    for name in ("mean", "sd", "count"):
        columns[name] = np.concatenate([np.zeros(0), *(getattr(each, name) for *_, each in averages)])
    return columns


def _list_signals(
    states: Table, dynamics: Table, zeros: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, str, FloatArray, FloatArray]]:
    """Yield name, unit, times (T,), s, and values (T,) of each signal; joint angles are NaN where not observed."""
    for joint in range(1, joint_count(states) + 1):
        yield f"theta_{joint}", "rad", states["time"], _get_angle(states, joint)
    wrench_time = dynamics["time"]
    for name, unit in _WRENCH.items():
        for source in _SOURCES:
            yield f"{name}{source}", unit, wrench_time, dynamics[f"{name}{source}"]
    for joint in range(1, joint_count(states) + 1):
        yield f"tau_{joint}", "N*m", wrench_time, dynamics[f"tau_{joint}"]
    for joint, zero in enumerate(zeros, start=1):
        yield f"angle_{joint}", "rad", states["time"], _get_angle(states, joint) - zero["zero"]


def _read_other_system(context: Context) -> Iterator[tuple[str, str, FloatArray, FloatArray, dict[str, Any]]]:
    """Yield name, unit, times, values and agreement of each angle of the other system, at the times of the states."""
    compare = context.trial.compare
    if compare is None:
        return
    states, joints = context.table("states.parquet"), read_skeleton(context).joints
    table = recording.read_angles(compare.angles, {name.removeprefix("-") for name in compare.columns.values()})
    time = states["time"]
    for joint, given in compare.columns.items():
        if joint not in joints:
            raise ConfigError(
                f"compare: columns: there is no joint {joint!r} here; expected one of {', '.join(joints)}"
            )
        column, sign = given.removeprefix("-"), -1.0 if given.startswith("-") else 1.0
        number = joints.index(joint) + 1
        values = interpolate_at(table.time, sign * table.angles[column], time)
        agreement = compare_angles(_get_angle(states, number), values)
        yield f"theta_{number}_other", "rad", time, values, _describe_agreement(joint, given, agreement)


def _get_angle(states: Table, joint: int) -> FloatArray:
    return np.where(states[f"observed_{joint}"], states[f"theta_{joint}"], np.nan)


def _describe_agreement(joint: str, column: str, agreement: Agreement) -> dict[str, Any]:
    known = bool(np.isfinite(agreement.r))
    return {
        "joint": joint,
        "column": column,
        "r": agreement.r if known else None,
        "offset_rad": agreement.offset if known else None,
        "rmse_rad": agreement.rmse if known else None,
        "samples": agreement.samples,
        "why": None if known else "the two systems have no common time in which the joint moves",
    }
