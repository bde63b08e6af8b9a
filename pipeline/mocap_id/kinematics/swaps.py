"""Label swaps: markers that exchange their labels, detected by rigidity and undone (assumption A3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, chunks
from mocap_id.kinematics.continuations import Continuations

_GAP = 1.0  # s; longest gap of a column: two markers hidden for half a second each
_OF_BEND = 2.5  # smallest jump, relative to the median second difference of the trajectories
_JUMPS = (0.008, 0.015)  # m; range of this smallest jump
_EVERY = 16  # this median uses every 16th sample
_EVIDENCE = (8.0, 18.0)  # least log likelihood ratio for each marker, from frame to frame and across gaps


@dataclass(frozen=True)
class Swap:
    """Two columns whose labels are exchanged for ``start <= frame < stop``."""

    first: int  # column, smaller than ``second``
    second: int  # column
    start: int  # first frame
    stop: int  # frame after the last one; the number of frames if the labels are never exchanged back


@dataclass(frozen=True)
class _Breaks:
    """Breaks (N,) of columns between the visible frames ``last`` and ``following``; the marker may change there."""

    column: IntArray
    last: IntArray
    following: IntArray

    def __getitem__(self, rows: IntArray) -> _Breaks:
        return _Breaks(self.column[rows], self.last[rows], self.following[rows])

    def __len__(self) -> int:
        return len(self.column)


def find_swaps(positions: FloatArray, rate: float) -> tuple[Swap, ...]:
    """Find label swaps between trajectories, at a frame or across a gap of up to 1 s, in order of start, then column.

    A trajectory is suspect if it has a jump or a gap, and if its distances to the markers that move with it change
    there. It is swapped if each of the interrupted markers continues in another column with unchanged distances. The
    labels of the first frames are assumed correct. An exchange of three or more labels is reported as successive swaps
    of two. Trajectories (F, M, 3) are in any fixed frame, m, NaN where missing; ``rate`` is in frames per second.
    """
    count, markers = positions.shape[:2]
    if count < 2 or markers < 4:
        return ()
    breaks = _find_breaks(positions, rate)
    if len(breaks) < 2:
        return ()
    suspects = breaks[np.unique(_drop_implausible(positions, breaks, *_pair_overlapping(breaks))[0])]
    continuations = Continuations(positions, rate)
    suspects = suspects[
        np.flatnonzero(continuations.find_violations(suspects.column, suspects.last, suspects.following))
    ]
    swaps = _find_durations(_find_exchanges(positions, suspects, continuations), markers, count)
    bounded = [_bound_swap(positions, rate, breaks, swap) if swap.stop == count else swap for swap in swaps]
    return tuple(sorted(bounded, key=lambda swap: (swap.start, swap.first)))


def undo_swaps(positions: FloatArray, swaps: tuple[Swap, ...]) -> FloatArray:
    """Return a copy of trajectories (F, M, 3) with the swaps of :func:`find_swaps` exchanged back."""
    out = positions.copy()
    for swap in sorted(swaps, key=lambda one: one.first):
        span = slice(swap.start, swap.stop)
        out[span, [swap.first, swap.second]] = out[span, [swap.second, swap.first]]
    return out


def _find_breaks(positions: FloatArray, rate: float) -> _Breaks:
    """Return jumps and gaps of all trajectories."""
    square = np.empty((len(positions) - 2, positions.shape[1]))
    with np.errstate(invalid="ignore"):
        for part in chunks(len(square)):
            bend = np.diff(positions[part.start : part.stop + 2], n=2, axis=0)
            square[part] = np.einsum("fmi,fmi->fm", bend, bend)
        sample = square.ravel()[::_EVERY]
        usual = np.sqrt(np.median(sample[np.isfinite(sample)])) if np.isfinite(sample).any() else 0.0
        bent = square > np.clip(_OF_BEND * usual, *_JUMPS) ** 2
    frame, column = np.nonzero(bent)
    # a large second difference at a frame is a jump before or after it
    jumps = np.unique(np.stack([np.tile(column, 2), np.concatenate([frame, frame + 1])], axis=1), axis=0)
    seen = np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])
    if seen.all():
        return _Breaks(jumps[:, 0], jumps[:, 1], jumps[:, 1] + 1)
    last_visible, last_column = np.nonzero(seen[:-1] & ~seen[1:])
    first_visible, first_column = np.nonzero(~seen[:-1] & seen[1:])
    gaps = _find_gaps(last_visible, last_column, first_visible + 1, first_column, round(_GAP * rate))
    columns = np.concatenate([jumps[:, 0], gaps[0]])
    last = np.concatenate([jumps[:, 1], gaps[1]])
    return _Breaks(columns, last, np.concatenate([jumps[:, 1] + 1, gaps[2]]))


def _find_gaps(
    last_visible: IntArray, last_column: IntArray, first_visible: IntArray, first_column: IntArray, longest: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Return column, last visible and next visible frame of all gaps of at most ``longest`` frames."""
    kind = np.concatenate([np.zeros(len(last_visible), dtype=np.int64), np.ones(len(first_visible), dtype=np.int64)])
    frame, column = np.concatenate([last_visible, first_visible]), np.concatenate([last_column, first_column])
    order = np.lexsort((1 - kind, frame, column))  # a marker that is visible for one frame appears before it disappears
    kind, frame, column = kind[order], frame[order], column[order]
    closed = np.flatnonzero((kind[:-1] == 0) & (kind[1:] == 1) & (column[:-1] == column[1:]))
    closed = closed[frame[closed + 1] - frame[closed] - 1 <= longest]
    return column[closed], frame[closed], frame[closed + 1]


