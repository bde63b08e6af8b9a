"""Displacements of markers on the skin while they are missing, so that the pose does not step when one vanishes.

The idea and the bridge are those of :mod:`mocap_id.estimation.dropouts`: a missing marker keeps the residual that it
has beside the gap, which fades with the memory of the skin, and still contributes to the pose.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.dropouts import SKIN_MEMORY, bridge, find_gaps, frames_beside, memories_away

_SLOW = 0.15  # s, of a moving average; three of them pass less than half above 2 Hz
_PAIRS = 1000  # pairs of consecutive frames for the lasting part of a residual


def find_slips(residual: FloatArray, used: BoolArray, rate: float) -> FloatArray:
    """Return the expected displacement (F, M, 3) of every marker where it is not used, m; zero elsewhere.

    Parameters
    ----------
    residual : (F, M, 3) array
        Residual in the segment's frame, m.
    used : (F, M) bool array
    rate : float
        Frames per second.
    """
    slips = np.zeros(residual.shape)
    for m in np.flatnonzero(~used.all(axis=0) & used.any(axis=0)).tolist():
        own, there = residual[:, m], used[:, m]
        edges, missing = find_gaps(there)
        since, until = memories_away(edges, missing, len(own), SKIN_MEMORY * rate)
        gap = np.searchsorted(edges[:, 0], missing, side="right") - 1
        lasting, noise = _variances(own, there)
        before, after = (_shrunk(own, there, side, lasting, noise)[gap] for side in frames_beside(edges, len(own)))
        slips[missing, m] = bridge(before, after, since, until)
    return slips


def slow_part(series: FloatArray, rate: float, seconds: float = _SLOW) -> FloatArray:
    """Return series (F, …) without their fast part, by three moving averages of this length."""
    half = max(round(seconds * rate / 2), 1)
    slow, every = series, np.arange(len(series))
    low, high = np.maximum(every - half, 0), np.minimum(every + half + 1, len(series))
    count = (high - low).reshape(-1, *[1] * (series.ndim - 1))
    for _ in range(3):
        total = np.concatenate([np.zeros((1, *slow.shape[1:])), np.cumsum(slow, axis=0)])
        slow = (total[high] - total[low]) / count
    return slow


def _variances(own: FloatArray, there: BoolArray) -> tuple[float, float]:
    """Return the variances of the part of a residual that persists to the next frame, and of the rest."""
    pairs = np.flatnonzero(there[1:] & there[:-1])
    if not pairs.size:
        return 0.0, 1.0
    pairs = pairs[:: max(1, len(pairs) // _PAIRS)]
    first, second = own[pairs], own[pairs + 1]
    lasting = max(float(np.mean(first * second)), 0.0)
    return lasting, max(float(np.mean(first**2 + second**2)) / 2 - lasting, np.finfo(np.float64).tiny)


def _shrunk(own: FloatArray, there: BoolArray, at: IntArray, lasting: float, noise: float) -> FloatArray:
    """Return the mean residual (G, 3) of frames (G, b), shrunk by its noise; NaN if unseen."""
    seen = (at >= 0) & there[at]
    count = seen.sum(axis=1, keepdims=True)
    total = np.where(seen[..., None], own[at], 0.0).sum(axis=1)
    return np.where(count > 0, lasting * total / np.maximum(count * lasting + noise, np.finfo(np.float64).tiny), np.nan)
