"""Curls of the elbow: start, top and end of every curl, rules of their analysis, and trends as signs of fatigue."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs

_NEAR = 0.02  # share of the amplitude: if the flexion is nearer to a turning point, the elbow rests
_FAR = 0.1  # share of the amplitude: if the flexion is farther from a turning point, the elbow moves
_BESIDE = 0.1  # s: within this time of an event at the end of a long rest, the flexion must be measured
_REST = 0.5  # s: a longer rest does not belong to a curl
_ONSET = 1.2  # in a minimum-jerk movement (Flash and Hogan 1985), the ratio of the times for 0 to 2 % and 2 to 10 %
_LARGE = 80.0  # percentile of the rises that represents the large curls of the trial
_NOISE = 6.0  # smallest rise of an attempt, in standard deviations of the angle
_FEWEST = 4  # smallest number of curls with a known value for a trend
_RATE = 120.0  # Hz: enough samples for the turning points


@dataclass(frozen=True)
class CurlRules:
    """Rules for curls, compensation and the end of the trial."""

    metronome: float | None = None  # tempo of the metronome, curls per second; None if no tempo is required
    attempt: float = 0.26  # smallest rise of the elbow's flexion that counts as an attempt, rad
    complete: float = 0.6  # smallest rise of a complete curl as a share of the large curls of the trial
    # largest difference of a curl's duration from the period of the metronome, as a share of the period
    tempo: float = 0.5
    pause: float = 2.0  # longest pause between two curls, in periods; after a longer pause, the person has stopped
    plane: float = 0.35  # largest rotation of the elbow's axis from its direction in the first curl, rad
    compensation: float = 0.17  # smallest change of an angle of shoulder or thorax that counts as compensation, rad
    sustained: float = 0.25  # shortest duration of a compensation and of motion out of the plane, s


@dataclass(frozen=True)
class Curl:
    """A curl or a failed attempt."""

    # Start, top, end: times of start, top (middle of the time at the top) and end, s. ``end`` is NaN if it is not
    # recorded.
    start: float
    top: float
    end: float
    amplitude: float  # rise of the flexion from start to top, rad
    complete: bool  # whether the curl rises and returns far enough
    why: str = ""  # reason why the curl is not complete, or why an event is unknown; otherwise empty
    unknown: bool = False  # whether it is unknown if the curl is complete, because the arm is not measured there

    @property
    def timed(self) -> bool:
        """Whether the curl is complete, and its start and end are known."""
        return self.complete and bool(np.isfinite(self.end - self.start))


def find_curls(
    time: FloatArray, flexion: FloatArray, sd: FloatArray, rules: CurlRules, measured: BoolArray | None = None
) -> tuple[Curl, ...]:
    """Find the curls of a trial, in order of time.

    In a curl, the flexion rises from a low to a high turning point and returns. The curl is complete if both the rise
    and the return are at least ``rules.complete`` times the rise in the large curls of the trial. An event, and the
    amplitude to it, are NaN if it may lie where the flexion is not measured.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    flexion, sd : (T,) arrays
        Flexion of the elbow and its standard deviation, rad; NaN where unknown.
    measured : (T,) bool array, optional
        Samples in which the flexion is measured; by default, those in which it is known.
    """
    gaps = find_runs(~np.isfinite(flexion) if measured is None else ~(measured & np.isfinite(flexion)))
    holes = np.array([(time[gap.start], time[gap.stop - 1]) for gap in gaps]).reshape(-1, 2)
    known = np.flatnonzero(np.isfinite(flexion))
    if len(known) < 2:
        return ()
    step = max(1, round((len(known) - 1) / (time[known[-1]] - time[known[0]]) / _RATE))
    time, flexion = time[known[::step]], flexion[known[::step]]
    noise = float(np.nanmedian(sd)) if np.isfinite(sd).any() else 0.0
    turns = _find_turning_points(flexion, max(rules.attempt, _NOISE * noise))
    rises = [(low, top) for low, top in pairwise(turns) if flexion[top] > flexion[low]]
    if not rises:
        return ()
    large = float(np.percentile([flexion[top] - flexion[low] for low, top in rises], _LARGE))
    last = len(time) - 1
    curls = []
    for low, top in rises:
        after = [turn for turn in turns if turn > top]
        turn = (low, top, after[0] if after else last)
        curls.append(_describe_curl(time, flexion, turn, rules.complete * large, holes))
    return tuple(curls)


def _find_turning_points(values: FloatArray, least: float) -> IntArray:
    """Return the indices of alternating minima and maxima of a signal that differ by at least ``least``."""
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


def _describe_curl(
    time: FloatArray, flexion: FloatArray, turns: tuple[int, int, int], required: float, holes: FloatArray
) -> Curl:
    """Return the curl between three turning points; it is complete if it rises and returns by ``required``, rad.

    ``holes`` (H, 2) are the first and last times without a measured flexion, s.
    """
    low, top, back = turns
    rise, fall = float(flexion[top] - flexion[low]), float(flexion[top] - flexion[back])
    start = -_find_end_of_fall(-time[: top + 1][::-1], flexion[: top + 1][::-1], top - low)
    end = _find_end_of_fall(time[top:], flexion[top:], back - top)
    at_top = _find_samples_near(-flexion, top, _NEAR * min(rise, max(fall, _NEAR * rise)))
    middle = float(time[at_top].mean())
    if rise < required:
        why = f"the elbow rises by {np.degrees(rise):.0f}°, expected at least {np.degrees(required):.0f}°"
    elif fall < required:
        why, end = "the recording ends before the elbow is back", float("nan")
    else:
        why = ""
    hidden = {}
    ends = (("start", low, flexion, start), ("top", top, -flexion, middle), ("end", back, flexion, end))
    for name, turn, value, at in ends:
        rest = _find_samples_near(value, turn, _NEAR * min(rise, max(fall, _NEAR * rise)))
        first, after = time[max(rest[0] - 1, 0)], time[min(rest[-1] + 1, len(time) - 1)]
        if name != "top" and after - first > _REST:  # only the end of a long rest matters
            first, after = max(first, at - _BESIDE), min(after, at + _BESIDE)
        inside = holes[(holes[:, 1] >= first) & (holes[:, 0] <= after)]
        if len(inside) and not (name == "end" and np.isnan(end)):
            hidden[name] = f"the arm is not measured at its {name} ({inside[0, 0]:.2f}–{inside[-1, 1]:.2f} s)"
    start, middle, end = (
        float("nan") if name in hidden else at for name, at in (("start", start), ("top", middle), ("end", end))
    )
    amplitude = float("nan") if {"start", "top"} & set(hidden) else rise
    return Curl(start, middle, end, amplitude, not why, "; ".join(hidden.values()) or why, bool(why and hidden))


def _find_end_of_fall(time: FloatArray, flexion: FloatArray, turn: int) -> float:
    """Return the end, s, of a fall of the flexion that begins at the first sample and is lowest at the sample ``turn``.

    The end is in the middle of a short rest. Before a long rest, it is the end of a minimum-jerk movement.
    """
    fall = float(flexion[0] - flexion[turn])
    rest = _find_samples_near(flexion, turn, _NEAR * fall)
    if time[rest[-1]] - time[rest[0]] <= _REST:
        return float(time[rest].mean())
    moving = np.flatnonzero(flexion[: rest[0]] >= flexion[turn] + _FAR * fall)
    return float(time[rest[0]] + _ONSET * (time[rest[0]] - time[moving[-1]]))


def _find_samples_near(values: FloatArray, turn: int, near: float) -> IntArray:
    """Return the indices of the run of samples around ``turn`` with values at most ``near`` above the value there."""
    away = np.flatnonzero(values > values[turn] + near)
    split = int(np.searchsorted(away, turn))
    first = away[split - 1] + 1 if split else 0
    last = away[split] if split < len(away) else len(values)
    return np.arange(first, last)


@dataclass(frozen=True)
class Trend:
    """Linear trend of a quantity over the curls."""

    slope: float  # change from one curl to the next, in the unit of the quantity
    interval: tuple[float, float]  # 95 % interval of the slope by Student's t
    count: int  # number of curls with a known value


def fit_trend(values: FloatArray) -> Trend | None:
    """Fit the linear trend of a quantity (n,) over n curls by least squares; None with fewer than four known values.

    Examples
    --------
    >>> fit_trend(np.array([1.0, 2.0, 3.0, 4.0])).slope
    1.0
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < _FEWEST:
        return None
    number = known - known.mean()
    slope = float(number @ values[known] / (number @ number))
    rest = values[known] - values[known].mean() - slope * number
    free = len(known) - 2
    half = float(stdtrit(free, 0.975) * np.sqrt(rest @ rest / free / (number @ number)))
    return Trend(slope, (slope - half, slope + half), len(known))
