"""Which way a plate's horizontal force points, against the movement that it makes.

Newton's law needs the masses, which are not known; but the markers in each third of the body's height move
as a part of it does, and a mass that is fitted to each and may not be negative settles sizes, not directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_STEP_S = 0.1
"""Accelerations are second differences over this time."""

_CARRIED = 0.6
"""Share of the usual load below which something else, a chair most often, may push too, and to the side."""

_ANGLES = tuple(np.radians(np.arange(-175, 181, 5)).tolist())
_ENOUGH_S = 1.0


@dataclass(frozen=True)
class Turned:
    """Angle about the vertical from the acceleration that the cameras see to the horizontal force.

    Parameters
    ----------
    angle : float
        rad, in (-π, π], in steps of 5°.
    coherence : float
        Share of the force that follows the movement turned so, 0 … 1 (correlation).
    size : float
        rms of the force about its mean, N.
    """

    angle: float
    coherence: float
    size: float


def turned(force: FloatArray, positions: FloatArray, rate: float) -> Turned | None:
    """How far a horizontal force points away from the acceleration of the body that it moves.

    The second difference of a position over a step h is the acceleration, averaged over ± h with the weights of a
    triangle; the force is averaged alike.

    Parameters
    ----------
    force : (F, 3) array
        N, lab axes; NaN where unknown.
    positions : (F, M, 3) array
        m.
    rate : float
        Hz.

    Returns
    -------
    Turned or None
        None where there is too little to compare.
    """
    half, groups = max(1, round(_STEP_S * rate)), _by_height(positions)
    if len(positions) < 4 * half or not groups or not np.isfinite(force).any():
        return None
    bent = (positions[2 * half :] - 2 * positions[half:-half] + positions[: -2 * half]) * (rate / half) ** 2
    acceleration = np.stack([mean_over_markers(bent[:, group])[:, :2] for group in groups])  # (k, T, 2)
    pushed = _averaged(force, half)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(acceleration).all(axis=(0, 2))
        known &= pushed[:, 2] > _CARRIED * np.nanpercentile(force[:, 2], 95)
    if known.sum() < _ENOUGH_S * rate:
        return None
    every = np.flatnonzero(known)[:: max(1, half // 4)]  # the triangle leaves nothing that fewer samples would miss
    return _compared(pushed[every, :2], acceleration[:, every])


def mean_over_markers(values: FloatArray) -> FloatArray:
    """Mean over the markers (F, M, 3) that are known, (F, 3); NaN where none is."""
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=2))
    count = known.sum(axis=1)
    total = np.where(known[..., None], values, 0.0).sum(axis=1)
    return np.asarray(np.where(count[:, None] > 0, total, np.nan) / np.maximum(count, 1)[:, None])


def _averaged(values: FloatArray, half: int) -> FloatArray:
    """Mean of a series (F, 3) over a triangle of ``half`` samples to either side, (F - 2 half, 3)."""
    weights = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]) / half**2
    return np.stack([np.convolve(each, weights, "valid")[1:-1] for each in values.T], axis=1)


def _by_height(positions: FloatArray) -> Sequence[IntArray]:
    """Indexes of the markers in the lowest, middle and highest third of the body's height, those that have any."""
    height = np.array([np.median(z[np.isfinite(z)]) if np.isfinite(z).any() else np.nan for z in positions[:, :, 2].T])
    if not np.isfinite(height).any():
        return []
    low, high = np.nanmin(height), np.nanmax(height)
    third = np.clip(3 * (height - low) / max(high - low, 1e-9), 0, 2.999)
    groups = [np.flatnonzero((third >= k) & (third < k + 1)) for k in range(3)]
    return [group for group in groups if group.size]


def _compared(measured: FloatArray, parts: FloatArray) -> Turned:
    """Compare a horizontal vector (T, 2) with what unit masses call for (k, T, 2), each less its mean."""
    measured, parts = measured - measured.mean(axis=0), parts - parts.mean(axis=1, keepdims=True)
    size = float(np.linalg.norm(measured))
    left, angle = min((_unexplained(measured, parts, angle), angle) for angle in _ANGLES)
    coherence = float(np.sqrt(max(0.0, 1.0 - (left / max(size, 1e-300)) ** 2)))
    return Turned(angle, coherence, size / float(np.sqrt(len(measured))))


def _unexplained(measured: FloatArray, parts: FloatArray, angle: float) -> float:
    """What is left of vectors (T, 2) after the best masses, none negative, times the parts (k, T, 2) turned so."""
    c, s = np.cos(angle), np.sin(angle)
    rows = (parts @ np.array([[c, s], [-s, c]])).reshape(len(parts), -1).T
    return float(nnls(rows, measured.reshape(-1))[1])
