"""Clocks of recordings: the one rule on times and rates of every reader, and the fit of an even clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

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
    """Raise RecordingError if a rate, Hz, is not that of a recording of a moving person.

    ``source`` is the file, ``name`` says what has this rate, and ``fastest`` is the highest rate of such a signal, Hz.
    """
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
    milliseconds, frame numbers or whole seconds are thus refused. ``source`` is the file and ``name`` says what the
    times are in it, such as ``"`time_s`"``. With ``repeated``, the same time may occur in several rows; with
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


@dataclass(frozen=True)
class EvenClock:
    """Clock with a constant rate: sample k is at ``start + k / rate``."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    rounding_note: str  # note that the time stamps are coarsely rounded; empty if they are not

    def times(self, count: int) -> FloatArray:
        """Return the times of the first ``count`` samples, s."""
        return np.round(self.start + np.arange(count) / self.rate, 12) + 0.0  # a start of 1e-16 becomes 0, not -0


def fit_even_clock(
    path: Path, time: FloatArray, stated: float | None = None, *, name: str = "the time", fastest: float = MARKER_HZ
) -> EvenClock:
    """Fit a clock with a constant rate to time stamps (T,), s, by least squares.

    ``stated`` is the rate declared in the file, Hz; it is used if it agrees with all stamps. ``name`` and ``fastest``
    are as for :func:`check_times`. Raises RecordingError as this function does, if frames are missing, or if a stamp
    deviates by more than 5 % of a frame beyond its rounding.
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
    return EvenClock(middle + float(number[0]) * period, rate, "" if largest <= _MAX_ERROR else note)


def _estimate_rounding(time: FloatArray) -> FloatArray:
    """Return the largest possible rounding error (T,) of each time stamp (T,), s, from the number of its digits.

    All stamps have the same number of decimals or the same number of significant digits. Because trailing zeros are
    lost, the stamps with the most digits determine this number.
    """
    decimals = np.full(len(time), _MAX_DECIMALS)
    for digits in range(_MAX_DECIMALS - 1, -1, -1):
        scaled = time * 10.0**digits
        decimals[np.abs(scaled - np.round(scaled)) < 1e-5 * np.maximum(1.0, 1e-7 * np.abs(scaled))] = digits
    magnitude = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-_MAX_DECIMALS))) + 1
    significant = float((magnitude + decimals).max())
    places = np.minimum(float(decimals.max()), significant - magnitude)
    return np.asarray(0.5 * 10.0**-places)
