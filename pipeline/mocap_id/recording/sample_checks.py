"""Checks of samples: times and rates, repeated or interpolated samples, and posture and facing of a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.errors import RecordingError
from mocap_id.verdict import Level, Reason

SLOWEST_HZ = 5.0
"""Lowest rate of a recording: the movement of a person contains frequencies of 2 Hz and more."""

MARKER_HZ, SKELETON_HZ, SENSOR_HZ = 2000.0, 500.0, 1e5
"""Highest rates of markers, of skeletons, and of force plates and other sensors."""

_LONGEST_PAUSE_S = 10.0
_MANY_REPEATED = 0.1  # share of rows
_UNITS = (("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9), ("minutes", 60.0), ("hours", 3600.0))

_MAX_ERROR = 0.05  # accepted error of a time stamp beyond its rounding, as a fraction of a frame
_MAX_ROUNDING = 0.25  # largest accepted rounding, as a fraction of a frame; a larger one could hide a missing frame
_MAX_DECIMALS = 9  # finer than any clock; further digits are due to the binary representation


def check_rate(source: object, rate: float, name: str, fastest: float = MARKER_HZ) -> None:
    """Raise RecordingError if a rate, Hz, is not that of a recording of a moving person; ``name`` says what has it."""
    if SLOWEST_HZ * (1 - 1e-6) <= rate <= fastest * (1 + 1e-6):
        return
    raise RecordingError(
        f"{source}: {name} is {rate:g} Hz, expected {SLOWEST_HZ:g} to {fastest:,.0f} Hz: a movement cannot be measured "
        "at this rate. Correct the rate, or record and export at a higher one"
    )


def check_times(
    source: object, time: FloatArray, name: str, fastest: float, *, repeated: bool = False, pauses: bool = False
) -> None:
    """Raise RecordingError if times (T,) do not increase, or are not the seconds of a recording of a moving person.

    The usual step between two different times must be that of a rate from ``SLOWEST_HZ`` to ``fastest``, Hz. Times in
    milliseconds, frame numbers or whole seconds are thus refused. ``name`` says what the times are in the file
    ``source``, such as ``"`time_s`"``. With ``repeated``, the same time may occur in several rows; with
    ``pauses``, the clock may jump forwards by more than ten seconds.
    """
    if len(time) < 2:
        values = f"{len(time)} value{'s' if len(time) != 1 else ''}"
        raise RecordingError(f"{source}: {name} has {values}, expected at least two times that increase")
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time))) + 1
        raise RecordingError(
            f"{source}: {name} has no number in row {row} below the header, expected times in seconds that increase "
            "from row to row; export it again"
        )
    with np.errstate(over="ignore"):
        steps = np.diff(time)
    k = int(np.argmin(steps))
    if steps[k] < 0:
        raise RecordingError(
            f"{source}: {name} does not increase from row to row: {time[k + 1]:.10g} follows {time[k]:.10g}; expected "
            "times in seconds that increase. Sort the rows by time; if the clock was set during the recording, give "
            "only the part before or after"
        )
    same = int(np.count_nonzero(steps == 0))
    if same and (not repeated or same == len(steps)):
        remedy = "remove the repeated rows"
        if same > _MANY_REPEATED * len(steps):
            remedy = (
                "they are rounded too coarsely, for example to whole seconds; export them with three decimals or more"
            )
        raise RecordingError(
            f"{source}: {name} does not increase from row to row: {same} of {len(time)} rows repeat the time of the "
            f"row before (first {time[k]:.10g}); expected times in seconds that increase: {remedy}"
        )
    step = float(np.median(steps[steps > 0]))
    if not SLOWEST_HZ * (1 - 1e-6) <= 1 / step <= fastest * (1 + 1e-6):
        found = [unit for unit, size in _UNITS if SLOWEST_HZ <= 1 / (step * size) <= fastest]
        if (steps == 1).all():
            found.insert(0, "frame numbers")
        guess = f"They may be {' or '.join(found[:2])}. " if found else ""
        if same > _MANY_REPEATED * len(steps):
            guess = "They seem to be rounded too coarsely. "
        raise RecordingError(
            f"{source}: {name} has a usual step of {step:.4g}; in seconds, this is {1 / step:.4g} Hz, but expected are "
            f"{SLOWEST_HZ:g} to {fastest:,.0f} Hz. {guess}Export the times in seconds with at least three decimals"
        )
    k = int(np.argmax(steps))
    if steps[k] > _LONGEST_PAUSE_S and not pauses:
        raise RecordingError(
            f"{source}: {name} jumps by {steps[k]:.6g} s, from {time[k]:.10g} to {time[k + 1]:.10g} s; expected steps "
            f"of at most {_LONGEST_PAUSE_S:g} s. The clock was set, or the file contains two recordings: give the part "
            "with one recording, or correct the times"
        )


def fit_even_clock(
    path: Path, time: FloatArray, stated: float | None = None, *, name: str = "the time", fastest: float = MARKER_HZ
) -> tuple[float, float, str]:
    """Fit a clock with a constant rate to time stamps (T,), s, by least squares: sample k is at ``start + k / rate``.

    Returns start, s, rate, Hz, and a note if the stamps are coarsely rounded, else an empty text. ``stated`` is the
    rate declared in the file, Hz; it is used if it agrees with all stamps. Raises RecordingError as
    :func:`check_times`, if frames are missing, or if a stamp deviates by more than 5 % of a frame beyond its rounding.
    """
    check_times(path, time, name, fastest, pauses=True)
    steps = np.diff(time)
    if steps.max() > 1.5 * np.median(steps):
        raise RecordingError(
            f"{path}: frames are missing: the time column steps by {np.median(steps):.4g} s and once by "
            f"{steps.max():.4g} s; export every frame, with missing markers blank"
        )
    number = np.arange(len(time)) - (len(time) - 1) / 2
    middle = float(time.mean())
    period = float(number @ (time - middle) / (number @ number))
    rounding = np.minimum(_estimate_rounding(time), _MAX_ROUNDING * period)
    errors = np.abs(time - middle - number * period)
    jumps = np.abs(steps - period)
    for error, allowed in ((errors, rounding), (jumps, rounding[1:] + rounding[:-1])):
        worst = int(np.argmax(error - allowed))
        if error[worst] - allowed[worst] > _MAX_ERROR * period:
            raise RecordingError(
                f"{path}: the time column is uneven: at {time[worst]:.6g} s it is off by {error[worst] / period:.2f} "
                f"of a frame at {1 / period:.6g} Hz; export the trial at a constant rate, with a row for every frame"
            )
    limit = (_MAX_ERROR * period + float(rounding.max())) / float(number[-1])
    if stated is not None and stated > 0 and abs(1 / stated - period) <= limit:
        period = 1 / stated
    rate = 1 / period if stated is None or period != 1 / stated else stated
    largest = float(errors.max()) / period  # in samples
    note = f"its times are rounded by up to {largest:.2f} of a sample: evenly spaced times were used"
    return middle + float(number[0]) * period, rate, "" if largest <= _MAX_ERROR else note


def _estimate_rounding(time: FloatArray) -> FloatArray:
    """Return the largest possible rounding error (T,) of each time stamp (T,), s, from the number of its digits.

    All stamps have the same number of decimals or of significant digits; those with the most digits determine it,
    because trailing zeros are lost.
    """
    decimals = np.full(len(time), _MAX_DECIMALS)
    for digits in range(_MAX_DECIMALS - 1, -1, -1):
        scaled = time * 10.0**digits
        decimals[np.abs(scaled - np.round(scaled)) < 1e-5 * np.maximum(1.0, 1e-7 * np.abs(scaled))] = digits
    magnitude = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-_MAX_DECIMALS))) + 1
    significant = float((magnitude + decimals).max())
    places = np.minimum(float(decimals.max()), significant - magnitude)
    return np.asarray(0.5 * 10.0**-places)


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

    ``steps`` (K, n) are the differences from the row before. If ``lines`` (K, n) are given, each run must be on a line.
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
    """Return a reason with the sensors that have such stretches between two times, s; a caution if long or many."""
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


_RISES_M = 0.15  # a smaller change of the mean height of the body is not sitting down
_SHANKS, _THIGHS = (0.15, 0.33), (0.38, 0.56)
"""Height ranges of shanks and thighs of a standing person, as fractions of the height of the highest trunk marker."""

_KNEE = 0.26  # height of the knee, also as a fraction of that height; markers on the thigh stay above it
_TRUNK_M, _PELVIS_SHARE = 1.15, 0.6
"""If no marker is higher than the first value, m, the highest markers are on the pelvis. The second value is their
height as a fraction of that of the highest trunk marker."""

_LEGS, _LEGS_THIN = (0.2, 0.55), 0.16
"""Height range of the legs and largest accepted value of their least horizontal width, as fractions of the height of
all markers. The width is 0.02 to 0.11 for a standing person and 0.21 to 0.48 for a seated person, whose thighs are
level."""

_BODY_THIN = 0.3
"""The same limit for all markers above the feet. Their width is up to 0.28 for a standing person with the arms
forwards. The limit is needed if the highest markers are on the pelvis, since the thighs of a seated person are then
at the top."""

_FLAT = 0.005  # a smaller width means markers in a line or a vertical plane, from which the posture is unknown
_SWEEPS = 8  # number of alternating fits of heights with gaps; each removes most of the remaining bias
_SURE_M = 0.02  # smallest displacement that exceeds noise and soft-tissue motion


@dataclass(frozen=True)
class Facing:
    """Facing direction of a body along a horizontal line."""

    forwards: bool  # whether the body faces the positive direction of the line
    displacement: float  # displacement along the line on which the conclusion is based, m
    rule: str  # "knees", "reach" or "none", see :func:`find_body_facing`

    @property
    def sure(self) -> bool:
        """Whether the displacement is large enough for a conclusion."""
        return abs(self.displacement) >= _SURE_M


def measure_body_height(positions: FloatArray) -> FloatArray:
    """Return the mean height of the moving markers relative to their usual heights, (F,), m; NaN if none is visible.

    Only markers are used whose height varies at least half as much as that of the most variable marker. Their usual
    heights and the result are fitted together, so that markers with gaps do not shift the result.
    """
    height = positions[:, :, 2]
    spread = np.sqrt(_average((height - _average(height)) ** 2))
    with np.errstate(invalid="ignore"):
        height = height[:, spread >= 0.5 * np.nanmax(spread, initial=0.0)]
    common = np.zeros(len(height))
    for _ in range(_SWEEPS if np.isnan(height).any() else 1):
        usual = _average(height - common[:, None])
        common = _average((height - usual).T)
    return common


def find_upright(positions: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return for each frame whether the body is upright, (F,), and whether it is low, (F,).

    If its height changes by less than 15 cm, it is upright in all frames with visible markers.
    """
    height = measure_body_height(positions)
    finite = np.isfinite(height)
    if not finite.any():
        return np.ones(len(height), bool), np.zeros(len(height), bool)
    low, high = np.percentile(height[finite], [2, 98])
    if high - low < _RISES_M:
        return finite, np.zeros(len(height), bool)
    with np.errstate(invalid="ignore"):
        return height > low + 0.85 * (high - low), height < low + 0.15 * (high - low)


