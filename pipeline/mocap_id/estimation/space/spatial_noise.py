"""Marker and process noise of a chain in space, from the poses of single frames.

The steps between frames, in each segment's own axes, sum up to one series for each degree of freedom. A series is
movement and white noise of known variance r. A snap of standard deviation s over one frame gives the smoother
H = 1 / (1 + (w / w0)^8) with w0^8 = s² / r. The snap is chosen for the least squared error of the smoothed
acceleration,

    sum over frequencies of H² I − 2 H (I − N),

up to a constant, with the power I of the measured acceleration and the power N of its noise. Where I comes near N, the
movement is taken to fall steadily. The likelihood of white snap, in contrast, is misled by slow movement, which has
less power than white snap would give it. Only moving samples count, because a still start would suggest less snap than
the movement has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.space.chain_model import summed_steps
from mocap_id.estimation.space.frame_poses import FramePoses
from mocap_id.estimation.space.space_kernels import ChainModel

SNAP_BOUNDS = (1e-1, 1e6)
"""Search range of the snap's standard deviation over one frame, rad/s⁴ or m/s⁴."""

_MOST_ALIKE = 2.0  # ratio of the snaps of two coordinates of one joint
_STILL = 0.3  # of the rms speed; slower samples do not count
_AROUND = 0.25  # s, about a moving sample, that count too
_WINDOW = 4.0  # s
_MOST = 100  # windows
_MOSTLY = 0.5  # share of moving samples in a window
_GAP_SHARE = 0.36  # s^½; with it, white snap and a constant snap err alike after 0.3 s
_REACH = 1.9  # times the corner
_CAUTION = 1.3  # times the best snap where the noise has a memory: fast movement needs more than the average
_LEAST = 16  # frames of a window
_FASTEST = 4.0  # Hz, of movement that is larger than noise with a memory
_NEAR = 10.0  # ratio of the powers of measurement and noise below which the movement's is modelled
_STEEPNESS = np.array([4.0, 6.0, 8.0, 12.0, 16.0])  # of the fall of movement against noise; 4 is a constant movement
_CROSSINGS = 80  # frequencies at which both may be equal
_TRIALS = 120  # values of the snap


Colour: TypeAlias = Callable[[FloatArray], FloatArray]
"""Power of noise at frequencies (K,), Hz, relative to white noise of the same variance."""


@dataclass(frozen=True)
class SpatialNoise:
    """Noise of the filter.

    Parameters
    ----------
    camera_sd : float
        Standard deviation of a marker's white noise, per coordinate, m.
    marker_sd : (M,) array
        The same with the lasting error of the skin, for each marker, m.
    snap : (d,) array
        Standard deviation of the snap of each degree of freedom, held over one frame, rad/s⁴ or m/s⁴.
    gap_snap : (d,) array
        The same where a joint is bridged: a movement's snap lasts, so extrapolations err more than white snap says.
    errors : (3, d) array
        Mean squared error of pose, velocity and acceleration from white noise and from movement that is not passed; NaN
        if unknown.
    """

    camera_sd: float
    marker_sd: FloatArray
    snap: FloatArray
    gap_snap: FloatArray
    errors: FloatArray


def camera_noise(frames: FramePoses, floor: float) -> float:
    """Return the standard deviation (m) of the markers' white noise, at least ``floor``.

    Second differences of the residuals remove lasting errors, and the share that the pose follows is added.
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


def process_noise(
    model: ChainModel, frames: FramePoses, dt: float, colour: Colour | None = None, slowest: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return snap and gap_snap (d,) of each degree of freedom, and the mean squared errors (3, d) that remain.

    Parameters
    ----------
    model : ChainModel
    frames : FramePoses
    dt : float
        Time step, s.
    colour : callable, optional
        Power of the noise at frequencies (K,), Hz, relative to white noise of the same variance; white by default.
    slowest : float
        Least corner of the smoother of a joint, Hz.
    """
    series, variance = summed_steps(model, frames.track), frames.variance
    snaps, gaps = np.empty(series.shape[1]), np.empty(series.shape[1])
    errors = np.full((ORDER - 1, series.shape[1]), np.nan)
    for group, columns in _groups(model):
        seen = frames.observed[:, group]
        starts, size = _windows(seen & _moving(series[:, columns], seen, dt), seen, dt)
        if not starts.size:
            snaps[columns], gaps[columns] = SNAP_BOUNDS[1], SNAP_BOUNDS[1]
            continue
        spectra = [
            _spectrum(series[:, c], variance[:, c], seen, starts, size) for c in range(columns.start, columns.stop)
        ]
        turning = np.asarray(2 * np.pi * np.fft.rfftfreq(size, dt), dtype=np.float64)
        if colour is not None:
            frequency = np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64)
            spectra = [(power, _shaded(power, noise, frequency, colour), white) for power, noise, white in spectra]
        else:
            spectra = [(_falling(power, noise), noise, white) for power, noise, white in spectra]
        trials = np.geomspace(*SNAP_BOUNDS, _TRIALS)[:, None]
        risk = np.zeros(_TRIALS)
        for power, noise, white in spectra:
            passed = 1 / (1 + turning ** (2 * ORDER) * white / trials**2)
            risk += np.sum(passed**2 * power - 2 * passed * (power - noise), axis=1)
        snap = float(trials[np.argmin(risk), 0]) * (1.0 if colour is None else _CAUTION)
        if group:
            snap = max(snap, (2 * math.pi * slowest) ** ORDER * math.sqrt(max(white for _, _, white in spectra)))
        snaps[columns], lasting = snap, 0.0
        for c, (power, noise, white) in zip(range(columns.start, columns.stop), spectra, strict=True):
            corner = (snap**2 / white) ** (1 / (2 * ORDER))
            errors[:, c] = _errors(power, noise, turning, corner, dt)
            passed = 1 / (1 + (turning / corner) ** (2 * ORDER))
            lasting = max(lasting, float(np.sum(passed**2 * power * turning**4)) / dt**4)
        gaps[columns] = max(snap, _GAP_SHARE * math.sqrt(lasting / dt))
    return _alike(model, snaps), gaps, errors


