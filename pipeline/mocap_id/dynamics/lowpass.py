"""One zero-phase low-pass for regressor and wrench alike, and how far its memory reaches.

The wrench is linear in the regressor, so the same linear filter on both leaves the parameters untouched and takes
away the noise of the accelerations, which would otherwise bias them. Samples beyond a gap or a contact leak into
their neighbours; what may be used is therefore eroded by the filter's reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import BoolArray, FloatArray

_SHARE, _MARGIN, _LOWEST, _HIGHEST = 0.999, 2.0, 3.0, 10.0
_OVERSAMPLED = 10


@dataclass(frozen=True)
class LowPass:
    """Butterworth filter of order 2, run forwards and backwards.

    That has no phase, and at the frequency f the gain 1 / (1 + (tan(πf/rate) / tan(π·cutoff/rate))⁴), which multiplies
    the Fourier transform of a stretch. The straight line through its ends passes such a filter as it is and is left
    out; the rest is continued beyond both ends by its reflection with the sign turned.

    Parameters
    ----------
    cutoff : float
        Hz, of the single pass.
    rate : float
        Samples a second.
    """

    cutoff: float
    rate: float

    @property
    def reach(self) -> float:
        """How far one sample is felt, s: beyond it the impulse response holds 3 % of its area."""
        return 0.8 / self.cutoff

    @property
    def reach_samples(self) -> int:
        """:attr:`reach` in samples."""
        return round(self.reach * self.rate)

    @property
    def step(self) -> int:
        """Every how many-th sample of a filtered signal is enough: ten to the period of the cut-off."""
        return max(1, int(self.rate / (_OVERSAMPLED * self.cutoff)))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Filter along the first axis, each finite stretch by itself.

        Parameters
        ----------
        signal : (T, ...) array
            A sample is missing where any of its values is NaN.

        Returns
        -------
        (T, ...) array
            NaN where the sample is missing or its stretch is shorter than the filter's reach on both sides.
        """
        flat = signal.reshape(len(signal), -1)
        moving = np.flatnonzero(np.any(flat != 0.0, axis=0))  # columns of zeros stay zeros
        out = np.zeros_like(flat)
        out[:] = np.nan
        for run in runs(known(flat)):
            if run.stop - run.start > 2 * self.reach_samples:
                out[run] = 0.0
                out[run, moving] = self._stretch(flat[run, moving])
        return out.reshape(signal.shape)

    def _stretch(self, signal: FloatArray) -> FloatArray:
        """A stretch (T, c) without gaps."""
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
    """Cut-off by the default rule: twice the frequency that holds 99.9 % of the fastest joint's velocity power.

    Velocity, because its spectrum is the movement's and not yet the noise's, as that of the acceleration is. The
    result is held between 3 and 10 Hz and under a fifth of the rate.

    Parameters
    ----------
    dq : (T, n) array
        Joint velocities, rad/s; the longest finite stretch is used.
    rate : float
        Samples a second.

    Returns
    -------
    float
        Hz.
    """
    longest = max(runs(known(dq)), key=lambda run: run.stop - run.start, default=slice(0, 0))
    signal = dq[longest]
    if len(signal) < 2:
        return _LOWEST
    power = np.abs(np.fft.rfft((signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), np.finfo(float).tiny)
    highest = float(np.max(np.argmax(share >= _SHARE, axis=0))) * rate / len(signal)
    return float(np.clip(_MARGIN * highest, _LOWEST, min(_HIGHEST, rate / 5)))


def restored(filtered: FloatArray, samples: float) -> FloatArray:
    """A filtered signal whose samples were means over some time, as it was without the averaging.

    The mean over a width W of a smooth signal w is w + W²/24 · w'' and a term in W⁴. The second derivative is that of
    the filtered signal, which has next to no noise left that differences could raise: under a tenth of the rate the
    correction is less than 2 % for W of one sample.

    Parameters
    ----------
    filtered : (T, c) array
        After the low-pass; NaN is missing.
    samples : float
        W in samples.

    Returns
    -------
    (T, c) array
        Unchanged at the ends of a stretch.
    """
    bend = np.zeros_like(filtered)
    bend[1:-1] = np.diff(filtered, 2, axis=0)
    return np.asarray(filtered - samples**2 / 24.0 * np.where(np.isfinite(bend), bend, 0.0))


def known(values: FloatArray) -> BoolArray:
    """Samples (T,) of which every value (T, ...) is finite."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1), dtype=np.bool_)


def runs(mask: BoolArray) -> list[slice]:
    """Stretches of true samples, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def erode(mask: BoolArray, samples: int) -> BoolArray:
    """Take ``samples`` off both ends of every stretch; the ends of the recording count as ends."""
    out = np.zeros_like(mask)
    for run in runs(mask):
        out[run.start + samples : max(run.stop - samples, run.start + samples)] = True
    return out
