"""The useful part of a recording: people walk on and off."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

STILL_RADIUS = 0.015
"""A base marker stays within this distance of its median (m): skin, toes and heels move by a few millimetres."""

MIN_SECONDS = 2.0
"""Shorter stretches of stillness are steps of a gait, not a base."""


def propose_window(positions: FloatArray, rate: float) -> tuple[int, int]:
    """The longest stretch over which at least two markers stay where they are.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab coordinates, m; NaN where unseen.
    rate : float
        Frames per second.

    Returns
    -------
    first, stop : int
        Frame indexes, ``stop`` excluded; the whole recording where its base is fixed throughout or where no stretch
        of :data:`MIN_SECONDS` is.
    """
    frames = len(positions)
    if _still_throughout(positions).sum() >= 2:
        return 0, frames
    runs = [run for still in _still(positions, rate).T for run in _runs(still) if run[1] - run[0] >= MIN_SECONDS * rate]
    best = (0, 0)
    for index, run in enumerate(runs):
        for other in runs[index + 1 :]:
            shared = max(run[0], other[0]), min(run[1], other[1])
            if shared[1] - shared[0] > best[1] - best[0]:
                best = shared
    return best if best[1] - best[0] >= MIN_SECONDS * rate else (0, frames)


def _still_throughout(positions: FloatArray) -> BoolArray:
    """(M,) markers that leave their median by more than the still radius in fewer than one seen frame in fifty."""
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    median = np.array(
        [np.median(p[s], axis=0) if s.any() else np.full(3, np.nan) for p, s in _per_marker(positions, seen)]
    )
    away = (np.linalg.norm(positions - median, axis=2) > STILL_RADIUS) & seen
    return np.asarray((seen.sum(axis=0) > len(positions) / 2) & (away.sum(axis=0) * 50 <= seen.sum(axis=0)))


def _per_marker(positions: FloatArray, seen: BoolArray) -> list[tuple[FloatArray, BoolArray]]:
    return [(positions[:, marker], seen[:, marker]) for marker in range(positions.shape[1])]


def _still(positions: FloatArray, rate: float) -> BoolArray:
    """(F, M) whether a marker stays within the still radius over the second around each frame."""
    half = max(1, round(rate / 2))
    index = np.arange(len(positions))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(positions) - 1)
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(positions[after] - positions[before], axis=2) < STILL_RADIUS
    return np.asarray(near)


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Start and stop of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
