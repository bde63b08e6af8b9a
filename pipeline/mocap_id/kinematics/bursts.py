"""Samples that no marker can have reached: jumps there and back, left out before anything is fitted."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_LONGEST = 1.5  # s; a longer stay elsewhere is a relabelled marker, not a burst
_SHORT = 0.4  # s; within it, a marker that is back where it would have been need not have come by the way it went
_JUMP = 4.0  # times how much the step changes from frame to frame where it changes most (95th percentile)
_LEAST = 0.012  # m; smaller jumps are left to the robust fits
_BESIDE = np.array([-2, -1, 1, 2])  # steps that tell how far a marker would have gone by itself


def find_bursts(points: FloatArray, rate: float) -> BoolArray:
    """Samples between a jump away and the jump back.

    A jump is a step that the steps beside it do not announce. Of two jumps the second is the way back if it undoes the
    first, or, soon after it, if it ends where the marker would have been.

    Parameters
    ----------
    points : (F, M, 3) array
        Trajectories, m; NaN where unseen.
    rate : float
        Frames per second.

    Returns
    -------
    (F, M) bool array
    """
    out = np.zeros(points.shape[:2], dtype=np.bool_)
    for marker in range(points.shape[1]):
        track = points[:, marker]
        seen = np.flatnonzero(np.isfinite(track[:, 0]))
        if len(seen) > 10:
            out[seen, marker] = _one(track[seen], seen, rate)
    return out


def _one(track: FloatArray, frames: IntArray, rate: float) -> BoolArray:
    """(K,) for the seen samples (K, 3) of one marker, taken at ``frames``."""
    out = np.zeros(len(track), dtype=np.bool_)
    apart = np.diff(frames)
    velocity = np.diff(track, axis=0) / apart[:, None]  # m a frame
    jumps, by = _jumps(velocity, apart)
    free = np.ones(len(jumps), dtype=np.bool_)
    for back_is_near, longest in ((False, _LONGEST * rate), (True, _SHORT * rate)):
        for one in range(len(jumps)):
            for other in range(one + 1, len(jumps)):
                away, back = jumps[one], jumps[other]
                if not free[one] or frames[back] - frames[away] > longest:
                    break
                left = by[one] + by[other]
                if back_is_near:
                    onwards = _way(velocity, away, back) * (frames[back + 1] - frames[away])
                    left = track[back + 1] - track[away] - onwards
                if free[other] and np.linalg.norm(left) < np.linalg.norm(by[[one, other]], axis=1).min() / 2:
                    out[away + 1 : back + 1] = True
                    free[[one, other]] = False
    return out


def _way(velocity: FloatArray, away: int, back: int) -> FloatArray:
    """(3,) velocity, m a frame, of the marker around two jumps."""
    around = np.array([away - 2, away - 1, back + 1, back + 2])
    return np.asarray(velocity[around[(around >= 0) & (around < len(velocity))]].mean(axis=0))


def _jumps(velocity: FloatArray, apart: IntArray) -> tuple[IntArray, FloatArray]:
    """Steps (J,) that are jumps, and by how much (J, 3) each goes beyond what the steps beside it make likely, m."""
    bend = np.diff(velocity, axis=0)
    change = np.sqrt(np.einsum("ki,ki->k", bend, bend))
    limit = max(_LEAST, _JUMP * float(np.quantile(change, 0.95)))
    sudden = np.flatnonzero(change > limit / 2)
    steps = np.unique(np.concatenate([sudden, sudden + 1]))
    beside = steps[:, None] + _BESIDE
    inside = (beside >= 0) & (beside < len(velocity))
    near = np.where(inside[..., None], velocity[np.clip(beside, 0, len(velocity) - 1)], np.nan)
    by = (velocity[steps] - np.nanmedian(near, axis=1)) * apart[steps, None]
    jumps = np.linalg.norm(by, axis=1) > limit * apart[steps]
    return steps[jumps], by[jumps]
