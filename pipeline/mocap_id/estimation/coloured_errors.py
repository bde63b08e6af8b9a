"""Errors of velocity and acceleration from residuals that are neither white nor sliding skin.

A marker's residual e with the power spectrum S(f) causes an error of joint j's derivative d with the variance

    sum over the markers of a_jk times the integral of (2 pi f)^(2 d) S_k(f) H_j(f)^2 df,

where a_jk is the squared gain of A = (JᵀJ)⁻¹Jᵀ and H = 1 / (1 + (f / f0)^8) is the smoother. It is evaluated in time,
as the mean square of the filtered residuals, because noise at rest counts even if skin moves more in the movement.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.lasting_errors import corner
from mocap_id.estimation.process_model import ORDER
from mocap_id.geometry.planar import marker_jacobian

_DERIVATIVES = (1, 2)  # the angle's errors are those of skin and wander; the jerk has no column in the table
_POSTURES = 50
_LEAST_LEFT = 0.2  # smallest share of a marker's error that is left in its residual
_BAND = 3.0  # times f0, beyond which nothing passes
_MEMORY = 0.5  # s; standard deviation of the window of the mean squares


def coloured_variance(residuals: ChainResiduals, angles: FloatArray, frames: IntArray, camera: float) -> FloatArray:
    """Return the variances (T, n, 4) of the states from the markers' residuals beyond white camera noise.

    Parameters
    ----------
    residuals : ChainResiduals
    angles : (F, n) array
        Joint angles of the states, rad, without gaps.
    frames : (T,) int array
    camera : float
        Camera noise of a coordinate, m.
    """
    states, rate = residuals.states, residuals.rate
    count, n = angles.shape
    gain, left = _gains(residuals, angles)
    turning = 2 * np.pi * np.fft.fftfreq(2 * count, 1 / rate)
    corners = [corner(np.nanmedian(states.sd[:, j] ** 2, axis=0)) for j in range(n)]
    bins = min(count, max(int(_BAND * max(corners) / (np.pi * rate) * count), 2))
    kept = np.r_[0:bins, -bins : 0]
    passing = np.array([[turning**d / (1 + (turning / w0) ** (2 * ORDER)) for d in _DERIVATIVES] for w0 in corners])
    phase = np.array([1j**d for d in _DERIVATIVES])[None, :, None]
    squares, counted = np.zeros((n, len(_DERIVATIVES), 2 * bins)), np.zeros(len(left), dtype=np.bool_)
    for k, off, _ in residuals.columns():
        there = np.fft.fft(np.concatenate([off, off[::-1]]))[kept]
        passed = np.fft.ifft(passing[..., kept] * phase * there) * (bins / count)
        squares += (gain[:, k] / left[k])[:, None, None] * np.abs(passed) ** 2 / 2
        counted[k] = True
    white = camera**2 * np.mean(passing**2, axis=2) * gain[:, counted].sum(axis=1)[:, None]
    around = np.exp(-0.5 * (2 * np.pi * np.fft.rfftfreq(2 * bins, count / bins / rate) * _MEMORY) ** 2)
    local = np.fft.irfft(np.fft.rfft(squares) * around, 2 * bins)
    found = np.zeros((len(frames), n, ORDER))
    times = np.arange(2 * bins) * count / bins
    for j in range(n):
        for i, d in enumerate(_DERIVATIVES):
            found[:, j, d] = np.maximum(np.interp(frames, times, local[j, i]) - white[j, i], 0)
    return found


def _gains(residuals: ChainResiduals, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the squared gains a_jk (n, M), rad²/m², and the share of each marker's error left in its residual (M,)."""
    states = residuals.states
    some = np.unique(np.linspace(0, len(angles) - 1, _POSTURES).round().astype(np.int64))
    often = states.used.mean(axis=0)
    jacobian = marker_jacobian(angles[some], states.chain.centres, states.chain.segment, states.chain.local)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, often)
    gain = np.einsum("fkl,fmil->fkmi", np.linalg.inv(normal), jacobian)
    own = np.einsum("fmik,fkmi->m", jacobian, gain) / len(some) / 2
    return np.mean(np.sum(gain**2, axis=3), axis=0) * often, np.maximum(1 - own, _LEAST_LEFT)
