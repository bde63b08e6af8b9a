"""Bursts: samples between a jump of a marker away from its path and the jump back, excluded from every fit."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_LONGEST = 1.5  # s; a longer excursion is a relabelled marker, not a burst
_SHORT = 0.4  # s; in a shorter burst, the jumps need not cancel if the marker returns to its expected position
_JUMP = 4.0  # multiple of the 95th percentile of the change between successive displacements
_LEAST = 0.012  # m; the robust fits handle smaller jumps
_BESIDE = np.array([-2, -1, 1, 2])  # neighbouring displacements that give the expected displacement


def find_bursts(points: FloatArray, rate: float) -> BoolArray:
    """Return which samples (F, M) lie between a jump of a marker away from its path and the jump back.

    A jump is a displacement between frames that differs suddenly from the displacements before and after it. A second
    jump ends the burst if it cancels the first, or if it soon leads to the position that the marker would have had.
    Trajectories (F, M, 3) are in m, NaN where missing; ``rate`` is in frames per second.
    """
    out = np.zeros(points.shape[:2], dtype=np.bool_)
    for marker in range(points.shape[1]):
        track = points[:, marker]
        seen = np.flatnonzero(np.isfinite(track[:, 0]))
        if len(seen) > 10:
            out[seen, marker] = _find_marker_bursts(track[seen], seen, rate)
    return out


def _find_marker_bursts(track: FloatArray, frames: IntArray, rate: float) -> BoolArray:
    """Return which visible samples ``track`` (K, 3) of one marker, at the frames ``frames`` (K,), are in a burst."""
    out = np.zeros(len(track), dtype=np.bool_)
    apart = np.diff(frames)
    velocity = np.diff(track, axis=0) / apart[:, None]  # m per frame
    jumps, excess = find_jumps(velocity, apart)
    free = np.ones(len(jumps), dtype=np.bool_)
    for back_is_near, longest in ((False, _LONGEST * rate), (True, _SHORT * rate)):
        for one in range(len(jumps)):
            for other in range(one + 1, len(jumps)):
                away, back = jumps[one], jumps[other]
                if not free[one] or frames[back] - frames[away] > longest:
                    break
                left = excess[one] + excess[other]
                if back_is_near:
                    around = np.array([away - 2, away - 1, back + 1, back + 2])
                    around = around[(around >= 0) & (around < len(velocity))]
                    onwards = velocity[around].mean(axis=0) * (frames[back + 1] - frames[away])
                    left = track[back + 1] - track[away] - onwards
                if free[other] and np.linalg.norm(left) < np.linalg.norm(excess[[one, other]], axis=1).min() / 2:
                    out[away + 1 : back + 1] = True
                    free[[one, other]] = False
    return out


def find_jumps(velocity: FloatArray, apart: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the indices (J,) of jumps, and their difference (J, 3) from the neighbouring displacements, m.

    ``velocity`` (K, 3), m per frame, is the mean velocity from each visible sample of a marker to the next, and
    ``apart`` (K,) is the number of frames between them.
    """
    bend = np.diff(velocity, axis=0)
    change = np.sqrt(np.einsum("ki,ki->k", bend, bend))
    limit = max(_LEAST, _JUMP * float(np.quantile(change, 0.95)))
    sudden = np.flatnonzero(change > limit / 2)
    steps = np.unique(np.concatenate([sudden, sudden + 1]))
    beside = steps[:, None] + _BESIDE
    inside = (beside >= 0) & (beside < len(velocity))
    near = np.where(inside[..., None], velocity[np.clip(beside, 0, len(velocity) - 1)], np.nan)
    excess = (velocity[steps] - np.nanmedian(near, axis=1)) * apart[steps, None]
    jumps = np.linalg.norm(excess, axis=1) > limit * apart[steps]
    return steps[jumps], excess[jumps]
