"""Markers whose last position was repeated, as software fills a gap, while their body moved."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, find_runs
from mocap_id.kinematics.marker_faults import BadStretch

_SHORTEST = 0.2  # s
_NEIGHBOURS = 3  # markers that show whether the body moves meanwhile
_MOVES = 0.003  # m; they move by more than this, and the marker then jumps by more
_MOSTLY = 0.8  # of the stretch; a neighbour that repeats its position too shows nothing


def find_repeats(points: FloatArray, rate: float) -> tuple[BadStretch, ...]:
    """Find stretches in which a marker repeats exactly its last position while the markers nearest to it move.

    The marker must jump when it is seen again: a base without noise also repeats its position while others move.

    Parameters
    ----------
    points : (F, M, 3) array
        m; NaN where not seen.
    rate : float
        Hz.
    """
    found = []
    same = np.all(points[1:] == points[:-1], axis=2)
    for marker in range(points.shape[1]):
        for run in (run for run in find_runs(same[:, marker]) if run.stop - run.start >= _SHORTEST * rate):
            inside = slice(run.start, run.stop + 1)
            away = np.linalg.norm(points[inside] - points[run.start, marker], axis=2)
            later = points[inside.stop :, marker]
            seen = later[np.isfinite(later).all(axis=1)]
            if not len(seen) or np.linalg.norm(seen[0] - points[run.start, marker]) <= _MOVES:
                continue
            known = np.flatnonzero(np.isfinite(away).any(axis=0) & (same[run].mean(axis=0) < _MOSTLY))
            near = known[np.argsort(np.nanmedian(away[:, known], axis=0))[:_NEIGHBOURS]]
            travel = np.nanmax(points[inside][:, near], axis=0) - np.nanmin(points[inside][:, near], axis=0)
            if len(near) and float(np.median(travel.max(axis=1))) > _MOVES:
                found.append(BadStretch(marker, inside.start, inside.stop - 1, "frozen"))
    return tuple(found)
