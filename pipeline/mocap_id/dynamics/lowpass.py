"""Zero-phase low-pass of regressor and wrench, and its reach.

The wrench is linear in the regressor. The same linear filter on both therefore does not change the parameters, but
removes noise of the accelerations, which would bias them. Samples beyond a gap or a contact affect their neighbours, so
the usable samples are eroded by the filter's reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import BoolArray, FloatArray, chunks, find_runs

_SHARE, _MARGIN, _LOWEST, _HIGHEST = 0.999, 2.0, 3.0, 10.0
_OVERSAMPLED = 10
_COLUMNS = 8  # filtered at a time, to bound the memory


@dataclass(frozen=True)
class LowPass:
    """Butterworth filter of order 2, run forwards and backwards.

    It has no phase; its gain at the frequency f is 1 / (1 + (tan(πf/rate) / tan(π·cutoff/rate))⁴), which multiplies the
    Fourier transform of a stretch. The straight line through the ends of the stretch passes unchanged and is subtracted
    before; the remainder is extended beyond both ends by its reflection with the opposite sign.

    Parameters
    ----------
    cutoff : float
        Cut-off of a single pass, Hz.
    rate : float
        Samples per second.
    """

    cutoff: float
    rate: float

    @property
    def reach(self) -> float:
        """Reach of one sample, s: 3 % of the impulse response's area is beyond it."""
        return 0.8 / self.cutoff

    @property
    def reach_samples(self) -> int:
        """:attr:`reach` in samples."""
        return round(self.reach * self.rate)

    @property
    def step(self) -> int:
        """Step between the samples of a filtered signal that are needed: ten per period of the cut-off."""
        return max(1, int(self.rate / (_OVERSAMPLED * self.cutoff)))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Filter each finite stretch along the first axis.

        Parameters
        ----------
        signal : (T, ...) array
            A sample with any NaN counts as missing.

        Returns
        -------
        (T, ...) array
            NaN where the sample is missing or its stretch is shorter than twice the filter's reach.
        """
        flat = signal.reshape(len(signal), -1)
        moving = np.flatnonzero(np.any(flat != 0.0, axis=0))  # columns of zeros stay zeros
        out = np.zeros_like(flat)
        out[:] = np.nan
        for run in find_runs(known(flat)):
            if run.stop - run.start > 2 * self.reach_samples:
                out[run] = 0.0
                for columns in (moving[c] for c in chunks(len(moving), _COLUMNS)):
                    out[run, columns] = self._stretch(flat[run, columns])
        return out.reshape(signal.shape)

    def _stretch(self, signal: FloatArray) -> FloatArray:
        """Filter a stretch (T, c) without gaps."""
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


def cutoff_from_velocity(dq: FloatArray, rate: float) -> float:
    """Return the default cut-off: twice the frequency below which 99.9 % of the fastest joint's velocity power lies.

    The velocity's spectrum shows the movement, whereas that of the acceleration is dominated by noise. The result is
    between 3 and 10 Hz, and at most a fifth of the rate.

    Parameters
    ----------
    dq : (T, n) array
        Joint velocities, rad/s; the longest finite stretch is used.
    rate : float
        Samples per second.

    Returns
    -------
    float
        Hz.
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
    """Correct a filtered signal for the averaging of its samples over a time window.

    The mean of a smooth signal w over a width W is w + W²/24 · w'' plus a term in W⁴. The second derivative is taken
    from the filtered signal, in which little noise is left to amplify. Below a tenth of the rate the correction is less
    than 2 % for W of one sample.

    Parameters
    ----------
    filtered : (T, c) array
        Signal after the low-pass; NaN marks missing values.
    samples : float
        Width W in samples.

    Returns
    -------
    (T, c) array
        Unchanged at the ends of a stretch.
    """
    bend = np.zeros_like(filtered)
    bend[1:-1] = np.diff(filtered, 2, axis=0)
    return np.asarray(filtered - samples**2 / 24.0 * np.where(np.isfinite(bend), bend, 0.0))


def known(values: FloatArray) -> BoolArray:
    """Return the samples (T,) in which every value (T, ...) is finite."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1), dtype=np.bool_)


def erode(mask: BoolArray, samples: int) -> BoolArray:
    """Remove ``samples`` from both ends of every stretch, also at the ends of the recording."""
    out = np.zeros_like(mask)
    for run in find_runs(mask):
        out[run.start + samples : max(run.stop - samples, run.start + samples)] = True
    return out
