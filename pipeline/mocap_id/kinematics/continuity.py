"""How well a trajectory goes on where it jumps or was unseen, against how well its motion lets one tell.

A trajectory is *cut* where it may have jumped and where it is unseen. Straight lines through its last samples before
the cut and its first ones after it are carried to the middle; the distance at which they miss each other there is the
*misfit*. A constant acceleration cancels out of it; so does what a marker shares with a *companion* that moves much as
it does, when the companion's misfit over the same frames is taken off.

What misfit is usual is measured, not assumed: that of the same marker (and companion), over as many unseen frames and
fitted through as many samples, wherever it was seen. Noise, speed, acceleration and frame rate are all in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

LEAST = 0.0007
"""No misfit under this (m) is unusual: cameras agree no better on a marker of a centimetre."""

_JUMP = 2.5  # times the 90 % quantile of a marker's own second differences: to be looked at, not yet believed
_HORIZON = 1.0  # s; over longer gaps nothing is predicted
_COMPANY = 0.1  # s; gap over which companions are chosen
_COMPANIONS = 6
_SAMPLES = 300  # frames that a quantile is taken over
_ENOUGH = 30  # samples that it needs
_FITS = (2, 3, 5, 8, 12)  # frames that a line may be fitted to


class Span(NamedTuple):
    """Frames fitted before a cut and after it, and from the last before to the first after."""

    before: int
    after: int
    gap: int


@dataclass
class Cuts:
    """Where trajectories are interrupted, in the order of ``first``.

    Parameters
    ----------
    column : (N,) int array
        Trajectory; changes as exchanges are undone.
    last : (N,) int array
        Last frame before the cut, -1 where there is none.
    first : (N,) int array
        First frame after it, F where there is none.
    run : (N,) int array
        Frames from ``first`` to the next cut.
    """

    column: IntArray
    last: IntArray
    first: IntArray
    run: IntArray

    def exchange(self, one: int, other: int) -> None:
        """Let the trajectories of two cuts that overlap go on, each with what followed the other."""
        later = self.first >= min(self.first[one], self.first[other])
        columns = self.column[[one, other]]
        here, there = later & (self.column == columns[0]), later & (self.column == columns[1])
        self.column[here], self.column[there] = columns[1], columns[0]
        self.last[[one, other]] = self.last[[other, one]]


class Motion:
    """Usual misfits of the trajectories of one recording.

    Parameters
    ----------
    positions : (F, M, 3) array
        m; NaN where unseen.
    rate : float
        Frames per second.
    """

    def __init__(self, positions: FloatArray, rate: float) -> None:
        self.positions = positions
        self.seen: BoolArray = np.asarray(np.isfinite(positions.sum(axis=2)))
        self.jump = _jumps(positions, self.seen)
        self.longest = max(1, round(_HORIZON * rate))
        self._jumps_before = np.concatenate(
            [np.zeros_like(self.seen[:1], dtype=np.int64), np.cumsum(self.jump, axis=0)]
        )
        self._known: dict[tuple[int, int, Span], float] = {}
        pooled = {count: self._quantile(slice(None), None, Span(count, count, 1)) for count in _FITS}
        self.fit = min(_FITS, key=lambda count: np.nan_to_num(pooled[count], nan=np.inf))

    def cuts(self) -> Cuts:
        """All interruptions of all trajectories; none before the first frame."""
        frames, markers = self.seen.shape
        latest = np.maximum.accumulate(np.where(self.seen, np.arange(frames)[:, None], -1), axis=0)
        begins = np.zeros((frames + 1, markers), dtype=np.bool_)
        begins[1:-1] = self.seen[1:] & (~self.seen[:-1] | self.jump[1:])
        begins[-1] = ~self.seen[-1] & (latest[-1] >= 0)
        column, first = np.nonzero(begins.T)
        last = latest[first - 1, column]
        follows = np.append(column[1:] == column[:-1], False)
        run = np.where(follows, np.roll(last, -1), frames - 1) - first + 1
        order = np.argsort(first, kind="stable")
        return Cuts(column[order], last[order], first[order], run[order])

    @cached_property
    def companions(self) -> IntArray:
        """(M, k) for every marker those whose misfits are most like its own, best first."""
        markers = self.positions.shape[1]
        misfit = self._misfits(slice(None), Span(self.fit, self.fit, max(1, round(_COMPANY * self.longest / _HORIZON))))
        chosen = np.empty((markers, min(_COMPANIONS, markers - 1)), dtype=np.int64)
        for column in range(markers):
            size = np.sort(_size(misfit - misfit[:, column : column + 1]), axis=0)  # NaN last
            known = np.isfinite(size).sum(axis=0)
            usual = size[np.maximum(0.95 * known - 1, 0).astype(np.int64), np.arange(markers)] if len(size) else known
            usual = np.where(known >= _ENOUGH, usual, np.inf)
            order = np.argsort(usual, kind="stable")
            chosen[column] = order[order != column][: chosen.shape[1]]
        return chosen

    def usual(self, column: int, companion: int | None, span: Span) -> float:
        """Misfit (m) that 95 % of such spans stay under; NaN where they are too rare to tell."""
        span = span._replace(gap=_rounded(span.gap))
        key = (column, -1 if companion is None else companion, span)
        if key not in self._known:
            usual = self._quantile(slice(column, column + 1), companion, span)
            if companion is None and not np.isfinite(usual):
                usual = self._quantile(slice(None), None, span)
            self._known[key] = max(LEAST, usual) if np.isfinite(usual) else np.nan
        return self._known[key]

    def _quantile(self, columns: slice, companion: int | None, span: Span) -> float:
        misfit = self._misfits(columns, span)
        if companion is not None:
            misfit = misfit - self._misfits(slice(companion, companion + 1), span)
        size = _size(misfit)
        size = size[np.isfinite(size)]
        return float(np.quantile(size, 0.95)) if size.size >= _ENOUGH else np.nan

    def _misfits(self, columns: slice, span: Span) -> FloatArray:
        """(S, m, 3) misfits over uninterrupted stretches, m; NaN where unseen or where a jump is between."""
        stop = len(self.positions) - span.gap - span.after
        if stop < span.before - 1:
            return np.empty((0, len(range(*columns.indices(self.positions.shape[1]))), 3))
        frames = np.unique(np.linspace(span.before - 1, stop, _SAMPLES).astype(np.int64))
        offsets, weights = misfit_weights(span)
        misfit = np.tensordot(weights, self.positions[offsets[:, None] + frames, columns], 1)
        jumps = self._jumps_before[:, columns]
        misfit[jumps[frames + offsets[-1] + 1] > jumps[frames + offsets[0] + 1]] = np.nan
        return np.asarray(misfit)


@lru_cache(maxsize=4096)
def misfit_weights(span: Span) -> tuple[IntArray, FloatArray]:
    """Frames, counted from the last before the cut, and the weights with which they make the misfit.

    Where one side has a single frame, the other's line is carried all the way to it.
    """
    half = span.gap / 2 if min(span.before, span.after) > 1 else float(span.gap)
    ahead = _line(span.before, half if span.before > 1 else 0.0)
    back = _line(span.after, half if span.after > 1 else 0.0)[::-1]
    frames = np.concatenate([np.arange(1 - span.before, 1), np.arange(span.gap, span.gap + span.after)])
    return frames, np.concatenate([ahead, -back])


def _line(count: int, ahead: float) -> FloatArray:
    """(count,) weights that carry the straight line through equidistant samples beyond the last of them."""
    time = np.arange(count) - (count - 1) / 2
    return np.asarray(1 / count + (time[-1] + ahead) * time / max(float(time @ time), 1.0))


def _rounded(gap: int) -> int:
    """Gaps for which usual misfits are measured: not shorter, at most a quarter longer."""
    step = 1 << max(0, gap.bit_length() - 3)
    return -(-gap // step) * step


def _size(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors)))


def _jumps(positions: FloatArray, seen: BoolArray) -> BoolArray:
    """(F, M) whether a marker may have jumped since the frame before: its second differences on both sides are large."""
    bend = np.full(seen.shape, np.nan)
    bend[1:-1] = _size(positions[2:] - 2 * positions[1:-1] + positions[:-2])
    both = np.fmin(bend[1:], bend[:-1])
    ranked = np.sort(both[:: max(1, len(both) // 2000)], axis=0)  # NaN last
    known = np.isfinite(ranked).sum(axis=0)
    usual = ranked[np.maximum(0.9 * known - 1, 0).astype(np.int64), np.arange(seen.shape[1])]
    limit = np.maximum(3 * LEAST, _JUMP * np.where(known >= _ENOUGH, usual, 0))
    jumps = np.zeros(seen.shape, dtype=np.bool_)
    jumps[1:] = ~(both <= limit) & seen[1:] & seen[:-1]  # alone between gaps: cannot be told, so looked at
    return jumps
