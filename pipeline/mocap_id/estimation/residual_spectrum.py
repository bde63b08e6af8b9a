"""Spectrum of the residuals: evidence of a low-pass filter, and of segments whose markers oscillate together.

**Filter.** The cameras' noise is white. If the power S of the residuals falls steeply above a frequency f and stays
low, the recording was filtered or resampled. For two passes of a second-order Butterworth filter, the product S(f) f^4
has its maximum at the cut-off. The power of skin and movement falls less steeply.

**Oscillation.** If all markers of a segment move alike, as on wobbling tissue, the chain rotates instead, and the
residuals contain only a part of the oscillation. In truth the markers are displaced without a rotation of the segment.
The rotation of its markers relative to the chain is therefore the error of the chain's angle. Only a narrow peak
counts, because broad peaks occur in every real movement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, as_complex
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.process_model import ORDER

_WINDOW = 4.0  # s
_MOST = 150  # windows of the median spectrum
_NEIGHBOURS = 5  # number of neighbouring frequencies in an average
_LOWEST = 1.0  # Hz; least cut-off that is searched for
_DROP = 50.0  # least ratio of the power at the cut-off to the power one octave or more above it
_FLATTEST = 0.75  # of the highest frequency; a filter with a higher cut-off cannot be detected
_NOISE = (5e-5, 2e-3)  # m, noise of a coordinate before the filter: no camera has less; more is movement off the chain
_STEEPEST = 25.0  # largest ratio of the power an octave below the cut-off to the power at the cut-off
_PEAK = 10.0  # least ratio of a peak to the power beside it
_HALF_WIDTH = 1.3  # ratio of frequencies within a peak
_RANGE = (2.0, 15.0)  # Hz, of oscillations
_LEAST_SPREAD = 0.02  # m, rms distance of a segment's markers from their centroid


@dataclass(frozen=True)
class Oscillation:
    """A narrow peak in the spectrum of the common displacement of a segment's markers."""

    segment: int  # 1 … n
    frequency: float  # Hz
    size: float  # rms displacement that remains in the residuals, m


@dataclass(frozen=True)
class ResidualSpectrum:
    """Spectrum of the residuals, and the motion of each segment's markers relative to the chain."""

    rate: float  # frames per second
    frequency: FloatArray  # (P,) Hz; empty if no window is complete
    power: FloatArray  # (P,) median of the markers' power spectra, m²/Hz
    shift: ComplexArray  # (F, n) mean displacement of each segment's markers, m
    rotation: FloatArray  # (F, n) their rotation, rad; 0 for a segment whose markers are too close together

    @cached_property
    def cut_off(self) -> float | None:
        """Cut-off of a low-pass filter, Hz; None if the recording was not filtered."""
        f, power = self.frequency, _smooth(self.power)
        if not len(f):
            return None
        highest = np.maximum.accumulate(power[::-1])[::-1]  # of all frequencies from here on
        above = np.searchsorted(f, 2 * f)
        inside = (f >= _LOWEST) & (above < len(f))
        fallen = np.flatnonzero(inside & (power > _DROP * highest[np.minimum(above, len(f) - 1)]))
        if not len(fallen):
            return None
        octave = slice(fallen[0], above[fallen[0]] + 1)
        found = float(f[octave][np.argmax(power[octave] * f[octave] ** 4)])
        below, at = np.interp((found / 2, found), f, power)
        before = np.sqrt(4 * at * self.rate / 2)  # the filter passes a quarter of the power at its cut-off
        is_noise = _NOISE[0] < before < _NOISE[1] and below < _STEEPEST * at
        return found if is_noise and found < _FLATTEST * f[-1] else None

    @cached_property
    def oscillations(self) -> tuple[Oscillation, ...]:
        """Strongest oscillation of each segment whose markers oscillate together."""
        found = []
        for k in range(self.shift.shape[1]):
            windows = list(_spectra(self.shift[:, k], self.rate, None))
            if not windows:
                continue
            f, power = _list_frequencies(len(self.shift), self.rate), np.mean(windows, axis=0)
            peak = _find_clearest_peak(f, power)
            if peak is not None:
                near = (f > peak / _HALF_WIDTH) & (f < peak * _HALF_WIDTH)
                found.append(Oscillation(k + 1, peak, float(np.sqrt(2 * np.sum(power[near]) * (f[1] - f[0])))))
        return tuple(found)

    def oscillating_variance(self, frames: IntArray) -> FloatArray:
        """Return the variances (T, n, 4) of the states due to oscillations, which are equal in all ``frames`` (T,)."""
        count, n = self.rotation.shape
        if not self.oscillations:
            return np.zeros((len(frames), n, ORDER))
        twice = np.concatenate([self.rotation, self.rotation[::-1]])
        f = np.fft.rfftfreq(2 * count, 1 / self.rate)
        inside = np.zeros(len(f), dtype=np.bool_)
        for each in self.oscillations:
            inside |= (f > each.frequency / _HALF_WIDTH) & (f < each.frequency * _HALF_WIDTH)
        power = 2 * np.abs(np.fft.rfft(np.diff(twice, axis=1, prepend=0.0), axis=0)[inside]) ** 2 / (2 * count) ** 2
        turning = 2 * np.pi * f[inside, None]
        variance = [np.sum(turning ** (2 * order) * power, axis=0) for order in range(ORDER)]
        return np.broadcast_to(np.stack(variance, axis=1), (len(frames), n, ORDER))


