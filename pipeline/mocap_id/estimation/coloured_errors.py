"""Errors of velocity and acceleration from residuals that are neither white noise nor sliding skin.

A marker's residual e with the power spectrum S(f) causes an error of joint j's derivative d with the variance

    sum over the markers of a_jk times the integral of (2 pi f)^(2 d) S_k(f) H_j(f)^2 df,

where a_jk is the squared gain from marker k to joint j in A = (JᵀJ)⁻¹Jᵀ, J is the Jacobian of the markers, and H = 1 /
(1 + (f / f0)^8) is the frequency response of the smoother. The integral is evaluated in time, as a local mean square of
the filtered residuals. Noise at rest is therefore not mixed with the larger errors of skin during movement.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.lasting_errors import compute_corner
from mocap_id.estimation.process_model import ORDER
from mocap_id.geometry.planar import marker_jacobian

_DERIVATIVES = (1, 2)  # the angle has errors from skin and slow drift only; the jerk has no column in the table
_POSTURES = 100
_LEAST_LEFT = 0.2  # smallest fraction of a marker's error that remains in its residual
_BAND = 3.0  # times f0; nothing passes above this frequency
_MEMORY = 0.5  # s; standard deviation of the window of the mean squares


def estimate_coloured_variance(
    residuals: ChainResiduals, angles: FloatArray, frames: IntArray, camera: float
) -> FloatArray:
    """Return the variances (T, n, 4) of velocity and acceleration due to residuals that exceed white camera noise.

    The variances of angle and jerk are zero. ``angles`` (F, n) are the joint angles, rad, without gaps; ``frames`` (T,)
    are the frames of the variances; ``camera`` is the standard deviation of a coordinate due to camera noise, m.
    """
    states, rate = residuals.states, residuals.rate
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
    postures, gains = _compute_gains(residuals, angles)
    back = np.minimum(times, 2 * count - 1 - times).clip(0)
    at = np.searchsorted(postures, back).clip(1, len(postures) - 1)
    share = ((back - postures[at - 1]) / (postures[at] - postures[at - 1])).clip(0, 1)
    beyond = np.zeros((n, len(_DERIVATIVES), 2 * bins))
    for k, off, _ in residuals.columns():
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


def _compute_gains(residuals: ChainResiduals, angles: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return frames (f,) spread over the trial, and the squared gains a_jk (M, n, f) in these frames, rad²/m².

    The angles follow a part of a marker's error, which its residual does not contain. The gains are increased
    accordingly.
    """
    states = residuals.states
    some = np.unique(np.linspace(0, len(angles) - 1, _POSTURES).round().astype(np.int64))
    often = states.used.mean(axis=0)
    jacobian = marker_jacobian(angles[some], states.chain.centres, states.chain.segment, states.chain.local)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, often)
    gain = np.einsum("fkl,fmil->kfmi", np.linalg.inv(normal), jacobian)
    own = np.einsum("fmik,kfmi->m", jacobian, gain) / len(some) / 2
    squared = np.sum(gain**2, axis=3) * often / np.maximum(1 - own, _LEAST_LEFT)
    return some, np.ascontiguousarray(squared.transpose(2, 0, 1))
