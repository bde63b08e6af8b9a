"""Zero-phase low-pass filter of regressor and wrench, and the reach of a sample.

The wrench is linear in the regressor. The same linear filter on both therefore does not change the parameters, but it
removes noise of the accelerations, which would bias them. A sample in a gap or with a contact affects the filtered
samples around it. The usable samples are therefore eroded by the filter's reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_runs

_SHARE, _MARGIN, _LOWEST, _HIGHEST = 0.999, 2.0, 3.0, 10.0
_OVERSAMPLED = 10
_COLUMNS = 8  # number of columns filtered at a time, to limit the memory


@dataclass(frozen=True)
class LowPass:
    """Butterworth filter of order 2, run forwards and backwards.

    It has no phase. Its gain at the frequency f is 1 / (1 + (tan(πf/rate) / tan(π·cutoff/rate))⁴), which multiplies the
    Fourier transform of each interval without gaps. Before, the straight line through the ends of the interval is
    subtracted; afterwards it is added again. The remainder is extended beyond both ends by its reflection with the
    opposite sign.
    """

    cutoff: float  # cut-off frequency of a single pass, Hz
    rate: float  # samples per second

    @property
    def reach(self) -> float:
        """Reach of one sample, s: 3 % of the area of the impulse response is beyond it."""
        return 0.8 / self.cutoff

    @property
    def reach_samples(self) -> int:
        """:attr:`reach` in samples."""
        return round(self.reach * self.rate)

    @property
    def step(self) -> int:
        """Step between samples that preserves the information of a filtered signal: ten per period of the cut-off."""
        return max(1, int(self.rate / (_OVERSAMPLED * self.cutoff)))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Filter each interval without gaps of a signal (T, ...) along the first axis.

        A sample with any NaN counts as missing. The result is NaN there, and in intervals that are shorter than twice
        the filter's reach.
        """
        flat = signal.reshape(len(signal), -1)
        moving = np.flatnonzero(np.any(flat != 0.0, axis=0))  # columns of zeros stay zeros
        out = np.zeros_like(flat)
        out[:] = np.nan
        for run in find_runs(known(flat)):
            if run.stop - run.start > 2 * self.reach_samples:
                out[run] = 0.0
                for columns in (moving[c] for c in chunks(len(moving), _COLUMNS)):
                    out[run, columns] = self._filter_interval(flat[run, columns])
        return out.reshape(signal.shape)

    def _filter_interval(self, signal: FloatArray) -> FloatArray:
        """Filter an interval (T, c) without gaps."""
        count, beyond = len(signal), 2 * self.reach_samples
        place = np.arange(count)[:, None] / (count - 1)
        line: FloatArray = (1.0 - place) * signal[0] + place * signal[-1]
        rest = np.zeros((next_fast_len(count + 2 * beyond, real=True), signal.shape[1]))
        rest[:count] = signal - line
        rest[count : count + beyond], rest[-beyond:] = -rest[count - beyond - 1 : count - 1][::-1], -rest[beyond:0:-1]
        tangent = np.tan(np.pi * np.fft.rfftfreq(len(rest)))
        gain = 1.0 / (1.0 + (tangent / np.tan(np.pi * self.cutoff / self.rate)) ** 4)
        line += irfft(gain[:, None] * rfft(rest, axis=0), len(rest), axis=0)[:count]
        return line


def choose_cutoff(dq: FloatArray, rate: float) -> float:
    """Return the default cut-off, Hz: twice the frequency below which 99.9 % of the velocity's power lies.

    The spectrum of the fastest joint's velocity shows the movement, whereas noise dominates the spectrum of the
    acceleration. The result is between 3 and 10 Hz, and at most a fifth of the rate. Of the velocities (T, n), rad/s,
    the longest interval without gaps is used.
    """
    longest = max(find_runs(known(dq)), key=lambda run: run.stop - run.start, default=slice(0, 0))
    signal = dq[longest]
    if len(signal) < 2:
        return _LOWEST
    power = np.abs(np.fft.rfft((signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    highest = float(np.max(np.argmax(share >= _SHARE, axis=0))) * rate / len(signal)
    return float(np.clip(_MARGIN * highest, _LOWEST, min(_HIGHEST, rate / 5)))


def undo_averaging(filtered: FloatArray, samples: float) -> FloatArray:
    """Return a filtered signal (T, c), corrected for the averaging of its samples over a width W, in samples.

    The mean of a smooth signal w over W is w + W²/24 · w'' plus a term in W⁴. The second derivative is computed from
    the filtered signal, which contains little noise. For W of one sample and below a tenth of the rate, the correction
    is less than 2 %. The ends of an interval without gaps are not changed.
    """
    bend = np.zeros_like(filtered)
    bend[1:-1] = np.diff(filtered, 2, axis=0)
    return np.asarray(filtered - samples**2 / 24.0 * np.where(np.isfinite(bend), bend, 0.0))


def known(values: FloatArray) -> BoolArray:
    """Return whether every value of each sample (T, ...) is finite, (T,)."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1), dtype=np.bool_)


def erode(mask: BoolArray, samples: int) -> BoolArray:
    """Return the flags with ``samples`` removed from both ends of every run, also at the ends of the recording."""
    out = np.zeros_like(mask)
    for run in find_runs(mask):
        out[run.start + samples : max(run.stop - samples, run.start + samples)] = True
    return out


def blank_incomplete(wrench: FloatArray) -> FloatArray:
    """Return a wrench (T, c) with NaN in all components of a sample if any is missing."""
    return np.where(known(wrench)[:, None], wrench, np.nan)


def interpolate_samples(time: FloatArray, samples: IntArray, steps: IntArray, values: FloatArray) -> FloatArray:
    """Return values (t, n), given at the samples ``steps`` (t,), interpolated at ``samples``; NaN at all others."""
    out = np.full((len(time), values.shape[1]), np.nan)
    for column, series in enumerate(values.T):
        out[samples, column] = np.interp(time[samples], time[steps], series)
    return out