def compute_residual_spectrum(residuals: ChainResiduals) -> ResidualSpectrum:
    """Return the spectrum of the residuals, and the motion of each segment's markers relative to the chain."""
    chain, count = residuals.states.chain, len(residuals.used_markers)
    n, local = len(chain.centres), as_complex(chain.local)
    shift, rotation = np.zeros((count, n), dtype=np.complex128), np.zeros((count, n))
    windows, each = list[FloatArray](), max(_MOST // len(local), 1)
    for k, off, seen in residuals.columns():
        own = local[chain.segment == chain.segment[k]]
        j, square = chain.segment[k] - 1, float(np.sum(np.abs(own - own.mean()) ** 2))
        shift[:, j] += off / len(own)
        if square > _LEAST_SPREAD**2 * len(own):
            rotation[:, j] += (np.conj(local[k] - own.mean()) * off).imag / square
        windows += _spectra(off, residuals.rate, seen, each)
    frequency = _list_frequencies(count, residuals.rate) if windows else np.empty(0)
    power = np.median(windows, axis=0) if windows else np.empty(0)
    return ResidualSpectrum(residuals.rate, frequency, power, shift, rotation)


def _find_clearest_peak(f: FloatArray, power: FloatArray) -> float | None:
    """Return the frequency, Hz, of the clearest narrow peak; None if none is high enough above the power beside it."""
    best, found = _PEAK, None
    for k in np.flatnonzero((f >= _RANGE[0]) & (f <= min(_RANGE[1], f[-1] / 2))):
        ratio = f / f[k]
        beside = [power[(ratio > 1 / 2) & (ratio < 1 / 1.4)], power[(ratio > 1.4) & (ratio < 2)]]
        if all(np.any(side) for side in beside):
            clear = power[k] / max(float(np.mean(side)) for side in beside)
            if clear > best:
                best, found = clear, float(f[k])
    return found


def _smooth(power: FloatArray) -> FloatArray:
    """Return a spectrum (P,) averaged over neighbouring frequencies."""
    if len(power) < _NEIGHBOURS:
        return power
    ones = np.ones(_NEIGHBOURS)
    return np.asarray(np.convolve(power, ones, "same") / np.convolve(np.ones_like(power), ones, "same"))


def _spectra(
    series: ComplexArray, rate: float, seen: BoolArray | None, most: int | None = None
) -> Iterator[FloatArray]:
    """Yield the power spectrum (P,), per coordinate, of each window of a series (F,) of positions x + 1j y.

    Windows with frames that are not ``seen`` (F,) are left out. ``most`` is the largest number of windows.
    """
    size = _window_size(len(series), rate)
    taper = np.hanning(size)
    taper /= np.sqrt(2 * rate * np.sum(taper**2))
    starts = np.arange(0, len(series) - size + 1, max(size // 2, 1))
    if seen is not None:
        starts = starts[[bool(seen[k : k + size].all()) for k in starts]]
    if most is not None and len(starts) > most:
        starts = starts[np.linspace(0, len(starts) - 1, most).round().astype(np.int64)]
    for start in starts:
        part = series[start : start + size]
        power = np.abs(np.fft.fft((part - part.mean()) * taper)) ** 2
        yield power[1 : size // 2] + power[-1 : -(size // 2) : -1]


def _list_frequencies(count: int, rate: float) -> FloatArray:
    size = _window_size(count, rate)
    return np.arange(1, size // 2) * rate / size


def _window_size(count: int, rate: float) -> int:
    return max(min(round(_WINDOW * rate), count) // 2 * 2, 4)