def _falling(power: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the power with a steady fall of the movement's where it comes near the noise's.

    The power from few windows scatters. Where it is by chance twice that of the noise, at a high frequency, movement
    would seem to be there. From the first frequency at which the noise has a tenth of it, the power is therefore
    1 + (c / k)^q times that of the noise at frequency k, with the likeliest c and q for a periodogram.
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


def _shaded(power: FloatArray, noise: FloatArray, frequency: FloatArray, colour: Colour) -> FloatArray:
    """Return the power of autocorrelated noise; at frequencies too high for movement, all power is noise."""
    coloured = noise * colour(frequency)
    return np.where(frequency > _FASTEST, np.maximum(coloured, power), coloured)


def _alike(model: ChainModel, snaps: FloatArray) -> FloatArray:
    """Return the snaps (d,), with a limited ratio between both coordinates of a joint of two axes.

    If skin slides fast, the twist of a limb has more noise than its markers suggest.
    """
    found = snaps.copy()
    for k, at in enumerate(model.first[1:].tolist()):
        if not model.ball[k] and model.freedom[k] == 2:
            found[at : at + 2] = np.minimum(snaps[at : at + 2], _MOST_ALIKE * snaps[at : at + 2][::-1])
    return found


def _errors(power: FloatArray, noise: FloatArray, turning: FloatArray, corner: float, dt: float) -> FloatArray:
    """Return the mean squared errors (3,) of a series and its derivatives, smoothed up to a corner, rad/s."""
    passed = 1 / (1 + (turning / corner) ** (2 * ORDER))
    near = (turning > 0) & (turning < _REACH * corner)  # beyond, the movement's power drowns in the noise's
    averages = passed**2 * noise
    lost = np.where(near, (1 - passed) ** 2 * (power - noise), 0.0)
    found = np.empty(ORDER - 1)
    for order in range(ORDER - 1):
        by = np.zeros(len(turning))
        by[1:] = turning[1:] ** (2.0 * order - 4.0) / dt**4
        found[order] = np.sum(by * averages) + max(float(np.sum(by * lost)), 0.0)
    return found


def _groups(model: ChainModel) -> list[tuple[int, slice]]:
    """Return the columns that share one snap: position, rotation, ball, or a single coordinate; and their joint."""
    groups = [(0, slice(0, 3)), (0, slice(3, 6))]
    for k, at in enumerate(model.first[1:].tolist()):
        if model.ball[k]:
            groups.append((k + 1, slice(at, at + 3)))
        else:
            groups += [(k + 1, slice(at + c, at + c + 1)) for c in range(int(model.freedom[k]))]
    return groups


def _moving(series: FloatArray, seen: BoolArray, dt: float) -> BoolArray:
    """Return samples (F,) faster than a share of the rms speed, and those around them; all of a short trial."""
    half = max(round(_AROUND / dt / 2), 1)
    if len(series) < 8 * half:
        return np.ones(len(series), dtype=np.bool_)
    speed = np.zeros(len(series))
    speed[half:-half] = np.linalg.norm(series[2 * half :] - series[: -2 * half], axis=1)
    known = speed[seen]
    if not known.size:
        return np.ones(len(series), dtype=np.bool_)
    fast = speed > _STILL * np.sqrt(np.mean(known**2))
    around = np.convolve(fast, np.ones(4 * half + 1), mode="same") > 0
    return np.asarray(around, dtype=np.bool_)


def _windows(moving: BoolArray, seen: BoolArray, dt: float) -> tuple[IntArray, int]:
    """Return the first frames of windows with movement and without gaps (else the middle one), and their length."""
    size = min(round(_WINDOW / dt), len(seen) - 2)
    if size < _LEAST or not seen.any():
        return np.empty(0, dtype=np.int64), size
    starts = np.arange(0, len(seen) - 1 - size, max(size // 2, 1))
    good = [moving[k : k + size + 2].mean() > _MOSTLY and seen[k : k + size + 2].all() for k in starts]
    kept = starts[np.array(good, dtype=np.bool_)]
    if not kept.size:
        kept = np.array([max((len(seen) - 2 - size) // 2, 0)])
    return kept[np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).round().astype(np.int64)], size


def _spectrum(
    series: FloatArray, variance: FloatArray, seen: BoolArray, starts: IntArray, size: int
) -> tuple[FloatArray, FloatArray, float]:
    """Return the power of the second differences, that of their noise, and the white variance of the series.

    The powers sum up to variances over the frequencies.
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