def shows_standing(positions: FloatArray, samples: BoolArray) -> bool:
    """Return whether the arrangement of the markers is that of a standing person.

    The force on the plates cannot decide this, because the force under a seated person is equally steady. The upright
    legs of a standing person are thin in some horizontal direction. The level thighs of a person who sits, kneels or
    squats are broad in all directions. From markers in one plane neither can be seen. Then the person counts as
    standing only if the body rises or lowers within the recording.

    ``positions`` (F, M, 3) are in lab axes with Z up, m; NaN if not visible. ``samples`` (F,) marks frames of one
    posture.
    """
    visible = np.isfinite(positions[samples]).all(axis=2).any(axis=0)
    if not visible.any():
        return False
    middle = np.nanmedian(positions[samples][:, visible], axis=0)
    legs, body = _measure_thinness(middle, *_LEGS), _measure_thinness(middle, _LEGS[0], 1.0)
    if legs > _LEGS_THIN or body > _BODY_THIN:
        return False
    return legs > _FLAT or bool(find_upright(positions)[1].any())


def find_body_facing(positions: FloatArray, direction: FloatArray) -> Facing:
    """Determine in which direction a body faces along a horizontal line with the unit vector ``direction`` (2,).

    ``positions`` (F, M, 3) are in lab axes with Z up, m; NaN if not visible. Rule "knees": if the body changes its
    height, the hips move backwards relative to the knees. From upright to low, the markers of the shanks therefore move
    forwards relative to the markers of the thighs. Both are recognised by their height above the floor. Rule "reach":
    if limbs move and the trunk rests, the moving markers are in front of the resting markers. If no rule applies,
    ``forwards`` is False and ``displacement`` 0.
    """
    along = positions[:, :, :2] @ direction
    tall, low = find_upright(positions)
    moves = _measure_spread(positions) > max(0.25 * float(np.nanmax(_measure_spread(positions), initial=0.0)), _SURE_M)
    displacement, rule = 0.0, "none"
    if low.any() and (moves.all() or _compare_means(_average(positions[:, :, 2]), moves, ~moves) > 0):
        rule, heights = "knees", _average(positions[tall][:, :, 2])
        floor, top = float(np.nanmin(heights)), float(np.nanmax(heights))
        trunk = top - floor if top - floor > _TRUNK_M else (top - floor) / _PELVIS_SHARE
        share = (heights - floor) / trunk
        shift = _average(along[low]) - _average(along[tall])
        drop = heights - _average(positions[low][:, :, 2])
        with np.errstate(invalid="ignore"):
            shanks = (share > _SHANKS[0]) & (share < _SHANKS[1]) & np.isfinite(shift)
            thighs = (share > _THIGHS[0]) & (share < _THIGHS[1]) & np.isfinite(shift)
            if shanks.any() and thighs.any():
                knee_drop = max(float(np.median(drop[shanks] / share[shanks])) * _KNEE, 0.0)  # the shank leans
                # without the hands, which move farther
                thighs &= (drop > 0) & (drop < knee_drop + (share - _KNEE) * trunk)
        if shanks.any() and thighs.any():
            displacement = float(np.median(shift[shanks]) - np.median(shift[thighs]))
    elif moves.any() and not moves.all():
        displacement, rule = _compare_means(_average(along), moves, ~moves), "reach"
    return Facing(displacement > 0, displacement, rule)


