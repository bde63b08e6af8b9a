"""Curls of the elbow (repetitions): start, top and end of every curl, and whether it was complete."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.protocols.curl.rules import CurlRules

_NEAR = 0.02  # of the amplitude: nearer to an extreme, the elbow rests there
_FAR = 0.1  # of the amplitude: farther from an extreme, the elbow moves
_REST = 0.5  # s: a longer rest belongs to neither of the curls beside it
_ONSET = 1.2  # minimum-jerk movement (Flash and Hogan 1985): time of the first 2 % over that from 2 to 10 % of the way
_LARGE = 80.0  # percentile of the rises that stands for the trial's large curls
_NOISE = 6.0  # least rise of an attempt, in standard deviations of the angle
_RATE = 120.0  # Hz: extremes need no more samples


@dataclass(frozen=True)
class Curl:
    """One curl, or a failed attempt.

    Parameters
    ----------
    start, top, end : float
        s; ``top`` is the middle of the time at the top. NaN where the recording does not show it.
    amplitude : float
        Rise of the flexion from start to top, rad.
    complete : bool
    why : str
        Why it is not complete; empty if it is.
    """

    start: float
    top: float
    end: float
    amplitude: float
    complete: bool
    why: str = ""


def find_curls(time: FloatArray, flexion: FloatArray, sd: FloatArray, rules: CurlRules) -> tuple[Curl, ...]:
    """Find the curls of a trial in order of time.

    A curl rises from a low to a high turning point of the flexion and returns. It is complete if it rises by a given
    share of the trial's large curls and returns by as much.

    Parameters
    ----------
    time : (T,) array
        s.
    flexion, sd : (T,) arrays
        Flexion of the elbow and its standard deviation, rad; NaN where unknown.
    rules : CurlRules
    """
    known = np.flatnonzero(np.isfinite(flexion))
    if len(known) < 2:
        return ()
    step = max(1, round((len(known) - 1) / (time[known[-1]] - time[known[0]]) / _RATE))
    time, flexion = time[known[::step]], flexion[known[::step]]
    noise = float(np.nanmedian(sd)) if np.isfinite(sd).any() else 0.0
    turns = _turning_points(flexion, max(rules.attempt, _NOISE * noise))
    rises = [(low, top) for low, top in pairwise(turns) if flexion[top] > flexion[low]]
    if not rises:
        return ()
    large = float(np.percentile([flexion[top] - flexion[low] for low, top in rises], _LARGE))
    last = len(time) - 1
    found = []
    for low, top in rises:
        after = [turn for turn in turns if turn > top]
        found.append(_curl(time, flexion, (low, top, after[0] if after else last), rules.complete * large))
    return tuple(found)


def _turning_points(values: FloatArray, least: float) -> IntArray:
    """Return the indices of alternating lowest and highest values that differ by at least ``least``."""
    turns: list[int] = []
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(values):
        low, high = (k if value < values[low] else low), (k if value > values[high] else high)
        if rising is not True and value - values[low] >= least:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and values[high] - value >= least:
            turns.append(high)
            rising, low = False, k
    if rising is not None:
        turns.append(high if rising else low)
    return np.array(turns, dtype=np.int64)


def _curl(time: FloatArray, flexion: FloatArray, turns: tuple[int, int, int], required: float) -> Curl:
    low, top, back = turns
    rise, fall = float(flexion[top] - flexion[low]), float(flexion[top] - flexion[back])
    start = -_boundary(-time[: top + 1][::-1], flexion[: top + 1][::-1], top - low)
    end = _boundary(time[top:], flexion[top:], back - top)
    held = _around(-flexion, top, _NEAR * min(rise, max(fall, _NEAR * rise)))
    middle = float(time[held].mean())
    if rise < required:
        why = f"the elbow rises by {np.degrees(rise):.0f}°, expected at least {np.degrees(required):.0f}°"
    elif fall < required:
        why, end = "the recording ends before the elbow is back", float("nan")
    else:
        why = ""
    return Curl(start, middle, end, rise, not why, why)


def _boundary(time: FloatArray, flexion: FloatArray, turn: int) -> float:
    """Return when a fall from the first sample to the sample ``turn`` ends: the middle of a short rest there.

    Before a long rest it is the time at which a minimum-jerk movement would end.
    """
    fall = float(flexion[0] - flexion[turn])
    rest = _around(flexion, turn, _NEAR * fall)
    if time[rest[-1]] - time[rest[0]] <= _REST:
        return float(time[rest].mean())
    moving = np.flatnonzero(flexion[: rest[0]] >= flexion[turn] + _FAR * fall)
    return float(time[rest[0]] + _ONSET * (time[rest[0]] - time[moving[-1]]))


def _around(values: FloatArray, turn: int, near: float) -> IntArray:
    """Return the samples around a lowest value that stay within ``near`` of it."""
    away = np.flatnonzero(values > values[turn] + near)
    split = int(np.searchsorted(away, turn))
    first = away[split - 1] + 1 if split else 0
    last = away[split] if split < len(away) else len(values)
    return np.arange(first, last)
