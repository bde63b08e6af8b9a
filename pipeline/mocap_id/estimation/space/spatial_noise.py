"""Marker and process noise of a chain in space, from the poses of single frames.

The changes between frames, in the axes of each segment, are added up to one series for each degree of freedom. A series
consists of movement and white noise of known variance r. For a snap with the standard deviation s, held over one frame,
the smoother has the frequency response H = 1 / (1 + (w / w0)^8), where w0^8 = s² / r for a time step of one. The snap
is chosen for the least squared error of the smoothed acceleration. Up to a constant, this error is

    sum over frequencies of H² I − 2 H (I − N)

with the power I of the measured acceleration and the power N of its noise. Where I is near N, the power of the movement
is assumed to decrease steadily with frequency. The likelihood of white snap is not used, because slow movement, which
has less power than white snap, would bias it. Only samples in motion count, because rest would make the snap too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.filter_problem import ORDER
from mocap_id.estimation.space.frame_poses import FramePoses, sum_steps
from mocap_id.estimation.space.space_kernels import ChainModel

SNAP_BOUNDS = (1e-1, 1e6)  # search range of the snap's standard deviation over one frame, rad/s⁴ or m/s⁴

_LARGEST_RATIO = 2.0  # of the snaps of two coordinates of one joint
_STILL = 0.3  # of the rms speed; slower samples are at rest and do not count
_AROUND = 0.25  # s; samples at rest that are this near to a moving sample also count
_WINDOW = 4.0  # s
_MOST = 100  # windows
_MOSTLY = 0.5  # least fraction of moving samples in a window
_GAP_SHARE = 0.36  # s^½; with this factor, white snap and a constant snap cause equal errors after 0.3 s
_REACH = 1.9  # highest frequency, relative to the corner, of the movement that the smoother does not pass
_CAUTION = 1.3  # factor on the best snap for autocorrelated noise, because fast movement needs more than the average
_LEAST = 16  # frames of a window
_FASTEST = 4.0  # Hz, highest frequency of movement that exceeds autocorrelated noise
_NEAR = 10.0  # ratio of measured power to noise power below which the power of the movement is modelled
_STEEPNESS = np.array([4.0, 6.0, 8.0, 12.0, 16.0])  # exponents of the fall of movement relative to noise; 4: constant
_CROSSINGS = 80  # frequencies at which movement and noise may be equal
_TRIALS = 120  # values of the snap


Colour: TypeAlias = Callable[[FloatArray], FloatArray]
"""Power of noise at frequencies (K,), Hz, relative to white noise of the same variance."""


@dataclass(frozen=True)
class SpatialNoise:
    """Noise of the filter in space, for M markers and d degrees of freedom."""

    camera_sd: float  # standard deviation of a marker's white noise, per coordinate, m
    marker_sd: FloatArray  # (M,) the same with the lasting error of the skin, for each marker, m
    snap: FloatArray  # (d,) standard deviation of the snap, held over one frame, rad/s⁴ or m/s⁴
    gap_snap: FloatArray  # (d,) the same in gaps; it is larger, because the snap of a real movement is not white
    errors: FloatArray  # (3, d) mean squared error of pose, velocity, acceleration, without skin; NaN if unknown


def estimate_camera_noise(frames: FramePoses, floor: float) -> float:
    """Return the standard deviation, m, of the markers' white noise, at least ``floor``.

    It is estimated from second differences of the residuals, which remove lasting errors. It is increased for the
    fraction of the noise that the poses follow.
    """
    squares, freedom = 0.0, 0.0
    for s in chunks(len(frames.residual)):
        part = slice(s.start, s.stop + 2)
        off = np.where(frames.used[part, :, None], frames.residual[part], np.nan)
        bends = np.sum((off[2:] - 2 * off[1:-1] + off[:-2]) ** 2, axis=2)
        known = np.isfinite(bends)
        squares += float(np.sum(bends[known])) / 6.0
        freedom += 3.0 * float(np.sum((1.0 - frames.leverage[part][1:-1])[known]))
    return max(floor, math.sqrt(squares / freedom)) if freedom >= 1.0 else floor


def estimate_snaps(
    model: ChainModel, frames: FramePoses, dt: float, colour: Colour | None = None, slowest: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fields ``snap``, ``gap_snap`` and ``errors`` of :class:`SpatialNoise`, estimated from ``frames``.

    ``dt`` is the time step, s. The noise is white, or has the power ``colour`` relative to white noise of the same
    variance. ``slowest`` is the least corner of the smoother of a joint, Hz. Without observed frames, the snap is the
    upper end of :data:`SNAP_BOUNDS`.
    """
    series, variance = sum_steps(model, frames.track), frames.variance
    snaps, gaps = np.empty(series.shape[1]), np.empty(series.shape[1])
    errors = np.full((ORDER - 1, series.shape[1]), np.nan)
    # the groups of degrees of freedom with one snap: position and rotation of the base, each ball joint, and each
    # coordinate of other joints
    groups = [(0, slice(0, 3)), (0, slice(3, 6))]
    for k, at in enumerate(model.first[1:].tolist()):
        widths = [3] if model.ball[k] else [1] * int(model.freedom[k])
        groups += [(k + 1, slice(at + c, at + c + width)) for c, width in enumerate(widths)]
    for group, columns in groups:
        seen = frames.observed[:, group]
        starts, size = _find_windows(series[:, columns], seen, dt)
        if not starts.size:
            snaps[columns], gaps[columns] = SNAP_BOUNDS[1], SNAP_BOUNDS[1]
            continue
        numbers = range(columns.start, columns.stop)
        frequency = np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64)
        angular = np.asarray(2 * np.pi * np.fft.rfftfreq(size, dt), dtype=np.float64)
        spectra = [_compute_spectrum(series[:, c], variance[:, c], seen, starts, size) for c in numbers]
        if colour is None:
            spectra = [(_model_fall(power, noise), noise, white) for power, noise, white in spectra]
        else:
            # power of autocorrelated noise; at frequencies too high for movement, all measured power is noise
            shade, high = colour(frequency), frequency > _FASTEST
            spectra = [
                (power, np.where(high, np.maximum(noise * shade, power), noise * shade), white)
                for power, noise, white in spectra
            ]
        trials = np.geomspace(*SNAP_BOUNDS, _TRIALS)[:, None]
        risk = np.zeros(_TRIALS)
        for power, noise, white in spectra:
            passed = 1 / (1 + angular ** (2 * ORDER) * white / trials**2)
            risk += np.sum(passed**2 * power - 2 * passed * (power - noise), axis=1)
        snap = float(trials[np.argmin(risk), 0]) * (1.0 if colour is None else _CAUTION)
        if group:
            snap = max(snap, (2 * math.pi * slowest) ** ORDER * math.sqrt(max(white for _, _, white in spectra)))
        snaps[columns], lasting = snap, 0.0
        for c, (power, noise, white) in zip(numbers, spectra, strict=True):
            corner = (snap**2 / white) ** (1 / (2 * ORDER))
            passed = 1 / (1 + (angular / corner) ** (2 * ORDER))
            # mean squared errors of the series and two derivatives after smoothing
            near = (angular > 0) & (angular < _REACH * corner)  # beyond, the noise exceeds the movement by far
            averages = passed**2 * noise
            lost = np.where(near, (1 - passed) ** 2 * (power - noise), 0.0)
            for order in range(ORDER - 1):
                by = np.zeros(len(angular))
                by[1:] = angular[1:] ** (2.0 * order - 4.0) / dt**4
                errors[order, c] = np.sum(by * averages) + max(float(np.sum(by * lost)), 0.0)
            lasting = max(lasting, float(np.sum(passed**2 * power * angular**4)) / dt**4)
        gaps[columns] = max(snap, _GAP_SHARE * math.sqrt(lasting / dt))
    # The ratio between the two coordinates of a two-axis joint is limited. Without the limit, the snap of a limb's
    # axial rotation would be too large, because sliding skin adds fast motion.
    limited = snaps.copy()
    for k, at in enumerate(model.first[1:].tolist()):
        if not model.ball[k] and model.freedom[k] == 2:
            limited[at : at + 2] = np.minimum(snaps[at : at + 2], _LARGEST_RATIO * snaps[at : at + 2][::-1])
    return limited, gaps, errors


