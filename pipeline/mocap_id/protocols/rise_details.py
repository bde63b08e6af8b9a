"""Details of a rise besides its events: greatest height, pauses, attempts, support and load share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, find_runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

NAN = float("nan")
_STILL = 0.08  # share of the peak speed of the rise; people who do not stop stay above 0.15
_PAUSE = 0.3  # s
_OFF_SEAT, _BELOW_TOP = 0.08, 0.1  # share of the rise: a pause closer to the seat or to the top is a rest


@dataclass(frozen=True)
class RiseDetails:
    """Details of a sit-to-stand or squat; NaN where not applicable or unknown.

    Parameters
    ----------
    seat_off_72, seat_off_model : float
        Seat-off by the two rules of the thesis (:mod:`mocap_id.protocols.seat_off`), s.
    reached : float
        Greatest height as a share of the trial's rise from seat to standing.
    held : float
        Time in pauses between seat and standing, s.
    attempts : int
        Number of failed attempts before this rise.
    support : float
        Unexplained vertical support (:mod:`mocap_id.protocols.support`) as a share of the standing weight.
    left_seated, left_rising, left_standing : float
        Share of the left foot in the feet's load: seated before the rise, from start to stand, standing after it.
    """

    seat_off_72: float = NAN
    seat_off_model: float = NAN
    reached: float = NAN
    held: float = NAN
    attempts: int = 0
    support: float = NAN
    left_seated: float = NAN
    left_rising: float = NAN
    left_standing: float = NAN


def greatest_height(time: FloatArray, posture: Posture, repetition: Repetition) -> float:
    """Return the greatest height of the repetition as a share of the trial's rise; NaN if unknown."""
    inside = _samples_between(time, repetition.start, repetition.end)
    height = posture.height[inside][np.isfinite(posture.height[inside])]
    return float(height.max()) if len(height) else NAN


def paused_time(time: FloatArray, posture: Posture, repetition: Repetition) -> float:
    """Return the time in pauses between seat and standing, s: below 8 % of the peak speed for at least 0.3 s."""
    rise = _samples_between(time, repetition.start, repetition.stand)
    known = rise[np.isfinite(posture.height[rise]) & np.isfinite(posture.speed[rise])]
    if np.isnan(repetition.start) or np.isnan(repetition.stand) or not len(known):
        return NAN
    height, speed = posture.height[known], posture.speed[known]
    low, high = height.min() + _OFF_SEAT, height.max() - _BELOW_TOP
    still = np.zeros(len(time), dtype=bool)
    still[known] = (height > low) & (height < high) & (speed < _STILL * speed.max())
    pauses = [float(time[run.stop - 1] - time[run.start]) for run in find_runs(still)]
    return float(sum(seconds for seconds in pauses if seconds >= _PAUSE))


def _samples_between(time: FloatArray, start: float, end: float) -> IntArray:
    """Return the indices of the samples from start to end; an unknown bound is the end of the recording."""
    start = time[0] if np.isnan(start) else start
    end = time[-1] if np.isnan(end) else end
    return np.flatnonzero((time >= start) & (time <= end)).astype(np.int64)
