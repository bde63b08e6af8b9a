"""Printed time stamps → an even clock, or a refusal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

_SHORTEST_S = 1e-9
_UNEVEN = 0.05
"""Share of a frame by which a stamp may stray, beyond its rounding."""

_COARSEST = 0.25
"""Share of a frame that rounding may explain: beyond, a frame that is left out would pass for it."""

_MOST_DECIMALS = 9
"""Finer than any clock; what is left beyond is the binary representation of decimals."""


@dataclass(frozen=True)
class Clock:
    """An even clock: sample k at ``start + k / rate``.

    Parameters
    ----------
    start : float
        s.
    rate : float
        Samples per second.
    astray : float
        Largest distance of a printed stamp from it, in samples.
    """

    start: float
    rate: float
    astray: float

    def times(self, count: int) -> FloatArray:
        """(count,) s."""
        return np.round(self.start + np.arange(count) / self.rate, 12) + 0.0  # a start of 1e-16 is 0, and not -0

    @property
    def coarse(self) -> str:
        """A sentence where only rounding excuses how far the stamps stray; empty otherwise."""
        if self.astray <= _UNEVEN:
            return ""
        return f"its times are rounded by up to {self.astray:.2f} of a sample: even ones were taken in their place"


def even_clock(path: Path, time: FloatArray, stated: float | None = None) -> Clock:
    """The even clock behind increasing time stamps, by least squares.

    Parameters
    ----------
    time : (T,) array
        As printed, s.
    stated : float, optional
        Samples per second as the file declares them, taken where the stamps agree to the last one.

    Raises
    ------
    RecordingError
        Frames are left out, or stamps stray from even ones by more than 5 % of a frame beyond their rounding.
    """
    steps = np.diff(time)
    if steps.max() > 1.5 * np.median(steps):
        raise RecordingError(
            f"{path}: frames are left out: the time column steps by {np.median(steps):.4g} s and once by "
            f"{steps.max():.4g} s; export every frame, with missing markers blank"
        )
    number = np.arange(len(time)) - (len(time) - 1) / 2
    middle = float(time.mean())
    period = float(number @ (time - middle) / (number @ number))
    if not _SHORTEST_S < period < 1 / _SHORTEST_S:
        raise RecordingError(f"{path}: the time column steps by {period:.4g} s, which no recording does; in seconds?")
    rounding = np.minimum(_rounding(time), _COARSEST * period)
    astray = np.abs(time - middle - number * period)
    jumps = np.abs(steps - period)
    for found, excused in ((astray, rounding), (jumps, rounding[1:] + rounding[:-1])):
        worst = int(np.argmax(found - excused))
        if found[worst] - excused[worst] > _UNEVEN * period:
            raise RecordingError(
                f"{path}: the time column is uneven: at {time[worst]:.6g} s it is off by {found[worst] / period:.2f} "
                f"of a frame at {1 / period:.6g} Hz; export the trial at a constant rate, with a row for every frame"
            )
    limit = (_UNEVEN * period + float(rounding.max())) / float(number[-1])
    if stated is not None and stated > 0 and abs(1 / stated - period) <= limit:
        period = 1 / stated
    rate = 1 / period if stated is None or period != 1 / stated else stated
    return Clock(middle + float(number[0]) * period, rate, float(astray.max()) / period)


def _rounding(time: FloatArray) -> FloatArray:
    """(T,) largest error of each stamp by the digits that it is printed with, s.

    Stamps have a fixed number of decimals or a fixed number of significant digits. Trailing zeros do not show in
    numbers, so the longest stamps tell.
    """
    decimals = np.full(len(time), _MOST_DECIMALS)
    for digits in range(_MOST_DECIMALS - 1, -1, -1):
        scaled = time * 10.0**digits
        decimals[np.abs(scaled - np.round(scaled)) < 1e-5 * np.maximum(1.0, 1e-7 * np.abs(scaled))] = digits
    magnitude = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-_MOST_DECIMALS))) + 1
    significant = float((magnitude + decimals).max())
    places = np.minimum(float(decimals.max()), significant - magnitude)
    return np.asarray(0.5 * 10.0**-places)