def _drop_implausible(
    positions: FloatArray, breaks: _Breaks, source: IntArray, target: IntArray
) -> tuple[IntArray, IntArray]:
    """Return pairs of breaks, except those at adjacent frames whose own column is nearer to the expected position."""
    last, column = breaks.last[source], breaks.column[source]
    start = positions[last, column]
    step = np.where((last > 0)[:, None], start - positions[last - 1, column], np.nan)
    start = start + np.where(np.isfinite(step), step, 0.0)
    own = positions[breaks.following[source], breaks.column[source]] - start
    cross = positions[breaks.following[target], breaks.column[target]] - start
    longer = np.maximum(breaks.following[source], breaks.following[target]) - breaks.last[source] > 1
    gain = np.einsum("ni,ni->n", own, own) - np.einsum("ni,ni->n", cross, cross)
    keep = longer | (gain > 0)
    return source[keep], target[keep]


def _find_exchanges(
    positions: FloatArray, breaks: _Breaks, continuations: Continuations
) -> list[tuple[int, tuple[int, ...]]]:
    """Return first frame and columns of each exchange; each marker continues in the next column (cyclically)."""
    source, target = _drop_implausible(positions, breaks, *_pair_overlapping(breaks))
    here, there = breaks[source], breaks[target]
    evidence = continuations.weigh_evidence(here.column, here.last, here.following, there.column, there.following)
    gap = np.maximum(here.following, there.following) - here.last > 1
    strong = np.flatnonzero(evidence > np.where(gap, _EVIDENCE[1], _EVIDENCE[0]))
    while not (mutual := np.isin(target[strong], source[strong])).all():
        strong = strong[mutual]  # a marker can only continue in a column that another marker leaves
    strongest_last = strong[np.argsort(evidence[strong], kind="stable")]
    best = {int(source[link]): int(target[link]) for link in strongest_last}
    out, done = [], set[int]()
    for start in best:
        path = [start]
        while path[-1] not in done and best.get(path[-1], start) not in path:
            path.append(best[path[-1]])
        closed = best.get(path[-1]) == start and not done.intersection(path)
        if closed:
            done.update(path)
            first = int(breaks.following[path].min())
            if breaks.last[path].max() < first:
                out.append((first, tuple(int(breaks.column[one]) for one in path)))
    return sorted(out)


def _pair_overlapping(breaks: _Breaks) -> tuple[IntArray, IntArray]:
    """Return all ordered pairs of breaks of two columns that overlap in time, as two arrays of indices."""
    order = np.argsort(breaks.last, kind="stable")
    last, following = breaks.last[order], breaks.following[order]
    stop = np.searchsorted(last, following, side="left")
    number = np.maximum(stop - np.arange(len(last)) - 1, 0)
    left = np.repeat(np.arange(len(last)), number)
    right = left + 1 + np.arange(len(left)) - np.repeat(np.cumsum(number) - number, number)
    one, two = order[left], order[right]
    apart = breaks.column[one] != breaks.column[two]
    one, two = one[apart], two[apart]
    return np.concatenate([one, two]), np.concatenate([two, one])


def _find_durations(events: list[tuple[int, tuple[int, ...]]], markers: int, count: int) -> tuple[Swap, ...]:
    """Return the swaps of two columns with their durations, from exchanges (frame, columns) in ``events``."""
    shown_by = list(range(markers))  # the marker in each column
    standing: dict[tuple[int, int], int] = {}
    out: list[Swap] = []
    for frame in sorted({event[0] for event in events}):
        for _, columns in (event for event in events if event[0] == frame):
            shown = [shown_by[column] for column in columns]
            for column, marker in zip(columns[1:] + columns[:1], shown, strict=True):
                shown_by[column] = marker
        now = _list_exchanges(shown_by)
        out += [Swap(*pair, start, frame) for pair, start in standing.items() if pair not in now]
        standing = {pair: standing.get(pair, frame) for pair in now}
    out += [Swap(*pair, start, count) for pair, start in standing.items()]
    return tuple(sorted(out, key=lambda swap: (swap.start, swap.first)))


def _list_exchanges(shown_by: list[int]) -> list[tuple[int, int]]:
    """Return exchanges of two columns that restore the order of all columns; each column comes first at most once."""
    rest, out = list(shown_by), []
    for column in range(len(rest)):
        if rest[column] != column:
            other = rest.index(column)
            rest[column], rest[other] = rest[other], rest[column]
            out.append((column, other))
    return out


def _bound_swap(positions: FloatArray, rate: float, breaks: _Breaks, swap: Swap) -> Swap:
    """Return a swap without an end, bounded by a break at which one of its markers is hidden, if there is evidence.

    Backwards in time, the marker that a column contains after this break continues in the other column. If the break is
    before the swap, the labels are exchanged from the break to the start of the swap.
    """
    backwards, last = Continuations(positions[::-1], rate), len(positions) - 1
    exchanges: list[tuple[float, int]] = []
    for column, other in ((swap.first, swap.second), (swap.second, swap.first)):
        seen = np.isfinite(positions[:, other].sum(axis=1))
        for k in np.flatnonzero((breaks.column == column) & ~seen[breaks.following]):
            following = int(breaks.following[k])
            before = np.flatnonzero(seen[max(following - round(_GAP * rate), 0) : following][::-1])[:1]
            here, own = last - np.array([following]), last - breaks.last[[k]]
            if before.size:
                evidence = backwards.weigh_evidence(np.array([column]), here, own, np.array([other]), here + 1 + before)
                exchanges.append((float(evidence[0]), following))
    strongest, frame = max(exchanges, default=(0.0, 0))
    if strongest <= _EVIDENCE[1]:
        return swap
    return replace(swap, stop=frame) if frame > swap.start else replace(swap, start=frame, stop=swap.start)
