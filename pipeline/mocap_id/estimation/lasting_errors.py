"""Standard deviations of the states from white camera noise and from lasting errors of skin and chain geometry.

Lasting errors are equal or similar in many frames. The filter treats all residuals of the chain as white noise. Most of
them are due to skin, whose displacements average out slowly or not at all. The filter's variance is therefore reduced
to camera noise alone, and the variance of the lasting errors is added.

The filter's variance also includes the movement beyond the smoother's pass band, assuming a movement driven by white
snap. For a fourfold integrator observed in white noise, the smoother has the frequency response H = 1 / (1 + (w /
w0)^8). Of the variance of derivative d, the fraction 1 - (2 d + 1) / 8 is noise that the smoother passes, and the rest
is movement that it does not pass. This rest is estimated from the movement itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, chunks, interpolate_gaps
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.smoothing import States

_WITHHELD = (2 * np.arange(ORDER) + 1) / (2 * ORDER)
"""Fraction of each derivative's variance that is movement which the smoother does not pass."""

_TWICE = _WITHHELD - 1 + (2 - _WITHHELD) * (3 - _WITHHELD) / 6
"""Fraction of the passed noise that a second smoothing removes: integral of H^2 (1 - H)^2 over integral of H^2."""


def estimate_camera_sd(used_markers: FloatArray, states: States, floor: float) -> float:
    """Return the standard deviation, m, of the markers' white noise, between ``floor`` and the filter's marker noise.

    It is estimated from second differences of the residuals, which remove lasting errors. If no marker is used in three
    successive frames, the filter's marker noise is returned. ``used_markers`` (F, M, 2) are the markers used for the
    states, plane frame, m; NaN elsewhere.
    """
    squares, count = 0.0, 0
    for s in chunks(len(used_markers)):
        part = slice(s.start, s.stop + 2)  # overlaps the next chunk by two frames
        off = used_markers[part] - states.predicted_in(part)
        bends = off[2:] - 2 * off[1:-1] + off[:-2]
        known = bends[np.isfinite(bends)]
        squares, count = squares + float(np.sum(known**2)), count + known.size
    if count == 0:
        return states.noise.marker_sd
    return min(states.noise.marker_sd, max(floor, float(np.sqrt(squares / count / 6))))


@dataclass(frozen=True)
class LastingErrors:
    """Variances of lasting errors, which do not average out, and the camera noise, which does."""

    camera: float  # camera noise of a coordinate, m
    frames: IntArray  # (T,) frames of the variances, ascending
    variance: FloatArray  # (T, n, 4) variances of the errors from skin and the chain's geometry


def add_lasting_errors(states: States, rate: float, errors: LastingErrors) -> FloatArray:
    """Return the standard deviations (F, n, 4) of the states with lasting errors; ``rate`` is in frames per second."""
    sd, every = np.empty_like(states.sd), np.arange(len(states.sd))
    for joint in range(sd.shape[1]):
        variance: FloatArray = states.sd[:, joint] ** 2
        steady = np.median(variance, axis=0)  # (4,); gaps and ends have more
        white = np.minimum(variance, steady) * (1 - _WITHHELD) * (errors.camera / states.noise.marker_sd) ** 2
        withheld = np.maximum(_measure_withheld(states.mean[:, joint, 0], steady, rate) - _TWICE * white, 0)
        total = white + np.maximum(variance - steady, 0) + withheld
        for order in range(ORDER):
            total[:, order] += np.interp(every, errors.frames, errors.variance[:, joint, order])
        sd[:, joint] = np.sqrt(total)
    return sd


def compute_corner(steady: FloatArray) -> float:
    """Return the corner w0 of the smoother of a joint, rad/s, from its variances (4,) of angle and acceleration."""
    ratio = np.sin(5 * np.pi / 8) / np.sin(np.pi / 8) * steady[2] / steady[0]
    return float(ratio**0.25)


def _measure_withheld(angle: FloatArray, steady: FloatArray, rate: float) -> FloatArray:
    """Return the mean square (F, 4) of the movement that a second smoothing removes, averaged around each frame."""
    squares = np.empty((len(angle), ORDER))
    extended, w0 = _extend_backwards(angle), compute_corner(steady)
    frequency = 2 * np.pi * np.fft.rfftfreq(len(extended), 1 / rate)
    stopped = np.fft.rfft(extended) * (1 - 1 / (1 + (frequency / w0) ** (2 * ORDER)))
    memory = np.exp(-0.5 * (frequency / w0) ** 2)
    for order in range(ORDER):
        part = np.fft.irfft((1j * frequency) ** order * stopped, len(extended))
        squares[:, order] = np.fft.irfft(np.fft.rfft(part**2) * memory, len(extended))[: len(angle)]
    return squares


def _extend_backwards(angle: FloatArray) -> FloatArray:
    """Return the interpolated angles (F,) followed by their time reversal, (2 F,), so that the series is periodic."""
    filled = interpolate_gaps(angle[:, None])[:, 0]
    return np.concatenate([filled, filled[::-1]])
