"""Standard deviations of the states from camera noise, coloured residuals, and lasting errors of skin and chain.

Lasting errors are equal or similar in many frames. The filter treats all residuals of the chain as white noise. Most of
them are due to skin, whose displacements average out slowly or not at all. The filter's variance is therefore reduced
to camera noise alone, and the variance of the lasting errors is added.

The filter's variance also includes the movement beyond the smoother's pass band, assuming a movement driven by white
snap. For a fourfold integrator observed in white noise, the smoother has the frequency response H = 1 / (1 + (w /
w0)^8). Of the variance of derivative d, the fraction 1 - (2 d + 1) / 8 is noise that the smoother passes, and the rest
is movement that it does not pass. This rest is estimated from the movement itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, as_complex, as_xy, chunks, interpolate_gaps
from mocap_id.estimation.filter_problem import ORDER
from mocap_id.estimation.noise import compute_angle_covariance, find_observed_angles
from mocap_id.estimation.smoothing import States, compute_forgotten_share
from mocap_id.geometry.planar import marker_jacobian, segment_poses

_RIDGE = 1e-9  # added to the diagonal of the regression, relative to it, for angles that do not move
_LEAST = 10  # frames per unknown of a regression


def list_residuals(states: States, used_markers: FloatArray) -> Iterator[tuple[int, ComplexArray, BoolArray]]:
    """Yield for each marker with enough samples: its index, its residual (F,), m, and whether each frame uses it.

    The residual is the difference from the position that the chain predicts, x + 1j y in the segment's axes,
    interpolated in gaps. The part that is a quadratic function of the joint angles is removed, because it is attributed
    to sliding skin (:mod:`mocap_id.kinematics.skin_slides`). ``used_markers`` (F, M, 2) are the markers used for the
    states, plane frame, m; NaN elsewhere.
    """
    chain, angles = states.chain, states.mean[..., 0]
    # linear and quadratic functions (F, P) of the angles; zero in frames in which an angle is missing
    given = np.isfinite(angles)
    centred = angles - np.sum(angles, axis=0, where=given) / np.maximum(np.sum(given, axis=0), 1)
    products = [centred[:, i] * centred[:, j] for i in range(centred.shape[1]) for j in range(i, centred.shape[1])]
    basis = np.column_stack([np.ones(len(centred)), centred, *products])
    del given, centred, products  # large in a long recording
    basis[~np.isfinite(basis).all(axis=1)] = 0
    basis = np.asarray(basis / np.sqrt(np.mean(basis**2, axis=0) + 1e-30))
    rotation, origin = segment_poses(angles, chain.centres)
    every, whole = np.arange(len(rotation)), basis.T @ basis
    for segment in np.unique(chain.segment):
        back, start = np.exp(-1j * rotation[:, segment]), as_complex(origin[:, segment])
        for k in np.flatnonzero(chain.segment == segment):
            off = (as_complex(used_markers[:, k]) - start) * back - complex(*chain.local[k])
            seen: BoolArray = np.isfinite(off)
            if np.count_nonzero(seen) < _LEAST * basis.shape[1]:
                continue
            missing = np.flatnonzero(~seen)
            off[missing] = 0
            square = whole - basis[missing].T @ basis[missing] + _RIDGE * len(basis) * np.eye(basis.shape[1])
            off -= as_complex(basis @ np.linalg.solve(square, basis.T @ as_xy(off)))
            if missing.size:
                off[missing] = np.interp(missing, every[seen], off[seen])
            yield int(k), off, seen


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
        f, power = self.frequency, self.power
        if not len(f):
            return None
        if len(power) >= _NEIGHBOURS:  # average over neighbouring frequencies
            ones = np.ones(_NEIGHBOURS)
            power = np.convolve(power, ones, "same") / np.convolve(np.ones_like(power), ones, "same")
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
    def oscillations(self) -> tuple[tuple[int, float, float], ...]:
        """Strongest oscillation of each segment whose markers oscillate together.

        It is a narrow peak in the spectrum of their common displacement: the segment, 1 … n, the frequency, Hz, and the
        rms displacement that remains in the residuals, m.
        """
        found = []
        for k in range(self.shift.shape[1]):
            windows = list(_spectra(self.shift[:, k], self.rate, None))
            if not windows:
                continue
            f, power = _list_frequencies(len(self.shift), self.rate), np.mean(windows, axis=0)
            # the clearest narrow peak, if it is high enough above the power beside it
            best, peak = _PEAK, None
            for i in np.flatnonzero((f >= _RANGE[0]) & (f <= min(_RANGE[1], f[-1] / 2))):
                ratio = f / f[i]
                beside = [power[(ratio > 1 / 2) & (ratio < 1 / 1.4)], power[(ratio > 1.4) & (ratio < 2)]]
                if all(np.any(side) for side in beside):
                    clear = power[i] / max(float(np.mean(side)) for side in beside)
                    if clear > best:
                        best, peak = clear, float(f[i])
            if peak is not None:
                near = (f > peak / _HALF_WIDTH) & (f < peak * _HALF_WIDTH)
                found.append((k + 1, peak, float(np.sqrt(2 * np.sum(power[near]) * (f[1] - f[0])))))
        return tuple(found)

    def oscillating_variance(self, frames: IntArray) -> FloatArray:
        """Return the variances (T, n, 4) of the states due to oscillations, which are equal in all ``frames`` (T,)."""
        count, n = self.rotation.shape
        if not self.oscillations:
            return np.zeros((len(frames), n, ORDER))
        twice = np.concatenate([self.rotation, self.rotation[::-1]])
        f = np.fft.rfftfreq(2 * count, 1 / self.rate)
        inside = np.zeros(len(f), dtype=np.bool_)
        for _, peak, _ in self.oscillations:
            inside |= (f > peak / _HALF_WIDTH) & (f < peak * _HALF_WIDTH)
        power = 2 * np.abs(np.fft.rfft(np.diff(twice, axis=1, prepend=0.0), axis=0)[inside]) ** 2 / (2 * count) ** 2
        turning = 2 * np.pi * f[inside, None]
        variance = [np.sum(turning ** (2 * order) * power, axis=0) for order in range(ORDER)]
        return np.broadcast_to(np.stack(variance, axis=1), (len(frames), n, ORDER))


def compute_residual_spectrum(states: States, used_markers: FloatArray, rate: float) -> ResidualSpectrum:
    """Return the spectrum of the residuals of :func:`list_residuals`; ``rate`` is in frames per second."""
    chain, count = states.chain, len(used_markers)
    n, local = len(chain.centres), as_complex(chain.local)
    shift, rotation = np.zeros((count, n), dtype=np.complex128), np.zeros((count, n))
    windows, each = list[FloatArray](), max(_MOST // len(local), 1)
    for k, off, seen in list_residuals(states, used_markers):
        own = local[chain.segment == chain.segment[k]]
        j, square = chain.segment[k] - 1, float(np.sum(np.abs(own - own.mean()) ** 2))
        shift[:, j] += off / len(own)
        if square > _LEAST_SPREAD**2 * len(own):
            rotation[:, j] += (np.conj(local[k] - own.mean()) * off).imag / square
        windows += _spectra(off, rate, seen, each)
    frequency = _list_frequencies(count, rate) if windows else np.empty(0)
    power = np.median(windows, axis=0) if windows else np.empty(0)
    return ResidualSpectrum(rate, frequency, power, shift, rotation)


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


_DERIVATIVES = (1, 2)  # the angle has errors from skin and slow drift only; the jerk has no column in the table
_POSTURES = 100
_LEAST_LEFT = 0.2  # smallest fraction of a marker's error that remains in its residual
_BAND = 3.0  # times f0; nothing passes above this frequency
_MEMORY = 0.5  # s; standard deviation of the window of the mean squares


def estimate_coloured_variance(
    states: States, used_markers: FloatArray, angles: FloatArray, frames: IntArray, *, rate: float, camera: float
) -> FloatArray:
    """Return the variances (T, n, 4) of velocity and acceleration due to residuals that exceed white camera noise.

    The variances of angle and jerk are zero. ``used_markers`` and ``rate`` are as for
    :func:`compute_residual_spectrum`. ``angles`` (F, n) are the joint angles, rad, without gaps; ``frames`` (T,) are
    the frames of the variances; ``camera`` is the standard deviation of a coordinate due to camera noise, m.
    """
    count, n = angles.shape
    frequency = 2 * np.pi * np.fft.fftfreq(2 * count, 1 / rate)
    corners = np.array([compute_corner(np.nanmedian(states.sd[:, j] ** 2, axis=0)) for j in range(n)])[:, None, None]
    orders = np.array(_DERIVATIVES)[:, None]
    passing = (1j * frequency) ** orders / (1 + (frequency / corners) ** (2 * ORDER))
    bins = min(count, max(int(_BAND * corners.max() / (np.pi * rate) * count), 2))
    kept = np.r_[0:bins, -bins:0]
    white = camera**2 * np.mean(np.abs(passing) ** 2, axis=2)
    passing = passing[..., kept] * (bins / count)
    times = np.arange(2 * bins) * count / bins  # of the samples kept, in frames; the second half is the reversal
    # squared gains (M, n, f), rad²/m², in some frames. The angles follow a part of a marker's error, which its residual
    # does not contain; the gains are increased accordingly.
    postures = np.unique(np.linspace(0, count - 1, _POSTURES).round().astype(np.int64))
    often = states.used.mean(axis=0)
    jacobian = marker_jacobian(angles[postures], states.chain.centres, states.chain.segment, states.chain.local)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, often)
    follows = np.einsum("fkl,fmil->kfmi", np.linalg.inv(normal), jacobian)
    own = np.einsum("fmik,kfmi->m", jacobian, follows) / len(postures) / 2
    squared = np.sum(follows**2, axis=3) * often / np.maximum(1 - own, _LEAST_LEFT)
    gains = np.ascontiguousarray(squared.transpose(2, 0, 1))
    back = np.minimum(times, 2 * count - 1 - times).clip(0)
    at = np.searchsorted(postures, back).clip(1, len(postures) - 1)
    share = ((back - postures[at - 1]) / (postures[at] - postures[at - 1])).clip(0, 1)
    beyond = np.zeros((n, len(_DERIVATIVES), 2 * bins))
    for k, off, _ in list_residuals(states, used_markers):
        passed = np.fft.ifft(passing * np.fft.fft(np.concatenate([off, off[::-1]]))[kept])
        gain = gains[k][:, at - 1] * (1 - share) + gains[k][:, at] * share
        beyond += gain[:, None] * (np.abs(passed) ** 2 / 2 - white[..., None])
    around = np.exp(-0.5 * (2 * np.pi * np.fft.rfftfreq(2 * bins, count / bins / rate) * _MEMORY) ** 2)
    local = np.fft.irfft(np.fft.rfft(beyond) * around, 2 * bins)
    variance = np.zeros((len(frames), n, ORDER))
    for j in range(n):
        for i, d in enumerate(_DERIVATIVES):
            variance[:, j, d] = np.maximum(np.interp(frames, times, local[j, i]), 0)
    return variance


_LEAST_SLIDE = 1e-5  # m; least rms displacement
_ENOUGH = 4000  # frames, spread evenly over the trial, from which the rms displacements are estimated


def compute_variance_growth(
    states: States, used_markers: FloatArray, angles: FloatArray, frames: IntArray, *, rate: float, camera: float
) -> FloatArray:
    """Return the factor (T, n), at least 1, by which missing markers increase the variance of errors from skin.

    It is 1 where the markers do not determine an angle, because the filter's own variance covers this case. The
    arguments are as for :func:`estimate_coloured_variance`.
    """
    used, chain = states.used, states.chain
    often = used.mean(axis=0)
    # mean square (M,) of each marker's residual per coordinate without camera noise, m^2
    squares, count = np.zeros(used_markers.shape[1]), np.zeros(used_markers.shape[1])
    spread = np.arange(0, len(used_markers), max(1, len(used_markers) // _ENOUGH))
    for block in chunks(len(spread)):
        off = used_markers[spread[block]] - states.predicted_in(spread[block])
        known = np.isfinite(off)
        squares += np.where(known, off**2, 0.0).sum(axis=(0, 2))
        count += known.sum(axis=(0, 2))
    slide = np.asarray(np.maximum(squares / np.maximum(count, 1) - camera**2, _LEAST_SLIDE**2))
    forgotten = compute_forgotten_share(used, frames, rate)
    factor = np.ones((len(frames), angles.shape[1]))
    some = np.flatnonzero(~used[frames][:, often > 0].all(axis=1))
    for chunk in chunks(len(some)):
        part = some[chunk]
        at = frames[part]
        jacobian = marker_jacobian(angles[at], chain.centres, chain.segment, chain.local)
        factor[part] = _compute_growth(
            jacobian, used[at], often=often, slide=slide, forgotten=forgotten[part], marker_sd=states.marker_sd
        )
    return factor


def _compute_growth(
    jacobian: FloatArray,
    used: BoolArray,
    *,
    often: FloatArray,
    slide: FloatArray,
    forgotten: FloatArray,
    marker_sd: float,
) -> FloatArray:
    """Return the factor (f, n) in f frames, from the Jacobians (f, M, 2, n) of the markers.

    ``used`` (f, M) marks the used markers. ``often`` (M,) is the fraction of frames that use each marker, ``slide``
    (M,) the mean square of its displacement, m^2, and ``forgotten`` (f, M) the fraction of this that is unknown.
    """
    own = np.einsum("fmik,fmil->fmkl", jacobian, jacobian)  # (f, M, n, n)
    seen = np.einsum("fm,fmkl->fkl", used, own)
    observed = find_observed_angles(compute_angle_covariance(seen, marker_sd))
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.where(both, np.linalg.inv(np.where(both, seen, np.eye(seen.shape[1]))), 0.0)
    usual = np.linalg.inv(np.einsum("m,fmkl->fkl", often, own))
    now, usually = (
        np.einsum("fjk,fkl,flj->fj", left, np.einsum("fm,fmkl->fkl", weight * slide, own), left)
        for left, weight in ((inverse, used), (usual, np.broadcast_to(often**2, used.shape)))
    )
    share = np.einsum("fkl,fmkl->fm", usual, own) * often * ~used
    mean_forgotten = np.sum(share * forgotten, axis=1) / np.sum(share, axis=1)
    return np.asarray(1.0 + mean_forgotten[:, None] * np.where(observed, np.maximum(now / usually - 1.0, 0.0), 0.0))


_WITHHELD = (2 * np.arange(ORDER) + 1) / (2 * ORDER)
"""Fraction of each derivative's variance that is movement which the smoother does not pass."""

