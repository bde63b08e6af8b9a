"""Cycles of a swinging robot joint (thesis ch. 5)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.protocols.repetitions import Repetition

_SIDE = 0.5  # share of the half range; farther from the middle counts as one side
_LEAST_ARC = np.radians(3.0)


def robot_repetitions(time: FloatArray, q: FloatArray) -> tuple[Repetition, ...]:
    """Find the cycles of the joint that moves most: from the middle to one side, to the other and back.

    Parameters
    ----------
    time : (T,) array
        s.
    q : (T, n) array
        Joint angles, rad; NaN where unknown.

    Returns
    -------
    tuple of Repetition
        Seat events and ``stand`` are NaN.
    """
    known = np.isfinite(q).all(axis=1)
    if known.sum() < 2:
        return ()
    low, high = np.quantile(q[known], [0.01, 0.99], axis=0)
    joint = int(np.argmax(high - low))
    if high[joint] - low[joint] < _LEAST_ARC:
        return ()
    half = (high[joint] - low[joint]) / 2
    swing = (q[known, joint] - (high[joint] + low[joint]) / 2) / half  # -1 … 1
    return _cycles(time[known], swing)


def _cycles(time: FloatArray, swing: FloatArray) -> tuple[Repetition, ...]:
    side = np.where(swing > _SIDE, 1, np.where(swing < -_SIDE, -1, 0))
    visits = np.flatnonzero(side)
    turns = visits[np.concatenate([[True], np.diff(side[visits]) != 0])]  # first sample of each visit to a side
    middles = [_crossing_before(swing, int(turn)) for turn in turns]
    after = _crossing_after(swing, int(turns[-1]))
    if after is not None:
        middles.append(after)
    starts = middles[: len(turns) : 2]
    cycles = []
    for k, start in enumerate(starts):
        whole = 2 * k + 2 < len(middles)
        end = middles[2 * k + 2] if whole else len(time) - 1
        why = "" if whole else "the recording ends within the cycle"
        cycles.append(Repetition(float(time[start]), np.nan, np.nan, np.nan, float(time[end]), whole, why))
    return tuple(cycles)


def _crossing_before(swing: FloatArray, index: int) -> int:
    """Return the last sample before ``index`` with a zero swing or one of the other sign; 0 if there is none."""
    before: IntArray = np.flatnonzero(np.sign(swing[:index]) != np.sign(swing[index]))
    return int(before[-1]) if len(before) else 0


def _crossing_after(swing: FloatArray, index: int) -> int | None:
    after: IntArray = np.flatnonzero(np.sign(swing[index:]) != np.sign(swing[index]))
    return index + int(after[0]) if len(after) else None