def _model_fall(power: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the measured power, replaced by a smooth model at the frequencies at which it is near that of the noise.

    The power from few windows scatters. If it is by chance twice the power of the noise at a high frequency, it would
    be mistaken for movement. The model therefore begins at the first frequency at which the power of the noise is more
    than a tenth of the measured power. From there, the power is 1 + (c / k)^q times the power of the noise, where k is
    the index of the frequency, and c and q are the likeliest values for a periodogram.
    """
    ratio = power[1:] / noise[1:]
    near = np.flatnonzero(ratio < _NEAR)
    if not near.size:
        return power
    first = int(near[0]) + 1
    k = np.arange(first, len(power))
    crossings = np.geomspace(0.25, len(power), _CROSSINGS)
    modelled = 1.0 + (crossings[:, None, None] / k) ** _STEEPNESS[:, None]
    loss = np.sum(np.log(modelled) + ratio[first - 1 :] / modelled, axis=2)
    best = modelled[np.unravel_index(np.argmin(loss), loss.shape)]
    return np.concatenate([power[:first], noise[first:] * best])


def _find_windows(series: FloatArray, seen: BoolArray, dt: float) -> tuple[IntArray, int]:
    """Return the first frames of the windows with motion and without gaps, and the length of a window in frames.

    ``series`` (F, c) is one group of degrees of freedom, and ``seen`` (F,) are its observed frames. If no window is
    suitable, the middle window is returned; none if the trial is too short or nothing is observed.
    """
    size = min(round(_WINDOW / dt), len(seen) - 2)
    if size < _LEAST or not seen.any():
        return np.empty(0, dtype=np.int64), size
    # samples in motion or near motion; in a short trial all samples
    moving, half = seen, max(round(_AROUND / dt / 2), 1)
    if len(series) >= 8 * half:
        speed = np.zeros(len(series))
        speed[half:-half] = np.linalg.norm(series[2 * half :] - series[: -2 * half], axis=1)
        fast = speed > _STILL * np.sqrt(np.mean(speed[seen] ** 2))
        moving = seen & (np.convolve(fast, np.ones(4 * half + 1), mode="same") > 0)
    starts = np.arange(0, len(seen) - 1 - size, max(size // 2, 1))
    good = [moving[k : k + size + 2].mean() > _MOSTLY and seen[k : k + size + 2].all() for k in starts]
    kept = starts[np.array(good, dtype=np.bool_)]
    if not kept.size:
        kept = np.array([max((len(seen) - 2 - size) // 2, 0)])
    return kept[np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).round().astype(np.int64)], size


def _compute_spectrum(
    series: FloatArray, variance: FloatArray, seen: BoolArray, starts: IntArray, size: int
) -> tuple[FloatArray, FloatArray, float]:
    """Return the power of the second differences, the power of their noise, and the noise variance of the series.

    Over the frequencies, the powers add up to variances. ``variance`` (F,) is the variance expected from the markers.
    """
    filled = np.interp(np.arange(len(series)), np.flatnonzero(seen), series[seen])
    bends = np.diff(filled, 2)
    windows = np.stack([bends[k : k + size] for k in starts])
    taper = np.hanning(size)
    taper /= np.sqrt(np.sum(taper**2) * size / 2)
    power = np.mean(np.abs(np.fft.rfft((windows - windows.mean(axis=1, keepdims=True)) * taper)) ** 2, axis=0)
    shape = (2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(size))) ** 2 * np.sum(taper**2)
    top = slice(len(shape) // 2, None)  # a poor geometry in some postures has more noise than the median
    white = max(float(np.median(variance[seen])), float(np.sum(power[top]) / np.sum(shape[top])))
    return power, white * shape, white
