"""Analog samples → marker times, without shifting them in time; and the frames that statistics look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording.model import Plate

_ROUNDING = 1e-6
"""Relative slack of times that a file holds in single precision."""

_FASTER = 1.001
"""Ratio of the rates from which on there is something to average."""

_LOOKS_HZ = 60.0
"""Statistics look at the frames at this rate or a little above."""


@dataclass(frozen=True)
class PlateSamples:
    """A plate's wrench at given times, as in :class:`mocap_id.recording.Plate`.

    Parameters
    ----------
    force, moment : (F, 3) array
        N and N·m about the lab origin; NaN where ``ok`` is False.
    ok : (F,) bool array
        Every analog sample behind the value is good.
    """

    force: FloatArray
    moment: FloatArray
    ok: BoolArray


def decimate(plate: Plate, times: FloatArray, rate: float) -> PlateSamples:
    """Average a plate's samples over one marker interval around every marker time.

    The mean of the piecewise linear signal over [t - T/2, t + T/2] is symmetric about t for every ratio of the rates,
    odd, even or fractional, so nothing lags; averaging whole blocks of an even or leading ratio would shift the
    wrench by half a block. At the ends of the signal the interval shrinks symmetrically. Plates that are not sampled
    faster than the markers are interpolated.

    Parameters
    ----------
    plate : Plate
    times : (F,) array
        Marker times, s, the plate's clock.
    rate : float
        Marker frames per second.
    """
    samples = np.where(plate.ok[:, None], np.concatenate([plate.force, plate.moment], axis=1), 0.0)
    last = len(samples) - 1
    at = (times - plate.start) * plate.rate  # in samples
    inside = (at >= -_ROUNDING * max(last, 1)) & (at <= last * (1 + _ROUNDING) + _ROUNDING)
    if last < 1:
        empty = np.full((len(times), 3), np.nan)
        return PlateSamples(empty, empty.copy(), np.zeros(len(times), bool))
    centre = np.clip(at, 0, last)
    ratio = plate.rate / rate
    half = np.minimum(ratio / 2 if ratio > _FASTER else 0.0, np.minimum(centre, last - centre))
    mean = np.where((half > 1e-9)[:, None], _interval_mean(samples, centre, half), _interpolated(samples, centre))
    ok = inside & ~_any_bad(~plate.ok, centre - half, centre + half)
    mean[~ok] = np.nan
    return PlateSamples(mean[:, :3], mean[:, 3:], ok)


@dataclass(frozen=True)
class Look:
    """What the statistics of a recording look at: its frames at 60 to 120 Hz, and its plates averaged between them.

    Means, percentiles, principal axes and speeds over 0.1 s change less than their own uncertainty: skin and sway are
    the same over a tenth of a second, so that neighbouring frames repeat each other. Markers are picked, not averaged:
    a gap or a jump does not spread, one of a few frames is met as often as its share of the frames, and what moves
    faster than 30 Hz keeps its mean and its variance. A plate is averaged, because the hum of the mains, picked at
    60 Hz, would be a constant force. Recordings under 120 Hz are looked at as they are. What counts single frames has
    to look at all of them: swaps, jumps, gaps, the limits of a plate.

    Parameters
    ----------
    step : int
        Every so many-th frame is looked at, the first one first.
    positions : (L, M, 3) array
        Markers, lab axes with Z up, m; a view.
    time : (L,) array
        s.
    rate : float
        Hz.
    samples : tuple of PlateSamples
        Of every plate, at these times.
    """

    step: int
    positions: FloatArray
    time: FloatArray
    rate: float
    samples: tuple[PlateSamples, ...]

    @classmethod
    def at(cls, positions: FloatArray, time: FloatArray, rate: float, plates: Sequence[Plate] = ()) -> Look:
        """Look at frames (F, M, 3), (F,) s, and at plates."""
        step = max(1, int(rate / _LOOKS_HZ))
        time, rate = time[::step], rate / step
        return cls(step, positions[::step], time, rate, tuple(decimate(plate, time, rate) for plate in plates))


def averaging_width(analog_rate: float | None, rate: float) -> float:
    """Over how long :func:`decimate` averages, s: of the mean over a box that flattens a curved signal as much.

    The interval T between frames, and a little for the straight lines between samples Δ apart, which cut every curve
    short too: a mean over the width W adds W²/24 of the second derivative, and both together T²/24 + Δ²/12.

    Parameters
    ----------
    analog_rate : float or None
        Samples of the plate a second; None without plates.
    rate : float
        Marker frames per second.

    Returns
    -------
    float
        0 where nothing is averaged.
    """
    if analog_rate is None or analog_rate / rate <= _FASTER:
        return 0.0
    return float(np.sqrt(rate**-2 + 2.0 * analog_rate**-2))


def _interpolated(samples: FloatArray, at: FloatArray) -> FloatArray:
    low = np.minimum(at.astype(np.int64), len(samples) - 2)
    part = (at - low)[:, None]
    return np.asarray(samples[low] * (1 - part) + samples[low + 1] * part)


def _interval_mean(samples: FloatArray, centre: FloatArray, half: FloatArray) -> FloatArray:
    """Mean of the piecewise linear signal over centre ± half, in samples."""
    integral = np.zeros_like(samples)
    np.cumsum((samples[1:] + samples[:-1]) / 2, axis=0, out=integral[1:])

    def primitive(at: FloatArray) -> FloatArray:
        low = np.minimum(at.astype(np.int64), len(samples) - 2)
        part = (at - low)[:, None]
        return np.asarray(integral[low] + samples[low] * part + (samples[low + 1] - samples[low]) * part**2 / 2)

    width = np.maximum(2 * half, 1e-12)[:, None]
    return np.asarray((primitive(centre + half) - primitive(centre - half)) / width)


def _any_bad(bad: BoolArray, start: FloatArray, stop: FloatArray) -> BoolArray:
    """Whether one of the samples that the interval touches is bad."""
    count = np.concatenate([[0], np.cumsum(bad)])
    low = np.floor(start + _ROUNDING).astype(np.int64)
    high = np.minimum(np.ceil(stop - _ROUNDING).astype(np.int64), len(bad) - 1)
    return np.asarray(count[high + 1] > count[np.maximum(low, 0)])
