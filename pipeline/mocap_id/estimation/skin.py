"""Standard deviations that know what of the noise is white, and what skin and the chain's geometry add to it.

The filter takes everything that the chain cannot follow for white noise. Most of it is skin, which averages out
slowly or not at all: with camera noise alone the filter's variance is smaller, and what lasts is added as errors of
their own. The filter's variance also holds what a movement driven by white snap would have beyond its pass band. For a
fourfold integrator observed in white noise, the smoother passes 1 / (1 + (w / w0)^8); of the variance of derivative d
the share 1 - (2 d + 1) / 8 is passed noise, and the rest is movement not passed. The latter is taken from the movement
itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, chunks
from mocap_id.estimation.process import ORDER
from mocap_id.estimation.smoothing import States

_WITHHELD = (2 * np.arange(ORDER) + 1) / (2 * ORDER)
"""Share of the variance of each derivative that is movement which the smoother does not pass."""

_TWICE = _WITHHELD - 1 + (2 - _WITHHELD) * (3 - _WITHHELD) / 6
"""Share of the noise passed that smoothing once more takes off: of H^2, what H^2 (1 - H)^2 is."""


def camera_sd(rested: FloatArray, states: States, floor: float) -> float:
    """Standard deviation (m) of what of the markers changes from frame to frame beside the movement.

    From second differences of the residuals, in which nothing is left of what lasts; the filter's own where no marker
    is seen three times in a row, and never less than ``floor``.

    Parameters
    ----------
    rested : (F, M, 2) array
        Markers that the states rest on, plane frame, m; NaN elsewhere.
    states : States
    floor : float
        m.
    """
    squares, count = 0.0, 0
    for s in chunks(len(rested)):
        part = slice(s.start, s.stop + 2)  # two frames are the next one's as well
        off = rested[part] - states.predicted_in(part)
        bends = off[2:] - 2 * off[1:-1] + off[:-2]
        known = bends[np.isfinite(bends)]
        squares, count = squares + float(np.sum(known**2)), count + known.size
    if count == 0:
        return states.noise.marker_sd
    return min(states.noise.marker_sd, max(floor, float(np.sqrt(squares / count / 6))))


@dataclass(frozen=True)
class LastingErrors:
    """What the markers tell of errors that do not average out.

    Parameters
    ----------
    camera : float
        Camera noise of a coordinate, m, which does.
    frames : (T,) int array
        Ascending.
    variance : (T, n, 4) array
        At ``frames``, of the errors from skin and the chain's geometry.
    """

    camera: float
    frames: IntArray
    variance: FloatArray


def with_lasting_errors(states: States, rate: float, errors: LastingErrors) -> FloatArray:
    """(F, n, 4) standard deviations of the states, as filtered at ``rate``, Hz, with these errors."""
    sd, every = np.empty_like(states.sd), np.arange(len(states.sd))
    for joint in range(sd.shape[1]):
        variance: FloatArray = states.sd[:, joint] ** 2
        steady = np.median(variance, axis=0)  # (4,); gaps and ends have more
        white = np.minimum(variance, steady) * (1 - _WITHHELD) * (errors.camera / states.noise.marker_sd) ** 2
        withheld = np.maximum(_withheld(states.mean[:, joint, 0], steady, rate) - _TWICE * white, 0)
        total = white + np.maximum(variance - steady, 0) + withheld
        for order in range(ORDER):
            total[:, order] += np.interp(every, errors.frames, errors.variance[:, joint, order])
        sd[:, joint] = np.sqrt(total)
    return sd


def corner(steady: FloatArray) -> float:
    """The smoother's w0 of a joint, rad/s, from the variances (4,) of its states: each order has its own share."""
    ratio = np.sin(5 * np.pi / 8) / np.sin(np.pi / 8) * steady[2] / steady[0]
    return float(ratio**0.25)


def _withheld(angle: FloatArray, steady: FloatArray, rate: float) -> FloatArray:
    """(F, 4) mean square, over the smoother's memory, of what it takes off the movement: smoothed once more."""
    squares = np.empty((len(angle), ORDER))
    twice, w0 = _continued(angle), corner(steady)
    turning = 2 * np.pi * np.fft.rfftfreq(len(twice), 1 / rate)
    stopped = np.fft.rfft(twice) * (1 - 1 / (1 + (turning / w0) ** (2 * ORDER)))
    memory = np.exp(-0.5 * (turning / w0) ** 2)
    for order in range(ORDER):
        part = np.fft.irfft((1j * turning) ** order * stopped, len(twice))
        squares[:, order] = np.fft.irfft(np.fft.rfft(part**2) * memory, len(twice))[: len(angle)]
    return squares


def _continued(angle: FloatArray) -> FloatArray:
    """(2 F,) angles without gaps, continued backwards in time so that they end where they began."""
    known = np.isfinite(angle)
    if not known.any():
        return np.zeros(2 * len(angle))
    every = np.arange(len(angle))
    filled = np.interp(every, every[known], angle[known])
    return np.concatenate([filled, filled[::-1]])
