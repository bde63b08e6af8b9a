"""Fit of a clock with a constant rate to rounded time stamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

_MIN_PERIOD_S = 1e-9
_MAX_ERROR = 0.05  # accepted error of a stamp beyond its rounding, as a share of a frame
_MAX_ROUNDING = 0.25  # largest accepted rounding, as a share of a frame; a larger one could hide a missing frame
_MAX_DECIMALS = 9  # finer than any clock; further digits are due to the binary representation


@dataclass(frozen=True)
class EvenClock:
    """Clock with a constant rate: sample k is at ``start + k / rate``."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    largest_error: float  # largest error of a time stamp, in samples

    def times(self, count: int) -> FloatArray:
        """Return the times of the first ``count`` samples, s."""
        return np.round(self.start + np.arange(count) / self.rate, 12) + 0.0  # a start of 1e-16 becomes 0, not -0

    @property
    def rounding_note(self) -> str:
        """Sentence that says that the stamps are coarsely rounded; empty if they are not."""
        if self.largest_error <= _MAX_ERROR:
            return ""
        return f"its times are rounded by up to {self.largest_error:.2f} of a sample: even times were used instead"


def fit_even_clock(path: Path, time: FloatArray, stated: float | None = None) -> EvenClock:
    """Fit a clock with a constant rate to increasing time stamps (T,), s, by least squares.

    The rate declared in the file, ``stated``, Hz, is used if it agrees with all stamps. Raises RecordingError if frames
    are missing, or if a stamp deviates by more than 5 % of a frame beyond its rounding.
    """
    steps = np.diff(time)
    if steps.max() > 1.5 * np.median(steps):
        raise RecordingError(
            f"{path}: frames are missing: the time column steps by {np.median(steps):.4g} s and once by "
            f"{steps.max():.4g} s; export every frame, with missing markers blank"
        )
    number = np.arange(len(time)) - (len(time) - 1) / 2
    middle = float(time.mean())
    period = float(number @ (time - middle) / (number @ number))
    if not _MIN_PERIOD_S < period < 1 / _MIN_PERIOD_S:
        raise RecordingError(
            f"{path}: the time column steps by {period:.4g} s, which is not plausible; is it in seconds?"
        )
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
    return EvenClock(middle + float(number[0]) * period, rate, float(errors.max()) / period)


def _estimate_rounding(time: FloatArray) -> FloatArray:
    """Return the largest rounding error (T,) of each stamp, from its number of digits, s.

    Stamps have a fixed number of decimals or of significant digits. As numbers have no trailing zeros, the longest
    stamps determine which.
    """
    decimals = np.full(len(time), _MAX_DECIMALS)
    for digits in range(_MAX_DECIMALS - 1, -1, -1):
        scaled = time * 10.0**digits
        decimals[np.abs(scaled - np.round(scaled)) < 1e-5 * np.maximum(1.0, 1e-7 * np.abs(scaled))] = digits
    magnitude = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-_MAX_DECIMALS))) + 1
    significant = float((magnitude + decimals).max())
    places = np.minimum(float(decimals.max()), significant - magnitude)
    return np.asarray(0.5 * 10.0**-places)
