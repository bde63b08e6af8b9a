"""Continuations of a marker across a jump or gap, judged by its distances to the markers that move with it."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

_NEAR = 3.0  # s before and after, in which the usual change of a distance is measured
_SAMPLES = 24  # changes in this time
_QUANTILE = 0.65  # the scale of a distance is this quantile of its changes; other swaps nearby may disturb larger ones
_PARTNERS = 10  # most rigid partners used
_LEAST_PARTNERS = 3
_FLOOR = 1e-3  # m; least scale of a distance
_VIOLATED = 3.0  # scales; a distance that changes more is violated
_HOLDS = 4.0  # scales; largest median change of the most rigid distances in the other column, or instead ...
_OF_VIOLATION = 0.05  # ... this part of their change in the own column, for the fastest motions
_MOST_RIGID = 6
_CHUNK = 512  # continuations at a time, to limit memory


class Continuations:
    """Tests of whether a sample (frame, column) and a later sample are the same marker.

    Which distances stay constant depends on the lag: over one frame nearly all do, over half a second only distances
    within a rigid body. Changes of each distance are therefore compared with a quantile of its changes over the same
    lag: within three seconds before in the first column, or three seconds after in the second, whichever is larger.
    Changes in the whole trial cannot be used, because a column with exchanged labels contains two markers. Trajectories
    (F, M, 3) are in m, NaN where missing; ``rate`` is in frames per second.
    """

    def __init__(self, positions: FloatArray, rate: float) -> None:
        self._positions = positions
        self._near = max(round(_NEAR * rate), _SAMPLES)

    def find_violations(self, column: IntArray, last: IntArray, following: IntArray) -> BoolArray:
        """Return whether two or more distances of a column change more than usual between two frames, for N cases (N,).

        The marker is visible in ``column`` at frame ``last`` and next at frame ``following``, each (N,).
        """
        out = np.zeros(len(column), dtype=np.bool_)
        for rows in _chunks(len(column)):
            i, a, b = column[rows], last[rows], following[rows]
            change = self._changes(i, a, i, b)
            for scale in (self._usual_changes(i, a, b - a, -1), self._usual_changes(i, b, b - a, 1)):
                out[rows] |= (change > _VIOLATED * scale).sum(axis=1) >= 2
        return out

    def weigh_evidence(
        self, column: IntArray, last: IntArray, own: IntArray, other: IntArray, frame: IntArray
    ) -> FloatArray:
        """Return the evidence (N,) that a marker continues in another column; -inf if that is ruled out.

        The change r of each distance, in units of its scale, has the heavy-tailed likelihood 1 / (1 + r²). The evidence
        is the log likelihood ratio of the two continuations, summed over the most rigid partners. The marker is visible
        in ``column`` at frame ``last``. This column is visible next at frame ``own``, and the column ``other`` at
        ``frame``, all (N,).
        """
        out = np.full(len(column), -np.inf)
        for rows in _chunks(len(column)):
            i, a, b, j, c = column[rows], last[rows], own[rows], other[rows], frame[rows]
            scale = np.fmax(self._usual_changes(i, a, c - a, -1), self._usual_changes(j, c, c - a, 1))
            change_here, change_there = self._changes(i, a, i, b) / scale, self._changes(i, a, j, c) / scale
            ratio = np.log1p(change_here**2) - np.log1p(change_there**2)
            unusable = ~np.isfinite(ratio)
            each = np.arange(len(i))
            unusable[each, i] = unusable[each, j] = True
            partners = np.argsort(np.where(unusable, np.inf, scale), axis=1, kind="stable")[:, :_PARTNERS]
            used = ~np.take_along_axis(unusable, partners, axis=1)
            ratio, change_there, change_here = (
                np.where(used, np.take_along_axis(values, partners, axis=1), np.nan)
                for values in (ratio, change_there, change_here)
            )
            enough = used.sum(axis=1) >= _LEAST_PARTNERS
            usual_there, usual_here = (_quantile(x[:, :_MOST_RIGID], 0.5) for x in (change_there, change_here))
            constant = usual_there <= np.maximum(_HOLDS, _OF_VIOLATION * usual_here)
            expected = self._expected_positions(i, a, c, partners, used)
            nearer = _norm(self._positions[c, j] - expected) < _norm(self._positions[b, i] - expected)
            fine = enough & constant & nearer
            out[rows] = np.where(fine, np.where(used, ratio, 0.0).sum(axis=1), -np.inf)
        return out

    def _changes(self, column: IntArray, last: IntArray, other: IntArray, frame: IntArray) -> FloatArray:
        """Return the absolute changes (N, M) of the distances to all markers, m.

        Distances are measured from ``column`` at frame ``last``, and from ``other`` at ``frame``.
        """
        points = self._positions
        before = _norm(points[last] - points[last, column][:, None])
        return np.abs(_norm(points[frame] - points[frame, other][:, None]) - before)

    def _usual_changes(self, column: IntArray, frame: IntArray, lag: IntArray, side: int) -> FloatArray:
        """Return the usual change (N, M), m, of distances over a lag before or after a frame; NaN if unknown.

        ``side`` is -1 for the time before the frame, and 1 for the time after it.
        """
        points = self._positions
        room = frame + 1 if side < 0 else len(points) - frame
        spread = np.clip(np.minimum(room, self._near + lag) - 1 - lag, 0, None)
        offset = np.round(spread[:, None] * np.linspace(0, 1, _SAMPLES)).astype(np.int64)
        near = frame[:, None] + side * offset
        far = np.clip(near + side * lag[:, None], 0, len(points) - 1)
        i = np.broadcast_to(column[:, None], near.shape)
        change = self._changes(i.ravel(), near.ravel(), i.ravel(), far.ravel()).reshape(*near.shape, -1)
        change[room <= lag] = np.nan
        return np.fmax(
            _quantile(np.moveaxis(change, 1, 2), _QUANTILE), _FLOOR * np.where(room > lag, 1, np.nan)[:, None]
        )

    def _expected_positions(
        self, i: IntArray, a: IntArray, c: IntArray, partners: IntArray, used: BoolArray
    ) -> FloatArray:
        """Return the position (N, 3) of column ``i``, m, if it moves like its partners from frame ``a`` to ``c``."""
        points = self._positions
        moved = np.where(used[..., None], points[c[:, None], partners] - points[a[:, None], partners], np.nan)
        return points[a, i] + _quantile(np.moveaxis(moved, 1, 2), 0.5)


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def _quantile(values: FloatArray, part: float) -> FloatArray:
    """Return the quantile ``part`` of the finite values along the last axis; NaN if no value is finite."""
    ordered = np.sort(values, axis=-1)
    last = np.maximum(np.isfinite(ordered).sum(axis=-1) - 1, 0)
    place = np.round(part * last).astype(np.int64)[..., None]
    return np.asarray(np.take_along_axis(ordered, place, axis=-1)[..., 0])


def _chunks(count: int) -> list[slice]:
    return [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
