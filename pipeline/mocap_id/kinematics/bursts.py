"""Samples that no marker can have reached: short jumps there and back, left out before anything is fitted."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, IntArray

_LONGEST = 0.4  # s; a longer stay elsewhere is a relabelled marker, not a burst
_JUMP = 4.0  # times the distance that the marker travels in a frame at its fastest (99th percentile)
_LEAST = 0.015  # m; smaller jumps are left to the robust fits


def find_bursts(points: ComplexArray, rate: float) -> BoolArray:
    """Samples between a jump away and a jump back to where the marker would have been.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    rate : float
        Frames per second.

    Returns
    -------
    (F, M) bool array
    """
    out = np.zeros(points.shape, dtype=np.bool_)
    for marker in range(points.shape[1]):
        seen = np.flatnonzero(np.isfinite(points[:, marker]))
        if len(seen) > 10:
            out[seen, marker] = _one(points[seen, marker], seen, round(_LONGEST * rate))
    return out


def _one(track: ComplexArray, frames: IntArray, longest: int) -> BoolArray:
    """(K,) for the seen samples of one marker, taken at ``frames``."""
    out = np.zeros(len(track), dtype=np.bool_)
    step = np.abs(np.diff(track))
    fastest = float(np.quantile(step / np.diff(frames), 0.99))
    jumps = np.flatnonzero(step > max(_LEAST, _JUMP * fastest) * np.diff(frames))
    done = -1
    for index, away in enumerate(jumps):
        if away <= done:
            continue
        for back in jumps[index + 1 :]:
            apart = frames[back + 1] - frames[away]
            if apart > longest:
                break
            home = min(step[away], step[back]) / 2 + fastest * apart
            if abs(track[back + 1] - track[away]) < home:
                out[away + 1 : back + 1] = True
                done = back
                break
    return out
