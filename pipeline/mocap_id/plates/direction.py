"""Comparison of the force of the plates with the acceleration of the body: direction, size and course in time.

Newton's law needs the masses of the body, which are not known. Therefore one non-negative mass is fitted to the markers
in each third of the body's height. These masses affect the size of the predicted force more than its direction and its
course in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.plates.choice import GRAVITY
from mocap_id.recording.marker_posture import find_upright, measure_body_height

_STEP_S = 0.1  # time step of the second differences that give the accelerations
# Fraction of the usual load. If the load is smaller, a chair, for example, may also exert a horizontal force.
_MIN_SHARE = 0.6
_ANGLES = tuple(np.radians(np.arange(-175, 181, 5)).tolist())
_MIN_TOTAL_S = 1.0
_RISEN = 0.7  # fraction of the rise of the body above which no chair touches it
# a mean over this time is subtracted from forces and accelerations: objects that the person takes or puts down, and
# hands on a support, change the force more slowly
_SLOW_S = 2.0
# time step of the accelerations of the whole course: a longer one, because repeated frames disturb them
_COURSE_STEP_S = 0.15
# least correlation of the height of a marker on the body with that of the highest markers; a lifted box has 0.5
_WITH_BODY = 0.8
_FRAMES = 3000  # largest number of frames for this correlation
_LATE_S = 1.0  # largest clock offset between the files of one recording that is exported as one
_LAG_STEP_S = 0.04
_MIN_COMPARED_S = 2.0
_OVERLAP = 0.6  # fraction of the samples that must be common at larger clock offsets


@dataclass(frozen=True)
class ForceCourse:
    """Agreement of the vertical force with the vertical acceleration of the body, over time."""

    correlation: float  # largest correlation of force and acceleration for clock offsets up to ± 1 s, 0 to 1
    offset: float  # this clock offset, s; positive if the force is late
    correlation_far: float  # largest correlation for all clock offsets for which enough samples are common
    expected: float  # root mean square of the weight times the acceleration, divided by gravity, N


def compare_courses(vertical: FloatArray, positions: FloatArray, rate: float) -> ForceCourse | None:
    """Compare the course of a vertical force (F,), N, with the vertical acceleration of a standing or rising body.

    Only samples are compared in which the body has risen, so that no chair carries a part of it. The result is None if
    there are too few of them, or if the body does not move.
    """
    positions = positions[:, _find_rising_markers(positions)]
    half, groups = max(1, round(_COURSE_STEP_S * rate)), group_by_height(positions)
    if len(positions) < 4 * half or not groups or np.isfinite(vertical).sum() < _MIN_COMPARED_S * rate:
        return None
    heights = positions[:, :, 2:]
    each = (heights[2 * half :] - 2 * heights[half:-half] + heights[: -2 * half]) * (rate / half) ** 2
    parts = np.full((len(groups), len(positions)), np.nan)
    parts[:, half:-half] = [average_markers(each[:, group])[:, 0] for group in groups]
    force = np.full(len(positions), np.nan)
    force[half:-half] = _average_triangular(vertical[:, None], half)[:, 0]
    risen = np.isfinite(parts).all(axis=0)
    if find_upright(positions)[1].any():
        height = measure_body_height(positions)
        low, high = np.nanpercentile(height, [2, 98])
        with np.errstate(invalid="ignore"):
            risen &= height >= low + _RISEN * (high - low)
    if risen.sum() < _MIN_COMPARED_S * rate:
        return None
    width = 2 * round(_SLOW_S * rate / 2) + 1
    parts, force = _subtract_mean(parts, width), _subtract_mean(force[None], width)[0]
    mass = float(np.nanpercentile(vertical, 90)) / GRAVITY
    expected = mass * float(np.sqrt(np.mean(parts.mean(axis=0)[risen] ** 2)))
    least, most = _MIN_COMPARED_S * rate, _OVERLAP * risen.sum()
    step, reach = max(1, round(_LAG_STEP_S * rate)), len(positions) - round(least)
    best, far = (-1.0, 0.0), 0.0
    for lag in range(-reach // step * step, reach + 1, step):
        chosen = np.flatnonzero(risen)
        chosen = chosen[(chosen + lag >= 0) & (chosen + lag < len(force))]
        chosen = chosen[np.isfinite(force[chosen + lag])]
        near = abs(lag) <= _LATE_S * rate
        if len(chosen) < (least if near else max(least, most)):
            continue
        kept = chosen[:: max(1, half // 2)]  # the averaged signals contain no higher frequencies
        rows, target = parts[:, kept].T, force[kept + lag]
        rows, target = rows - rows.mean(axis=0), target - target.mean()
        size = float(np.linalg.norm(target))
        residual = float(nnls(rows, target)[1])
        correlation = float(np.sqrt(max(0.0, 1.0 - (residual / max(size, 1e-300)) ** 2)))
        far = max(far, correlation)
        if near:
            best = max(best, (correlation, lag / rate))
    if best[0] < 0.0:
        return None
    return ForceCourse(best[0], best[1], far, expected)


def _find_rising_markers(positions: FloatArray) -> IntArray:
    """Return the indices of the markers that rise and lower with the highest quarter of the markers; all if none does.

    Markers on objects, such as a box that the person lifts or a table, do not belong to the body.
    """
    heights = positions[:: max(1, len(positions) // _FRAMES), :, 2]
    usual = np.array([np.median(z[np.isfinite(z)]) if np.isfinite(z).any() else -np.inf for z in heights.T])
    top = np.argsort(-usual)[: max(2, len(usual) // 4)]
    away = heights[:, top] - usual[top]
    known = np.isfinite(away)
    common = np.where(known, away, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    kept = []
    for marker, height in enumerate(heights.T):
        both = np.isfinite(height) & known.any(axis=1)
        moves = both.sum() > 2 and np.ptp(height[both]) > 0.0 and np.ptp(common[both]) > 0.0
        if moves and np.corrcoef(height[both], common[both])[0, 1] > _WITH_BODY:
            kept.append(marker)
    return np.array(kept or range(positions.shape[1]), dtype=np.int64)


def _subtract_mean(values: FloatArray, width: int) -> FloatArray:
    """Return series (k, F) minus their mean over ``width`` samples; missing samples stay NaN and do not count."""
    known, ones = np.isfinite(values), np.ones(width)
    total = np.stack([np.convolve(each, ones, "same") for each in np.where(known, values, 0.0)])
    count = np.stack([np.convolve(each, ones, "same") for each in known.astype(np.float64)])
    return np.asarray(values - total / np.maximum(count, 1.0))


@dataclass(frozen=True)
class ForceDirection:
    """Direction of the horizontal force relative to the measured acceleration."""

    angle: float  # angle about the vertical from the acceleration to the force, in (-π, π] in steps of 5°, rad
    coherence: float  # correlation of the force with the acceleration after rotation by the angle, 0 to 1
    size: float  # root mean square of the force minus its mean, N
    expected: float  # the same of the load times the mean acceleration of the markers, divided by gravity, N


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
    measured, parts = averaged[kept, :2], acceleration[:, kept]
    measured, centred = measured - measured.mean(axis=0), parts - parts.mean(axis=1, keepdims=True)

    def compute_residual(angle: float) -> float:
        """Return the norm of the force minus fitted masses times accelerations that are rotated by an angle."""
        c, s = np.cos(angle), np.sin(angle)
        rows = (centred @ np.array([[c, s], [-s, c]])).reshape(len(centred), -1).T
        return float(nnls(rows, measured.reshape(-1))[1])

    residual, angle = min((compute_residual(angle), angle) for angle in _ANGLES)
    size = float(np.linalg.norm(measured))
    mean = parts.mean(axis=0)
    mass = float(np.nanpercentile(force[:, 2], 90)) / GRAVITY
    return ForceDirection(
        angle=angle,
        coherence=float(np.sqrt(max(0.0, 1.0 - (residual / max(size, 1e-300)) ** 2))),
        size=size / float(np.sqrt(len(measured))),
        expected=mass * float(np.linalg.norm(mean - mean.mean(axis=0))) / float(np.sqrt(len(kept))),
    )


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
