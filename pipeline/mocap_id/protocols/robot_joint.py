"""Cycles of a robot joint that moves to and fro (thesis ch. 5)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.protocols.repetitions import Repetition

_SIDE = 0.5  # share of half the range: farther from the middle, the joint is on one of the two sides
_LEAST_ARC = np.radians(3.0)  # smallest range of a joint that moves


def find_robot_cycles(time: FloatArray, q: FloatArray) -> tuple[Repetition, ...]:
    """Find the cycles of the joint that moves most: from the middle to one side, the other side and back to the middle.

    ``time`` (T,) are the sample times, s. ``q`` (T, n) are the joint angles, rad; NaN where unknown. Of the times in
    the repetitions, only ``start`` and ``end`` are not NaN.
    """
    known = np.isfinite(q).all(axis=1)
    if known.sum() < 2:
        return ()
    low, high = np.quantile(q[known], [0.01, 0.99], axis=0)
    joint = int(np.argmax(high - low))
    if high[joint] - low[joint] < _LEAST_ARC:
        return ()
    half = (high[joint] - low[joint]) / 2
    swing = (q[known, joint] - (high[joint] + low[joint]) / 2) / half
    return _split_cycles(time[known], swing)


def _split_cycles(time: FloatArray, swing: FloatArray) -> tuple[Repetition, ...]:
    """Return the cycles of an angle ``swing`` (T,), scaled so that its range is -1 to 1."""
    side = np.where(swing > _SIDE, 1, np.where(swing < -_SIDE, -1, 0))
    visits = np.flatnonzero(side)
    turns = visits[np.concatenate([[True], np.diff(side[visits]) != 0])]  # first sample of each visit to a side
    middles = []
    for turn in turns:
        before: IntArray = np.flatnonzero(np.sign(swing[:turn]) != np.sign(swing[turn]))
        middles.append(int(before[-1]) if len(before) else 0)
    after: IntArray = np.flatnonzero(np.sign(swing[turns[-1] :]) != np.sign(swing[turns[-1]]))
    if len(after):
        middles.append(int(turns[-1] + after[0]))
    starts = middles[: len(turns) : 2]
    cycles = []
    for k, start in enumerate(starts):
        whole = 2 * k + 2 < len(middles)
        end = middles[2 * k + 2] if whole else len(time) - 1
        why = "" if whole else "the recording ends within the cycle"
        cycles.append(Repetition(float(time[start]), np.nan, np.nan, np.nan, float(time[end]), whole, why))
    return tuple(cycles)
