"""Samples that no sensor measured: repeated values (held) and straight lines between two values (filled gaps).

A sensor has noise, so it never repeats a sample of all its channels several times, and its samples are never on a
straight line. Software that lost samples writes such stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.verdict import Level, Reason

_LEAST_ROWS, _LEAST_S = 5, 0.05  # shortest stretch
_AROUND = 200  # rows before and after a stretch, with which it is compared
_NEAR, _FEWEST = 60, 20  # nearest rows on each side, whose noise is examined, and least number of them
_CHANCE = 25.0  # least negative logarithm of the probability that a stretch occurs by chance
_TO_AND_FRO = 0.2  # least negative correlation of successive steps; it is 0.5 for white noise
_ROUGH = 1.2  # least ratio of third to second differences of noise; it is 1.8 for white noise
_ABOVE_ROUNDING = 2.0  # least noise, relative to the rounding step
_KINK = 5.0  # least bend at an end of the stretch, relative to the usual bend, in a track without noise
_MOST = 0.7  # fraction of a track; if more is like this, it is how the sensor or the software works
_LONG_S, _MANY = 0.3, 0.02  # longest stretch and largest fraction of a sensor's samples for a note
_LISTED = 4
_OFF_LINE = 1.1  # largest distance from a line, relative to the rounding step
_SINGLE = 2.0**-23  # relative rounding of a file in single precision


@dataclass(frozen=True)
class HeldSamples:
    """Stretches of a sensor that were repeated or filled with straight lines, and are left out."""

    sensor: str  # such as "marker RKNE" or "plate 1"
    how: Literal["repeated", "on straight lines"]
    stretches: tuple[tuple[float, float], ...]  # first and last time of each, s
    count: int  # number of these samples
    share: float  # the same as a fraction of the sensor's samples

    def __str__(self) -> str:
        listed = ", ".join(f"{first:.2f} to {last:.2f} s" for first, last in self.stretches[:_LISTED])
        rest = f" and {len(self.stretches) - _LISTED} more stretches" if len(self.stretches) > _LISTED else ""
        return f"{self.count} samples of {self.sensor} are {self.how} ({listed}{rest})"


def find_held(values: FloatArray, rate: float) -> tuple[BoolArray, BoolArray]:
    """Return which rows (K,) of a sensor's channels (K, n) repeat the row before, and which are on a straight line.

    Only stretches that cannot have been measured are returned: they are much longer than chance allows in the rows
    around them, and these rows have noise, or the stretch begins or ends with a kink. None is returned where the values
    are rounded so coarsely that the sensor itself repeats them, or where most of the track is like this. Rows are NaN
    where missing; ``rate`` is in rows per second.
    """
    none = np.zeros(len(values), dtype=np.bool_)
    values = values[:, np.isfinite(values).any(axis=0)]
    if len(values) < 2 * _LEAST_ROWS or not values.shape[1]:
        return none, none
    steps = np.diff(values, axis=0)
    size = np.abs(steps)
    moving = np.nanmax(size, axis=0, initial=0.0) > 0.0
    if not moving.any():
        return none, none
    values, steps, size = values[:, moving], steps[:, moving], size[:, moving]
    rounding = np.nanmin(np.where(size > 0.0, size, np.inf), axis=0)
    rounding = np.maximum(rounding, _SINGLE * np.nanmax(np.abs(values), axis=0))
    steps = np.concatenate([np.full((1, values.shape[1]), np.nan), steps])  # each row minus the row before
    bends = np.diff(steps[1:], axis=0)
    same, straight = none.copy(), none.copy()
    same[1:] = np.all(steps[1:] == 0.0, axis=1)
    with np.errstate(invalid="ignore"):
        straight[1:-1] = np.all(np.abs(bends) <= 2.1 * rounding, axis=1)
    least = max(_LEAST_ROWS, int(np.ceil(_LEAST_S * rate)))
    held = _keep_impossible(same, least, steps, rounding)
    straight = _keep_impossible(straight & ~held, least, steps, rounding, values)
    if (held | straight).sum() > _MOST * np.isfinite(values).all(axis=1).sum():
        return none, none
    return held, straight


def _keep_impossible(
    alike: BoolArray, least: int, steps: FloatArray, rounding: FloatArray, lines: FloatArray | None = None
) -> BoolArray:
    """Return which rows (K,) are in runs of ``least`` or more rows ``alike`` that no sensor can have measured.

    ``steps`` (K, n) are the differences from the row before, and ``rounding`` (n,) is the smallest difference. If the
    values ``lines`` (K, n) are given, each run must be on a line.
    """
    bends = np.full(steps.shape, np.nan)
    bends[:-1] = np.diff(steps, axis=0)
    outside = np.flatnonzero(np.isfinite(bends).all(axis=1) & ~alike)
    followed = np.append(alike[1:], False)[outside]  # a chance run begins as often as a chance row follows another
    found = np.zeros_like(alike)
    for run in find_runs(alike):
        if run.stop - run.start < least:
            continue
        first = int(np.searchsorted(outside, run.start))
        before, after = slice(max(first - _AROUND, 0), first), slice(first, first + _AROUND)
        sides = [outside[before][-_NEAR:], outside[after][:_NEAR]]
        sides = [rows for rows in sides if len(rows) >= _FEWEST]
        if not sides:
            continue
        around = outside[before.start : after.stop]
        begins = followed[before.start : after.stop].sum() - (first > 0 and followed[first - 1])
        if -(run.stop - run.start) * np.log((begins + 1.0) / (len(around) + 2.0)) < _CHANCE:
            continue
        usual = np.maximum(np.median(np.abs(bends[around]), axis=0), rounding)
        ends = [row for row in (run.start - 2, run.start - 1, run.stop - 1, run.stop) if 0 <= row < len(bends)]
        kink = np.nan_to_num(np.abs(bends[ends]) / usual).max()
        noise = min(_measure_noise(rows, steps, bends, rounding) for rows in sides)
        found[run] = kink > _KINK or noise > 0.0
        if lines is not None and found[run.start]:
            found[run] = _is_rounded_line(lines[run.start - 1 : run.stop + 1], rounding, noise < _ABOVE_ROUNDING)
    return found


def _is_rounded_line(values: FloatArray, rounding: FloatArray, rises: bool) -> bool:
    """Return whether rows (k, n) are the rounded values of a line.

    If ``rises``, some channel must change by a rounding step or more for each row: without much noise, a marker that
    stands still or moves slowly also has a straight track if its coordinates have coarse steps. The first and the last
    row may belong to the measured samples.
    """
    for first, stop in ((0, len(values)), (1, len(values)), (0, len(values) - 1), (1, len(values) - 1)):
        some = values[first:stop]
        share = np.linspace(0.0, 1.0, len(some))[:, None]
        off = np.abs(some - (some[0] * (1 - share) + some[-1] * share))
        steep = np.max(np.abs(some[-1] - some[0]) / rounding) >= len(some) - 1
        if (steep or not rises) and bool(np.all(off <= _OFF_LINE * rounding)):
            return True
    return False


def _measure_noise(rows: IntArray, steps: FloatArray, bends: FloatArray, rounding: FloatArray) -> float:
    """Return the largest noise of a channel in these rows, relative to its rounding; 0 if no channel shows noise.

    Noise makes successive steps go to and fro, which the rounding of a smooth motion never does. During a fast motion,
    noise that is larger than the rounding makes the third differences larger than the second differences.
    """
    pairs = rows[:-1][np.diff(rows) == 1]
    if len(pairs) < _FEWEST // 2:
        return 0.0
    first, second = steps[pairs], steps[pairs + 1]
    forth = np.sum(first * second, axis=0) < -_TO_AND_FRO * np.sum(first**2, axis=0)
    third = np.median(np.abs(bends[pairs + 1] - bends[pairs]), axis=0)
    rough = third > _ROUGH * np.median(np.abs(bends[rows]), axis=0)
    size = third / (0.6745 * np.sqrt(20.0) * rounding)
    return float(np.max(np.where(forth | (rough & (size > _ABOVE_ROUNDING)), size, 0.0)))


def list_held(sensor: str, time: FloatArray, held: BoolArray, straight: BoolArray) -> tuple[HeldSamples, ...]:
    """Return the stretches of a sensor at the times (K,), s, from the results of :func:`find_held`."""
    kinds: tuple[tuple[Literal["repeated", "on straight lines"], BoolArray], ...]
    kinds = (("repeated", held), ("on straight lines", straight))
    return tuple(
        HeldSamples(
            sensor,
            how,
            tuple((float(time[run.start]), float(time[run.stop - 1])) for run in find_runs(rows)),
            int(rows.sum()),
            float(rows.mean()),
        )
        for how, rows in kinds
        if rows.any()
    )


def describe_held(found: Sequence[HeldSamples], start: float = -np.inf, end: float = np.inf) -> tuple[Reason, ...]:
    """Return a reason with the sensors that have such stretches between two times, s.

    It is a caution if a stretch is long, or if a sensor has many such samples.
    """
    found = [each for each in found if any(first <= end and last >= start for first, last in each.stretches)]
    if not found:
        return ()
    longest = max(last - first for each in found for first, last in each.stretches)
    share = max(each.share for each in found)
    listed = "; ".join(str(each) for each in found[:_LISTED])
    rest = f"; and more of {len(found) - _LISTED} other sensors" if len(found) > _LISTED else ""
    message = (
        f"{listed}{rest}. No sensor measures such values: software repeated them or filled a gap. They are left out "
        "as missing. Export the recording without filled gaps, and look for lost data at these times"
    )
    level: Level = "caution" if longest > _LONG_S or share > _MANY else "ok"
    return (Reason("samples-held", message, longest, _LONG_S, level),)
