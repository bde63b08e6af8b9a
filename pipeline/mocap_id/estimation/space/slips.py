"""Displacements of markers on the skin while they are missing, so that the pose does not jump when a marker vanishes.

The method is the same as in :mod:`mocap_id.estimation.dropouts`: a missing marker is assumed to keep the residual that
it has beside the gap. This residual decays with the time constant of the skin and still contributes to the pose.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.dropouts import PAIRS, SKIN_MEMORY, find_gaps, split_variance

_SLOW = 0.15  # s, length of a moving average; three of them pass less than half of the amplitude above 2 Hz


def estimate_slips(residual: FloatArray, used: BoolArray, rate: float) -> FloatArray:
    """Return the expected displacement (F, M, 3) of every marker where it is not used, m; zero elsewhere.

    ``residual`` (F, M, 3) is in the segment's axes, m. ``used`` (F, M) is true where a marker is used.
    """
    slips = np.zeros(residual.shape)
    for m in np.flatnonzero(~used.all(axis=0) & used.any(axis=0)).tolist():
        own, there = residual[:, m], used[:, m]
        gaps = find_gaps(there, SKIN_MEMORY * rate)
        lasting, noise = _split_variance(own, there)
        slips[gaps.missing, m] = gaps.bridge(*(_shrink_mean(own, there, at, lasting, noise) for at in gaps.beside))
    return slips


def remove_fast_part(series: FloatArray, rate: float, seconds: float = _SLOW) -> FloatArray:
    """Return series (F, …) smoothed by three moving averages over ``seconds``; ``rate`` is in samples per second."""
    half = max(round(seconds * rate / 2), 1)
    slow, every = series, np.arange(len(series))
    low, high = np.maximum(every - half, 0), np.minimum(every + half + 1, len(series))
    count = (high - low).reshape(-1, *[1] * (series.ndim - 1))
    for _ in range(3):
        total = np.concatenate([np.zeros((1, *slow.shape[1:])), np.cumsum(slow, axis=0)])
        slow = (total[high] - total[low]) / count
    return slow


def _split_variance(own: FloatArray, there: BoolArray) -> tuple[float, float]:
    pairs = np.flatnonzero(there[1:] & there[:-1])
    if not pairs.size:
        return 0.0, 1.0
    pairs = pairs[:: max(1, len(pairs) // PAIRS)]
    return split_variance(own[pairs], own[pairs + 1])


def _shrink_mean(own: FloatArray, there: BoolArray, at: IntArray, lasting: float, noise: float) -> FloatArray:
    """Return the mean residual (G, 3) over the b frames ``at`` (G, b), reduced towards zero according to its noise.

    ``own`` (F, 3) are the residuals of a marker, used in the frames ``there`` (F,). The mean is NaN if none is used.
    """
    seen = (at >= 0) & there[at]
    count = seen.sum(axis=1, keepdims=True)
    total = np.where(seen[..., None], own[at], 0.0).sum(axis=1)
    return np.where(count > 0, lasting * total / np.maximum(count * lasting + noise, np.finfo(np.float64).tiny), np.nan)
