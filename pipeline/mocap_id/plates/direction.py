"""Comparison of the direction of a plate's horizontal force with the acceleration of the body.

Newton's law needs the masses of the body, which are not known. Therefore one non-negative mass is fitted to the markers
in each third of the body's height. These masses affect the size of the predicted force more than its direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_STEP_S = 0.1
"""Time step of the second differences that give the accelerations."""

_MIN_SHARE = 0.6
"""Fraction of the usual load. If the load is smaller, a chair, for example, may also exert a horizontal force."""

_ANGLES = tuple(np.radians(np.arange(-175, 181, 5)).tolist())
_MIN_TOTAL_S = 1.0


@dataclass(frozen=True)
class ForceDirection:
    """Direction of the horizontal force relative to the measured acceleration."""

    angle: float  # angle about the vertical from the acceleration to the force, in (-π, π] in steps of 5°, rad
    coherence: float  # correlation of the force with the acceleration after rotation by the angle, 0 to 1
    size: float  # root mean square of the force minus its mean, N


def compare_directions(force: FloatArray, positions: FloatArray, rate: float) -> ForceDirection | None:
    """Compare the direction of a horizontal force with the direction of the body's acceleration.

    ``force`` (F, 3) is the force on the body, lab axes, N. It is averaged over ± h with triangular weights, because the
    second difference of a position over a step h is the acceleration averaged with these weights. The result is None if
    there are too few samples.
    """
    half, groups = max(1, round(_STEP_S * rate)), group_by_height(positions)
    if len(positions) < 4 * half or not groups or not np.isfinite(force).any():
        return None
    each = (positions[2 * half :] - 2 * positions[half:-half] + positions[: -2 * half]) * (rate / half) ** 2
    acceleration = np.stack([average_markers(each[:, group])[:, :2] for group in groups])  # (k, T, 2)
    averaged = _average_triangular(force, half)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(acceleration).all(axis=(0, 2))
        known &= averaged[:, 2] > _MIN_SHARE * np.nanpercentile(force[:, 2], 95)
    if known.sum() < _MIN_TOTAL_S * rate:
        return None
    kept = np.flatnonzero(known)[:: max(1, half // 4)]  # the averaged signals contain no higher frequencies
    return _fit_rotation(averaged[kept, :2], acceleration[:, kept])


def average_markers(values: FloatArray) -> FloatArray:
    """Return the mean (F, 3) of values (F, M, 3) over the visible markers; NaN in frames without a visible marker."""
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=2))
    count = known.sum(axis=1)
    total = np.where(known[..., None], values, 0.0).sum(axis=1)
    return np.asarray(np.where(count[:, None] > 0, total, np.nan) / np.maximum(count, 1)[:, None])


def _average_triangular(values: FloatArray, half: int) -> FloatArray:
    """Average a series (F, 3) with triangular weights over ± ``half`` samples; return (F - 2 half, 3)."""
    weights = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]) / half**2
    return np.stack([np.convolve(each, weights, "valid")[1:-1] for each in values.T], axis=1)


def group_by_height(positions: FloatArray) -> Sequence[IntArray]:
    """Return the indices of the markers in each third of the body's height; thirds without markers are left out."""
    height = np.array([np.median(z[np.isfinite(z)]) if np.isfinite(z).any() else np.nan for z in positions[:, :, 2].T])
    if not np.isfinite(height).any():
        return []
    low, high = np.nanmin(height), np.nanmax(height)
    third = np.clip(3 * (height - low) / max(high - low, 1e-9), 0, 2.999)
    groups = [np.flatnonzero((third >= k) & (third < k + 1)) for k in range(3)]
    return [group for group in groups if group.size]


def _fit_rotation(measured: FloatArray, parts: FloatArray) -> ForceDirection:
    """Find the angle by which the accelerations ``parts`` (k, T, 2) must be rotated to explain a force (T, 2) best.

    The mean of every signal is subtracted first.
    """
    measured, parts = measured - measured.mean(axis=0), parts - parts.mean(axis=1, keepdims=True)
    size = float(np.linalg.norm(measured))
    residual, angle = min((_compute_residual(measured, parts, angle), angle) for angle in _ANGLES)
    coherence = float(np.sqrt(max(0.0, 1.0 - (residual / max(size, 1e-300)) ** 2)))
    return ForceDirection(angle, coherence, size / float(np.sqrt(len(measured))))


def _compute_residual(measured: FloatArray, parts: FloatArray, angle: float) -> float:
    """Return the norm of the force (T, 2) minus fitted masses times rotated accelerations ``parts`` (k, T, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    rows = (parts @ np.array([[c, s], [-s, c]])).reshape(len(parts), -1).T
    return float(nnls(rows, measured.reshape(-1))[1])
