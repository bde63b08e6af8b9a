"""Zero-phase low-pass filter of regressor and wrench, and the filter's reach.

The wrench is linear in the regressor. The same linear filter on both therefore does not change the parameters, but it
removes noise of the accelerations, which would bias the parameters. A sample in a gap or with a contact affects the
filtered samples around it. The reach is the time up to which this effect matters. Samples that are closer than the
reach to such a sample are not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_complete_rows, find_runs

_SHARE, _MARGIN, _LOWEST, _HIGHEST = 0.999, 2.0, 3.0, 10.0
_OVERSAMPLED = 10
_PASSES_ALL = 0.49  # cut-off as a fraction of the rate; a higher one passes every frequency that the samples contain
_COLUMNS = 8  # number of columns filtered at a time, to limit the memory


@dataclass(frozen=True)
class LowPass:
    """Butterworth filter of order 2, run forwards and backwards.

    It does not shift the phase. Its gain at the frequency f is 1 / (1 + (tan(πf/rate) / tan(π·cutoff/rate))⁴), which
    multiplies the Fourier transform of each interval without gaps. The straight line through the ends of the interval
    is subtracted first and added again at the end. The remainder is extended beyond both ends by its reflection with
    the opposite sign.
    """

    cutoff: float  # cut-off frequency of a single pass, Hz
    rate: float  # samples per second

    @property
    def reach(self) -> float:
        """Time to either side of a sample, s, beyond which only 3 % of the area of its impulse response lies."""
        return 0.8 / self.cutoff

    @property
    def reach_samples(self) -> int:
        """Number of samples in :attr:`reach`, at least 1."""
        return max(1, round(self.reach * self.rate))

    @property
    def step(self) -> int:
        """Number k such that every k-th filtered sample is sufficient: about ten samples per period of the cut-off."""
        return max(1, int(self.rate / (_OVERSAMPLED * self.cutoff)))

    def gain(self, cycles: FloatArray) -> FloatArray:
        """Return the gain at frequencies in cycles per sample, 0 to 0.5."""
        tangent = np.tan(np.pi * cycles) / np.tan(np.pi * min(self.cutoff / self.rate, _PASSES_ALL))
        return np.asarray(1.0 / (1.0 + tangent**4))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Filter each interval without gaps of a signal (T, ...) along the first axis.

        A sample with any NaN counts as missing. The result (T, ...) is NaN in missing samples, and in intervals of at
        most twice the filter's reach.
        """
        flat = signal.reshape(len(signal), -1)
        moving = np.flatnonzero(np.any(flat != 0.0, axis=0))  # columns of zeros stay zeros
        out = np.zeros_like(flat)
        out[:] = np.nan
        for run in find_runs(find_complete_rows(flat)):
            if run.stop - run.start > 2 * self.reach_samples:
                out[run] = 0.0
                for columns in (moving[c] for c in chunks(len(moving), _COLUMNS)):
                    out[run, columns] = self._filter_interval(flat[run, columns])
        return out.reshape(signal.shape)

    def _filter_interval(self, signal: FloatArray) -> FloatArray:
        """Return an interval (T, c) without gaps, filtered."""
        count, beyond = len(signal), 2 * self.reach_samples
        place = np.arange(count)[:, None] / (count - 1)
        line: FloatArray = (1.0 - place) * signal[0] + place * signal[-1]
        rest = np.zeros((next_fast_len(count + 2 * beyond, real=True), signal.shape[1]))
        rest[:count] = signal - line
        rest[count : count + beyond], rest[-beyond:] = -rest[count - beyond - 1 : count - 1][::-1], -rest[beyond:0:-1]
        gain = self.gain(np.asarray(np.fft.rfftfreq(len(rest)), dtype=np.float64))
        line += irfft(gain[:, None] * rfft(rest, axis=0), len(rest), axis=0)[:count]
        return line


def choose_cutoff(dq: FloatArray, rate: float) -> float:
    """Return the default cut-off, Hz: twice the frequency below which 99.9 % of the velocity's power lies.

    ``dq`` (T, n) are the joint velocities, rad/s, of which the longest interval without gaps and the joint with the
    highest frequency are used. The result is between 3 and 10 Hz, and at most a fifth of the rate. Velocities are used
    instead of accelerations because noise dominates the spectrum of the accelerations.
    """
    longest = max(find_runs(find_complete_rows(dq)), key=lambda run: run.stop - run.start, default=slice(0, 0))
    signal = dq[longest]
    if len(signal) < 2:
        return _LOWEST
    power = np.abs(np.fft.rfft((signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    highest = float(np.max(np.argmax(share >= _SHARE, axis=0))) * rate / len(signal)
    return float(np.clip(_MARGIN * highest, _LOWEST, min(_HIGHEST, rate / 5)))


def undo_averaging(filtered: FloatArray, samples: float) -> FloatArray:
    """Return a filtered signal (T, c), corrected for the averaging of each sample over a time W of ``samples`` samples.

    The mean of a smooth signal w over W is w + W²/24 · w'' plus a term in W⁴. The second derivative is computed from
    the filtered signal, which contains little noise. If W is one sample, the correction is less than 2 % at frequencies
    below a tenth of the rate. The ends of an interval without gaps are not changed.
    """
    bend = np.zeros_like(filtered)
    bend[1:-1] = np.diff(filtered, 2, axis=0)
    return np.asarray(filtered - samples**2 / 24.0 * np.where(np.isfinite(bend), bend, 0.0))


def erode(mask: BoolArray, samples: int) -> BoolArray:
    """Return a copy of a mask (T,) in which the first and last ``samples`` flags of every run of True are False."""
    out = np.zeros_like(mask)
    for run in find_runs(mask):
        out[run.start + samples : max(run.stop - samples, run.start + samples)] = True
    return out


def blank_incomplete(wrench: FloatArray) -> FloatArray:
    """Return a copy of a wrench (T, c), with NaN in all components of a sample if one of them is missing."""
    return np.where(find_complete_rows(wrench)[:, None], wrench, np.nan)


def interpolate_samples(time: FloatArray, samples: IntArray, steps: IntArray, values: FloatArray) -> FloatArray:
    """Interpolate values (t, n) of the samples ``steps`` (t,) to ``samples``; return (T, n), NaN in other samples."""
    out = np.full((len(time), values.shape[1]), np.nan)
    for column, series in enumerate(values.T):
        out[samples, column] = np.interp(time[samples], time[steps], series)
    return out
