"""Marker faults that are recognised without a chain: reflections, and positions that software has repeated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.kinematics.frame_sampling import frames_along_motion

Fault: TypeAlias = Literal["frozen", "moved", "elsewhere", "ghost"]

_FRAMES = 120
_FEWEST = 20  # fewest frames in which both markers are visible
_MOVES = 0.02  # m rms; least scatter of a moving marker
_NEAR_BASE = 0.07  # m rms; a marker that moves less may be near the first joint and keep its distance from the base
_MOST = 0.1  # largest fraction of lone markers; more of them are limbs with one marker each
_SHARE = 0.3  # least 10 to 90 % range of a lone marker's distances, relative to its own scatter
_STRAYS = (0.02, 0.04)  # m; range of this limit
_SHORTEST = 0.2  # s; shortest repetition
_NEIGHBOURS = 3  # number of nearest markers whose motion is compared
_REPEAT_MOVES = 0.003  # m; least motion of the neighbours, and least jump of the marker afterwards
_MOSTLY = 0.8  # largest fraction of the interval in which a neighbour also repeats its position


@dataclass(frozen=True)
class BadStretch:
    """Time interval in which a trajectory is not the trajectory of its marker.

    The marker is ``frozen`` in the laboratory, ``moved`` to another position until the end (or from the beginning) of
    the trial, ``elsewhere`` for some time, or a ``ghost`` that is never on a segment.
    """

    marker: int  # column
    first: int  # first frame
    last: int  # last frame
    how: Fault


def find_lone_markers(points: FloatArray) -> BoolArray:
    """Return which markers (M,) move and keep their distance from no other moving marker.

    Two markers of one segment keep their distance, and two markers of a limb nearly do. The reflection of a marker in a
    mirror, or a marker of another person, does not. If more than a tenth of the markers would be lone, none is
    returned. Trajectories (F, M, 3) are in m, NaN where missing.
    """
    step = max(1, len(points) // (10 * _FRAMES))
    some = points[::step]
    paths = np.concatenate([some[..., 0] + 1j * some[..., 1], some[..., 2] + 0j], axis=1)
    some = some[frames_along_motion(paths, _FRAMES)]
    seen: BoolArray = np.asarray(np.isfinite(some).all(axis=2))
    counts = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen[..., None], some, 0).sum(axis=0) / counts[:, None]
    away = np.where(seen, np.linalg.norm(some - mean, axis=2), 0)
    scatter = np.sqrt((away**2).sum(axis=0) / counts)
    moves = (scatter > _MOVES) & (counts >= _FEWEST)
    lone = moves.copy()
    for marker in np.flatnonzero(moves):
        others = (moves | (scatter[marker] < _NEAR_BASE)) & (np.arange(len(moves)) != marker)
        nearest = _distance_ranges(some, int(marker), others).min(initial=np.inf)
        lone[marker] = np.isfinite(nearest) and nearest > np.clip(_SHARE * scatter[marker], *_STRAYS)
    return lone if lone.mean() <= _MOST else np.zeros_like(lone)


def _distance_ranges(points: FloatArray, marker: int, others: BoolArray) -> FloatArray:
    """Return the 10 to 90 % ranges of the distances from other markers, m; inf if hardly visible together."""
    distance = np.sort(np.linalg.norm(points[:, others] - points[:, [marker]], axis=2), axis=0)  # NaN last
    counts = np.isfinite(distance).sum(axis=0)
    last, column = np.maximum(counts - 1, 0), np.arange(distance.shape[1])
    low, high = (distance[np.round(share * last).astype(np.int64), column] for share in (0.1, 0.9))
    return np.asarray(np.where(counts >= _FEWEST, high - low, np.inf))


def find_repeats(points: FloatArray, rate: float) -> tuple[BadStretch, ...]:
    """Return intervals in which a marker repeats its last position exactly while the markers nearest to it move.

    Software fills gaps in this way. The marker must jump when it is visible again, because base markers without noise
    also repeat their positions while other markers move. Trajectories (F, M, 3) are in m, NaN where missing; ``rate``
    is in frames per second.
    """
    bad = []
    same = np.all(points[1:] == points[:-1], axis=2)
    for marker in range(points.shape[1]):
        for run in (run for run in find_runs(same[:, marker]) if run.stop - run.start >= _SHORTEST * rate):
            inside = slice(run.start, run.stop + 1)
            away = np.linalg.norm(points[inside] - points[run.start, marker], axis=2)
            later = points[inside.stop :, marker]
            seen = later[np.isfinite(later).all(axis=1)]
            if not len(seen) or np.linalg.norm(seen[0] - points[run.start, marker]) <= _REPEAT_MOVES:
                continue
            known = np.flatnonzero(np.isfinite(away).any(axis=0) & (same[run].mean(axis=0) < _MOSTLY))
            near = known[np.argsort(np.nanmedian(away[:, known], axis=0))[:_NEIGHBOURS]]
            travel = np.nanmax(points[inside][:, near], axis=0) - np.nanmin(points[inside][:, near], axis=0)
            if len(near) and float(np.median(travel.max(axis=1))) > _REPEAT_MOVES:
                bad.append(BadStretch(marker, inside.start, inside.stop - 1, "frozen"))
    return tuple(bad)