_TWICE = _WITHHELD - 1 + (2 - _WITHHELD) * (3 - _WITHHELD) / 6
"""Fraction of the passed noise that a second smoothing removes: integral of H^2 (1 - H)^2 over integral of H^2."""


def estimate_camera_sd(used_markers: FloatArray, states: States, floor: float) -> float:
    """Return the standard deviation, m, of the markers' white noise, between ``floor`` and the filter's marker noise.

    It is estimated from second differences of the residuals, which remove lasting errors; it is the filter's marker
    noise if no marker is used in three successive frames.
    """
    squares, count = 0.0, 0
    for s in chunks(len(used_markers)):
        part = slice(s.start, s.stop + 2)  # overlaps the next chunk by two frames
        off = used_markers[part] - states.predicted_in(part)
        bends = off[2:] - 2 * off[1:-1] + off[:-2]
        known = bends[np.isfinite(bends)]
        squares, count = squares + float(np.sum(known**2)), count + known.size
    if count == 0:
        return states.marker_sd
    return min(states.marker_sd, max(floor, float(np.sqrt(squares / count / 6))))


def add_lasting_errors(states: States, rate: float, camera: float, frames: IntArray, lasting: FloatArray) -> FloatArray:
    """Return the standard deviations (F, n, 4) of the states with lasting errors, which do not average out.

    ``camera`` is the camera noise of a coordinate, m, which does. ``lasting`` (T, n, 4) are the variances of the errors
    from skin and the chain's geometry in the ascending ``frames`` (T,); ``rate`` is in frames per second.
    """
    sd, every = np.empty_like(states.sd), np.arange(len(states.sd))
    for joint in range(sd.shape[1]):
        variance: FloatArray = states.sd[:, joint] ** 2
        steady = np.median(variance, axis=0)  # (4,); gaps and ends have more
        white = np.minimum(variance, steady) * (1 - _WITHHELD) * (camera / states.marker_sd) ** 2
        # mean square of the movement that a second smoothing removes, averaged around each frame; the interpolated
        # angles are followed by their reversal, so that the series is periodic
        filled = interpolate_gaps(states.mean[:, joint, :1])[:, 0]
        extended, w0 = np.concatenate([filled, filled[::-1]]), compute_corner(steady)
        frequency = 2 * np.pi * np.fft.rfftfreq(len(extended), 1 / rate)
        stopped = np.fft.rfft(extended) * (1 - 1 / (1 + (frequency / w0) ** (2 * ORDER)))
        memory, removed = np.exp(-0.5 * (frequency / w0) ** 2), np.empty_like(white)
        for order in range(ORDER):
            part = np.fft.irfft((1j * frequency) ** order * stopped, len(extended))
            removed[:, order] = np.fft.irfft(np.fft.rfft(part**2) * memory, len(extended))[: len(sd)]
        total = white + np.maximum(variance - steady, 0) + np.maximum(removed - _TWICE * white, 0)
        for order in range(ORDER):
            total[:, order] += np.interp(every, frames, lasting[:, joint, order])
        sd[:, joint] = np.sqrt(total)
    return sd


def compute_corner(steady: FloatArray) -> float:
    """Return the corner w0 of the smoother of a joint, rad/s, from its variances (4,) of angle and acceleration."""
    ratio = np.sin(5 * np.pi / 8) / np.sin(np.pi / 8) * steady[2] / steady[0]
    return float(ratio**0.25)
