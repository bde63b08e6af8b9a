"""Averages of angles, wrench, centre of pressure and torques over the repetitions: phases.parquet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
    resample_repetitions,
)
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_skeleton
from mocap_id.store import Table
from mocap_id.store.schemas import PHASES
from mocap_id.store.views import joint_count

SPANS = {"repetition": ("start", "end"), "rise": ("start", "stand")}
_WRENCH = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
_SOURCES = ("", "_model", "_reference")


def averages(context: Context, events: Table, dynamics: Table) -> Table:
    """Return the average of every signal over the repetitions, at 0, 1 … 100 % of each.

    Parameters
    ----------
    context : Context
        With the states, the joints' names and ``compare:``.
    events, dynamics : Table
        events.parquet and dynamics.parquet.

    Raises
    ------
    ConfigError
        A joint or column named under ``compare:`` does not exist.
    RecordingError
        Its file is unusable or does not overlap with the recording.
    """
    signals, compared = list(_signals(context.table("states.parquet"), dynamics)), []
    for name, unit, time, values, facts in _other(context):
        signals.append((name, unit, time, values))
        compared.append(facts)
    found: list[tuple[str, str, str, Averaged]] = []
    counted = {}
    for span, (begin, finish) in SPANS.items():
        bounds = events.stack([begin, finish])
        bounds = bounds[bounds[:, 1] > bounds[:, 0]]  # False where either is NaN
        counted[span] = len(bounds)
        for name, unit, time, values in signals if len(bounds) else ():
            found.append((span, name, unit, average_repetitions(resample_repetitions(time, values, bounds))))
    why = None if any(counted.values()) else "no repetition has both its beginning and its end in the recording"
    return Table(PHASES, _columns(found), {"repetitions": counted, "compared": compared, "why": why})


def _columns(found: Sequence[tuple[str, str, str, Averaged]]) -> dict[str, Any]:
    """Return the columns of phases.parquet, 101 rows for every span and quantity."""

    def joined(curves: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([np.zeros(0), *curves])

    span, quantity, unit = (np.repeat(np.array([row[k] for row in found], dtype=object), len(GRID)) for k in range(3))
    return {
        "span": span,
        "percent": np.tile(100 * GRID, len(found)),
        "quantity": quantity,
        "unit": unit,
        "mean": joined([each.mean for *_, each in found]),
        "sd": joined([each.sd for *_, each in found]),
        "count": joined([each.count for *_, each in found]),
    }


def _signals(states: Table, dynamics: Table) -> Iterator[tuple[str, str, FloatArray, FloatArray]]:
    """Yield name, unit, time (T,) and values (T,) of each averaged signal; bridged angles are NaN."""
    for joint in range(1, joint_count(states) + 1):
        yield f"theta_{joint}", "rad", states["time"], _angle(states, joint)
    wrench_time = dynamics["time"]
    for name, unit in _WRENCH.items():
        for source in _SOURCES:
            yield f"{name}{source}", unit, wrench_time, dynamics[f"{name}{source}"]
    for joint in range(1, joint_count(states) + 1):
        yield f"tau_{joint}", "N*m", wrench_time, dynamics[f"tau_{joint}"]


def _other(context: Context) -> Iterator[tuple[str, str, FloatArray, FloatArray, dict[str, Any]]]:
    """Yield the other system's angles at the times of the states, each with facts about the agreement."""
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
        values = on_times(table.time, sign * table.angles[column], time)
        found = compare_angles(_angle(states, number), values)
        yield f"theta_{number}_other", "rad", time, values, _agreement_facts(joint, given, found)


def on_times(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal (K,) interpolated at other times (T,); NaN outside its times and next to a gap."""
    gap = np.interp(at, time, np.isnan(values).astype(np.float64)) > 0
    return np.where(gap, np.nan, np.interp(at, time, values, np.nan, np.nan))


def _angle(states: Table, joint: int) -> FloatArray:
    return np.where(states[f"observed_{joint}"], states[f"theta_{joint}"], np.nan)


def _agreement_facts(joint: str, column: str, found: Agreement) -> dict[str, Any]:
    def known(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return {
        "joint": joint,
        "column": column,
        "r": known(found.r),
        "offset_rad": known(found.offset),
        "rmse_rad": known(found.rmse),
        "samples": found.samples,
        "why": None if np.isfinite(found.r) else "the records have no common time in which the joint moves",
    }
