"""Time window of a recording in which the base is fixed; people often walk before and after it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.kinematics.base_motion import find_base_motion

STILL_RADIUS = 0.015
"""Largest distance (m) of a base marker from its rest position: skin, toes and heels move by a few millimetres."""

_TRAVEL = 5.0  # least travel of a moving marker, in still radii
_STANDS = 0.7  # least fraction of the recording in which a displaced base stands still
_TRIED = 200  # stretches tried, the longest first

MIN_SECONDS = 2.0
"""Shortest window, s; shorter still phases are steps while walking."""


def propose_window(positions: FloatArray, rate: float) -> tuple[int, int]:
    """Return first frame and stop of the longest interval in which two markers stand still and two others move.

    The whole recording is returned if its base is always fixed or only changes its position, or if there is no interval
    of :data:`MIN_SECONDS`. Positions (F, M, 3) are in the lab, m, NaN where missing; ``rate`` is in frames per second.
    """
    frames = len(positions)
    if _find_still_markers(positions).sum() >= 2:
        return 0, frames
    base = find_base_motion(positions, np.arange(frames) / rate, rate)
    if base is not None and sum(each.end - each.start for each in base.stretches) * rate > _STANDS * frames:
        return 0, frames
    least = MIN_SECONDS * rate
    stillness = [run for still in _find_still_samples(positions, rate).T for run in find_runs(still)]
    runs = [(run.start, run.stop) for run in stillness if run.stop - run.start >= least]
    shared = {(max(a[0], b[0]), min(a[1], b[1])) for a, b in combinations(runs, 2)}
    longest_first = sorted((s for s in shared if s[1] - s[0] >= least), key=lambda s: s[0] - s[1])
    return next((s for s in longest_first[:_TRIED] if _has_motion(positions[s[0] : s[1]])), (0, frames))


def _has_motion(positions: FloatArray) -> bool:
    """Return whether at least two markers travel far beyond the still radius, unlike markers on a waiting person."""
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    low = np.where(seen[..., None], positions, np.inf).min(axis=0)
    high = np.where(seen[..., None], positions, -np.inf).max(axis=0)
    extent = np.linalg.norm(np.where(high >= low, high - low, 0), axis=1)
    return int(np.sum(extent > _TRAVEL * STILL_RADIUS)) >= 2


def _find_still_markers(positions: FloatArray) -> BoolArray:
    """Return the markers (M,) that are within the still radius of their median in 98 % of the visible frames."""
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    tracks = np.swapaxes(positions, 0, 1)
    median = np.array(
        [np.median(p[s], axis=0) if s.any() else np.full(3, np.nan) for p, s in zip(tracks, seen.T, strict=True)]
    )
    away = (np.linalg.norm(positions - median, axis=2) > STILL_RADIUS) & seen
    return np.asarray((seen.sum(axis=0) > len(positions) / 2) & (away.sum(axis=0) * 50 <= seen.sum(axis=0)))


def _find_still_samples(positions: FloatArray, rate: float) -> BoolArray:
    """Return whether each marker stays within the still radius of one point in the second around each frame, (F, M).

    The point is the centre of the bounding box of its positions. Missing samples are ignored, but half of the second
    must be visible.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d  # noqa: PLC0415  a fixed base is usual

    size = 2 * max(1, round(rate / 2)) + 1
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    low = minimum_filter1d(np.where(seen[..., None], positions, np.inf), size, axis=0, mode="nearest")
    high = maximum_filter1d(np.where(seen[..., None], positions, -np.inf), size, axis=0, mode="nearest")
    often = uniform_filter1d(seen.astype(np.float64), size, axis=0, mode="nearest") > 0.5 - 1e-9
    extent = np.where(often[..., None], high - low, np.inf)
    return np.asarray(np.linalg.norm(extent, axis=2) / 2 < STILL_RADIUS)
