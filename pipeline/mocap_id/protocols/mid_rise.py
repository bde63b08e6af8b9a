"""What a single rise is like between seat and standing: how high it goes, and where it stops on the way."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.lowpass import runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_STILL = 0.08  # of the rise's peak speed; people who do not stop are at 0.15 of it or faster all the way
_PAUSE = 0.3  # s
_OFF_SEAT, _BELOW_TOP = 0.08, 0.1  # of the rise: closer to the seat, or to the top, a pause is a rest


def reached(time: FloatArray, posture: Posture, repetition: Repetition) -> float:
    """Greatest height of the repetition, of the trial's rise from seat to standing; NaN where unknown."""
    inside = _inside(time, repetition.start, repetition.end)
    height = posture.height[inside][np.isfinite(posture.height[inside])]
    return float(height.max()) if len(height) else float("nan")


def held(time: FloatArray, posture: Posture, repetition: Repetition) -> float:
    """Time spent in pauses between seat and standing, s: slower than 8 % of the peak for 0.3 s or longer."""
    rise = _inside(time, repetition.start, repetition.stand)
    known = rise[np.isfinite(posture.height[rise]) & np.isfinite(posture.speed[rise])]
    if np.isnan(repetition.start) or np.isnan(repetition.stand) or not len(known):
        return float("nan")
    height, speed = posture.height[known], posture.speed[known]
    low, high = height.min() + _OFF_SEAT, height.max() - _BELOW_TOP
    still = np.zeros(len(time), dtype=bool)
    still[known] = (height > low) & (height < high) & (speed < _STILL * speed.max())
    lasting = [float(time[run.stop - 1] - time[run.start]) for run in runs(still)]
    return float(sum(seconds for seconds in lasting if seconds >= _PAUSE))


def _inside(time: FloatArray, begin: float, finish: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    begin = time[0] if np.isnan(begin) else begin
    finish = time[-1] if np.isnan(finish) else finish
    return np.flatnonzero((time >= begin) & (time <= finish)).astype(np.int64)