def _measure_thinness(points: FloatArray, low: float, high: float) -> float:
    """Return the least horizontal width of the points (M, 3) between two heights, all relative to the total height."""
    height = float(np.ptp(points[:, 2]))
    share = (points[:, 2] - points[:, 2].min()) / max(height, 1e-9)
    inside = points[(share >= low) & (share <= high), :2]
    if len(inside) < 2:
        return 0.0
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    return float(np.ptp(inside @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).min()) / height


def _average(values: FloatArray) -> FloatArray:
    """Return the mean (M,) of the finite values in each column (F, M); NaN if there are none."""
    finite = np.isfinite(values)
    counts = finite.sum(axis=0)
    return np.asarray(np.where(counts > 0, np.where(finite, values, 0.0).sum(axis=0), np.nan) / np.maximum(counts, 1))


def _measure_spread(positions: FloatArray) -> FloatArray:
    """Return the rms distance (M,) of each marker from its mean position, m; 0 if it is never visible."""
    away = positions - np.stack([_average(positions[:, :, axis]) for axis in range(3)], axis=1)
    return np.sqrt(np.nan_to_num(_average(np.sum(away**2, axis=2))))


def _compare_means(values: FloatArray, these: BoolArray, others: BoolArray) -> float:
    """Return the mean of the values ``these`` minus the mean of the values ``others``; 0 if one has no finite value."""
    both = [values[group & np.isfinite(values)] for group in (these, others)]
    return float(both[0].mean() - both[1].mean()) if all(group.size for group in both) else 0.0
