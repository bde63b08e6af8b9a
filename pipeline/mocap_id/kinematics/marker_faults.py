"""Bad stretches of markers (frozen, attached again elsewhere, mislabelled, not on the body), bursts, and label swaps.

Every marker is followed in the frame of its own segment, after the chain is fitted robustly to every frame. A good
marker keeps its position there, within the motion of the skin. In a bad interval, the marker is elsewhere. The interval
also begins or ends with a jump, or the marker stands still in the laboratory while its segment moves. Limbs outside the
chain also leave their positions, but without a jump and without standing still.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.kinematics.bundle import chain_angles, frames_along_motion, rigid_body_links
from mocap_id.kinematics.chain_fit import ChainProblem, angle_jacobian, joint_positions
from mocap_id.kinematics.segmentation import Segmentation

_RATE = 15.0  # Hz; frames in which the chain is fitted
_MOST = 3000  # largest number of these frames
_FEWEST = 50  # smallest number of these frames
_ALONG = 300  # frames along the motion, to locate a marker
_TRIED = 40  # candidates for the position of a marker
_SCALES = np.repeat([0.06, 0.02, 0.008], 3)  # m; scales of the loss
_RIDGE = 1e-6  # m^2; angles that no marker determines do not change
_HELD = 0.02  # m; largest distance of a good marker from its position
_LEAST_SHARE = 0.35  # least fraction of the motion in which a good marker is at its position
_OFF = 5.0  # least distance of a bad sample from the position, relative to the usual distance
_LEAST_OFF = 0.015  # m; the same as a length
_SHORTEST = 0.2  # s; shortest bad interval
_BRIDGED = 0.5  # s; intervals closer than this are joined
_NEAR = 0.25  # s; a jump this close to the end of an interval is its end
_MOSTLY = 0.8  # least fraction of still samples in a still interval
_STEP = 0.6  # least fraction of a displacement that occurs between two samples
_STILL = 2e-3  # m; largest distance of a still marker from its median
_SEGMENT_MOVES = 0.02  # m; least motion of the segment of a still marker
_REPEATED_MOVES = 0.003  # m; the same, of neighbours too and as a jump afterwards, if the same coordinates are repeated


_Position: TypeAlias = tuple[int, complex, float, float]
"""Segment of a marker, its usual position there, m, its usual distance from this position, m, and the fraction of the
motion in which it is there."""


@dataclass(frozen=True)
class RecordedMarkers:
    """Trajectories in the plane's frame; NaN where missing."""

    points: FloatArray  # (T, M, 3) positions in the frames ``rows``, m
    rows: IntArray  # (T,) frames chosen by :func:`sample_rows`
    track: Callable[[int], FloatArray]  # returns the trajectory (F, 3) of a marker (by its column) in all frames, m
    rate: float  # frames per second


def sample_rows(frames: int, rate: float) -> IntArray:
    """Return the frames in which :func:`find_bad_stretches` follows the markers."""
    return np.arange(0, frames, max(1, round(rate / _RATE), -(-frames // _MOST)))


def find_bad_stretches(
    recorded: RecordedMarkers, segmentation: Segmentation, fitted: ComplexArray, examined: IntArray
) -> tuple[BadStretch, ...]:
    """Return the intervals in which the markers ``examined`` (columns) are bad, after a segmentation.

    ``fitted`` (f, M) are the trajectories from which the segments were found, m. They are also NaN where samples are
    known to be bad.
    """
    # Every marker in the frame of every segment, (n + 1, T, M), m; NaN where unknown. The angles of the segments are
    # fitted to each frame with Cauchy's loss.
    rows, plane = recorded.rows, recorded.points[..., 0] + 1j * recorded.points[..., 1]
    assigned = np.flatnonzero(segmentation.segment >= 0)
    on_chain = segmentation.segment[assigned]
    if segmentation.links is None:
        state = rigid_body_links(fitted[:, assigned], on_chain)
        joint_tracks = {}
    else:
        state = replace(segmentation.links.state, local=segmentation.links.state.local[assigned])
        joint_tracks = {j + 1: plane[:, unit].mean(axis=1) for j, unit in segmentation.links.pins.items()}
    start = chain_angles(plane[:, assigned], on_chain, state.centres, state.local, joint_tracks)
    known = np.isfinite(start)
    if known.all(axis=1).sum() < _FEWEST:
        return ()
    start = np.stack([np.interp(rows, rows[k], np.unwrap(a[k])) for a, k in zip(start.T, known.T, strict=True)], axis=1)
    moves, joints = on_chain > 0, len(state.centres)
    state = replace(state, local=state.local[moves], angles=start)
    problem = ChainProblem.with_joint_markers(plane[:, assigned[moves]], on_chain[moves], {}, joints)
    seen, ridge = np.isfinite(plane[:, assigned[moves]]), _RIDGE * np.eye(joints)
    for scale in _SCALES:
        off = problem.residuals(state)
        weights = seen / (1 + (np.abs(off) / scale) ** 2)
        swing = angle_jacobian(problem, state)
        pulled = np.conj(swing) * weights[..., None]
        normal = (np.swapaxes(pulled, 1, 2) @ swing).real + ridge
        turn = np.einsum("tkn,tk->tn", pulled, off).real
        state = replace(state, angles=state.angles + np.linalg.solve(normal, turn[..., None])[..., 0])
    origin, turns = joint_positions(state)
    turns = np.where(known, turns, np.nan)
    tracks = np.stack([plane, *(np.conj(turns[:, k, None]) * (plane - origin[:, k, None]) for k in range(joints))])

    along = tracks[:, frames_along_motion(plane, _ALONG)]
    own = [_find_position(along, int(k), m) if k >= 0 else None for m, k in enumerate(segmentation.segment)]
    located = [each for each in own if each is not None]
    typical = {
        k: float(np.median([usual for segment, _, usual, _ in located if segment == k]))
        for k in {segment for segment, *_ in located}
    }
    bad: list[BadStretch] = []
    strays: list[int] = []
    for marker in (int(marker) for marker in examined):
        place = own[marker]
        if place is not None:
            segment, local, usual, share = place
            place = segment, local, max(usual, typical[segment]), share
        else:  # on the moving segment where the marker stays longest, or on the base
            places = [_find_position(along, k, marker) for k in range(len(along))]
            moving = [each for each in places[1:] if each is not None]
            best = max(moving, key=lambda each: each[3], default=None)
            place = best if best is not None and best[3] >= _LEAST_SHARE else places[0]
        found = []
        if place is not None and place[3] >= _LEAST_SHARE:
            segment, local, usual, _ = place
            found = _find_stretches(recorded, tracks[segment, :, marker], local, usual, marker)
        if not found and segmentation.segment[marker] < 0:
            strays.append(marker)
        bad += found
    ghosts = np.intersect1d(strays, np.flatnonzero(find_lone_markers(recorded.points)))
    return (*bad, *(BadStretch(int(marker), 0, int(recorded.rows[-1]), "ghost") for marker in ghosts))


def _find_position(along: ComplexArray, segment: int, marker: int) -> _Position | None:
    """Return the position of a marker in a segment for most of the motion; None if hardly visible.

    ``along`` (n + 1, A, M) are the markers in the frames of the segments, evenly along the motion, m.
    """
    track = along[segment, :, marker]
    track = track[np.isfinite(track)]
    if len(track) < _FEWEST // 2:
        return None
    candidates = track[np.linspace(0, len(track) - 1, _TRIED).astype(np.int64)]
    place = complex(candidates[np.argmax((np.abs(track - candidates[:, None]) < _HELD).sum(axis=1))])
    for _ in range(3):
        place = complex(track[np.abs(track - place) < _HELD].mean())
    off = np.abs(track - place)
    near = off < _HELD
    return segment, place, float(np.median(off[near])), float(near.mean())


def _find_stretches(
    recorded: RecordedMarkers, local: ComplexArray, place: complex, usual: float, marker: int
) -> list[BadStretch]:
    """Return the bad intervals of a marker that is otherwise on its segment, in whose frame its track is ``local``.

    ``place``, m, is its usual position there, and ``usual`` its usual distance from it, m.
    """
    points, rate = recorded.points[:, marker], recorded.rate
    seen = np.flatnonzero(np.isfinite(local))
    rows, local = recorded.rows[seen], local[seen]
    out = np.abs(local - place) > max(_LEAST_OFF, _OFF * usual)
    out |= _find_repeated(points[seen])
    if not out.any():
        return []
    positions = recorded.track(marker)
    there = np.flatnonzero(np.isfinite(positions[:, 0]))
    positions, apart = positions[there], np.diff(there)
    steps, _ = find_jumps(np.diff(positions, axis=0) / apart[:, None], apart)

    def find_nearest_jump(jumps: IntArray, frame: int) -> int | None:
        """Return the jump that is nearest to a frame; None if none is near."""
        nearest = int(jumps[np.argmin(np.abs(jumps - frame))]) if len(jumps) else None
        return nearest if nearest is not None and abs(nearest - frame) <= _NEAR * rate else None

    runs: list[slice] = []
    for run in find_runs(out):
        bridged = runs and rows[run.start] - rows[runs[-1].stop - 1] < _BRIDGED * rate
        runs.append(slice(runs.pop().start, run.stop) if bridged else run)
    bad: list[BadStretch] = []
    for run in runs:
        first, last = rows[run.start], rows[run.stop - 1]
        if last - first < _SHORTEST * rate:
            continue
        begin, end = find_nearest_jump(there[steps + 1], first), find_nearest_jump(there[steps], last)
        sudden = begin is not None or end is not None
        low, high = np.quantile(np.stack([local[run].real, local[run].imag]), [0.05, 0.95], axis=1)
        reach = float(np.max(high - low))
        # frozen: the marker stands still in the laboratory while its segment moves
        inside = (there >= first) & (there <= last)
        rest = np.median(positions[inside], axis=0)
        same = np.all(positions == rest, axis=1)
        still = same if same[inside].mean() > _MOSTLY else np.linalg.norm(positions - rest, axis=1) < _STILL
        repeated = _find_repeated(points[seen[run]]).mean() > _MOSTLY
        rests = still[inside].mean() > _MOSTLY and reach > (_REPEATED_MOVES if repeated else _SEGMENT_MOVES)
        if rests and (sudden or repeated):
            around = [there[each] for each in find_runs(still)]
            around = [each for each in around if each[0] <= last and each[-1] >= first]
            bad.append(BadStretch(marker, int(around[0][0]), int(around[-1][-1]), "frozen"))
            continue
        # moved: one end of the track is displaced by one step between two samples
        moved = False
        if reach < 2 * _HELD and (run.start == 0) != (run.stop == len(local)):
            at = run.start if run.start else run.stop
            away = abs(np.median(local[run].real) + 1j * np.median(local[run].imag) - place)
            moved = bool(abs(local[at] - local[at - 1]) > _STEP * away)
        if not sudden and not moved:
            continue
        before = rows[run.start - 1] + 1 if run.start else there[0]
        after = rows[run.stop] - 1 if run.stop < len(seen) else there[-1]
        ends = int(before if begin is None else begin), int(after if end is None else end)
        bad.append(BadStretch(marker, *ends, "moved" if moved else "elsewhere"))
    return bad


def _find_repeated(positions: FloatArray) -> BoolArray:
    """Return which positions (K, 3) are exactly equal to the previous or the next position."""
    same = np.zeros(len(positions) + 1, dtype=np.bool_)
    same[1:-1] = np.all(positions[1:] == positions[:-1], axis=1)
    return np.asarray(same[1:] | same[:-1])


_FRAMES = 120
_FEWEST_TOGETHER = 20  # fewest frames in which both markers are visible
_MOVES = 0.02  # m rms; least scatter of a moving marker
_NEAR_BASE = 0.07  # m rms; a marker that moves less may be near the first joint and keep its distance from the base
_MOST_LONE = 0.1  # largest fraction of lone markers; more of them are limbs with one marker each
_SHARE = 0.3  # least 10 to 90 % range of a lone marker's distances, relative to its own scatter
_STRAYS = (0.02, 0.04)  # m; range of this limit
_NEIGHBOURS = 3  # number of nearest markers whose motion is compared
_ALSO_REPEATS = 0.8  # largest fraction of the interval in which a neighbour also repeats its position


@dataclass(frozen=True)
class BadStretch:
    """Time interval in which a trajectory is not the trajectory of its marker.

    The marker is ``frozen`` in the laboratory, ``moved`` to another position until the end (or from the beginning) of
    the trial, ``elsewhere`` for some time, or a ``ghost`` that is never on a segment.
    """

    marker: int  # column
    first: int  # first frame
    last: int  # last frame
    how: Literal["frozen", "moved", "elsewhere", "ghost"]


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
    moves = (scatter > _MOVES) & (counts >= _FEWEST_TOGETHER)
    lone = moves.copy()
    for marker in np.flatnonzero(moves):
        others = (moves | (scatter[marker] < _NEAR_BASE)) & (np.arange(len(moves)) != marker)
        # 10 to 90 % ranges of the distances from the others; inf if hardly visible together
        distance = np.sort(np.linalg.norm(some[:, others] - some[:, [marker]], axis=2), axis=0)  # NaN last
        together = np.isfinite(distance).sum(axis=0)
        last, column = np.maximum(together - 1, 0), np.arange(distance.shape[1])
        low, high = (distance[np.round(share * last).astype(np.int64), column] for share in (0.1, 0.9))
        nearest = np.where(together >= _FEWEST_TOGETHER, high - low, np.inf).min(initial=np.inf)
        lone[marker] = np.isfinite(nearest) and nearest > np.clip(_SHARE * scatter[marker], *_STRAYS)
    return lone if lone.mean() <= _MOST_LONE else np.zeros_like(lone)


def find_repeats(points: FloatArray, rate: float) -> tuple[BadStretch, ...]:
    """Return intervals in which a marker repeats its last position exactly while the markers nearest to it move.

    Software fills gaps in this way. The marker must jump when it is visible again, because base markers without noise
    also repeat their positions while other markers move. Trajectories (F, M, 3) are in m, NaN where missing; ``rate``
    is in frames per second.
    """
    bad = []
    same = np.all(points[1:] == points[:-1], axis=2)
    for marker in range(points.shape[1]):
        for run in find_runs(same[:, marker]):
            if run.stop - run.start < _SHORTEST * rate:
                continue
            inside = slice(run.start, run.stop + 1)
            away = np.linalg.norm(points[inside] - points[run.start, marker], axis=2)
            later = points[inside.stop :, marker]
            seen = later[np.isfinite(later).all(axis=1)]
            if not len(seen) or np.linalg.norm(seen[0] - points[run.start, marker]) <= _REPEATED_MOVES:
                continue
            known = np.flatnonzero(np.isfinite(away).any(axis=0) & (same[run].mean(axis=0) < _ALSO_REPEATS))
            near = known[np.argsort(np.nanmedian(away[:, known], axis=0))[:_NEIGHBOURS]]
            travel = np.nanmax(points[inside][:, near], axis=0) - np.nanmin(points[inside][:, near], axis=0)
            if len(near) and float(np.median(travel.max(axis=1))) > _REPEATED_MOVES:
                bad.append(BadStretch(marker, inside.start, inside.stop - 1, "frozen"))
    return tuple(bad)


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
        frames = np.flatnonzero(np.isfinite(points[:, marker, 0]))
        if len(frames) <= 10:
            continue
        track, apart = points[frames, marker], np.diff(frames)
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
                    smallest = np.linalg.norm(excess[[one, other]], axis=1).min()
                    if free[other] and np.linalg.norm(left) < smallest / 2:
                        out[frames[away + 1 : back + 1], marker] = True
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


_AROUND = 3.0  # s before and after, in which the usual change of a distance is measured
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
        self._near = max(round(_AROUND * rate), _SAMPLES)

    def find_violations(self, column: IntArray, last: IntArray, following: IntArray) -> BoolArray:
        """Return whether two or more distances of a column change more than usual between two frames, for N cases (N,).

        The marker is visible in ``column`` at frame ``last`` and next at frame ``following``, each (N,).
        """
        out = np.zeros(len(column), dtype=np.bool_)
        for start in range(0, len(column), _CHUNK):
            rows = slice(start, start + _CHUNK)
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
        for start in range(0, len(column), _CHUNK):
            rows = slice(start, start + _CHUNK)
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
            # expected position of the marker at the later frame, if it moves like its partners
            points = self._positions
            moved = np.where(used[..., None], points[c[:, None], partners] - points[a[:, None], partners], np.nan)
            expected = points[a, i] + _quantile(np.moveaxis(moved, 1, 2), 0.5)
            nearer = _norm(points[c, j] - expected) < _norm(points[b, i] - expected)
            fine = enough & constant & nearer
            out[rows] = np.where(fine, np.where(used, ratio, 0.0).sum(axis=1), -np.inf)
        return out

    def _changes(self, column: IntArray, last: IntArray, other: IntArray, frame: IntArray) -> FloatArray:
        """Return how the distances (N, M), m, change from ``column`` at ``last`` to ``other`` at ``frame``."""
        points = self._positions
        before = _norm(points[last] - points[last, column][:, None])
        return np.abs(_norm(points[frame] - points[frame, other][:, None]) - before)

    def _usual_changes(self, column: IntArray, frame: IntArray, lag: IntArray, side: int) -> FloatArray:
        """Return the usual change (N, M), m, of distances over a lag before (``side`` -1) or after (1) a frame."""
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


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def _quantile(values: FloatArray, part: float) -> FloatArray:
    """Return the quantile ``part`` of the finite values along the last axis; NaN if no value is finite."""
    ordered = np.sort(values, axis=-1)
    last = np.maximum(np.isfinite(ordered).sum(axis=-1) - 1, 0)
    place = np.round(part * last).astype(np.int64)[..., None]
    return np.asarray(np.take_along_axis(ordered, place, axis=-1)[..., 0])


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


# Breaks (3, N): column, last visible frame and next visible frame; between these, the marker in the column may change.
_Breaks: TypeAlias = IntArray


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
    if breaks.shape[1] < 2:
        return ()
    suspects = breaks[:, np.unique(_drop_implausible(positions, breaks, *_pair_overlapping(breaks))[0])]
    continuations = Continuations(positions, rate)
    suspects = suspects[:, continuations.find_violations(*suspects)]

    # first frame and columns of each exchange; each marker continues in the next column (cyclically)
    source, target = _drop_implausible(positions, suspects, *_pair_overlapping(suspects))
    (column, last, following), (other, _, there) = suspects[:, source], suspects[:, target]
    evidence = continuations.weigh_evidence(column, last, following, other, there)
    gap = np.maximum(following, there) - last > 1
    strong = np.flatnonzero(evidence > np.where(gap, _EVIDENCE[1], _EVIDENCE[0]))
    while not (mutual := np.isin(target[strong], source[strong])).all():
        strong = strong[mutual]  # a marker can only continue in a column that another marker leaves
    strongest_last = strong[np.argsort(evidence[strong], kind="stable")]
    best = {int(source[link]): int(target[link]) for link in strongest_last}
    events: list[tuple[int, tuple[int, ...]]] = []
    done = set[int]()
    for start in best:
        path = [start]
        while path[-1] not in done and best.get(path[-1], start) not in path:
            path.append(best[path[-1]])
        if best.get(path[-1]) == start and not done.intersection(path):
            done.update(path)
            columns, lasts, followings = suspects[:, path]
            first = int(followings.min())
            if lasts.max() < first:
                events.append((first, tuple(columns.tolist())))

    # the swaps of two columns with their durations
    shown_by = list(range(markers))  # the marker in each column
    standing: dict[tuple[int, int], int] = {}
    swaps: list[Swap] = []
    for frame in sorted({event[0] for event in events}):
        for _, exchanged in sorted(event for event in events if event[0] == frame):
            shown = [shown_by[each] for each in exchanged]
            for each, marker in zip(exchanged[1:] + exchanged[:1], shown, strict=True):
                shown_by[each] = marker
        # exchanges of two columns that restore the order of all columns; each column comes first at most once
        rest, now = list(shown_by), []
        for one in range(len(rest)):
            if rest[one] != one:
                two = rest.index(one)
                rest[one], rest[two] = rest[two], rest[one]
                now.append((one, two))
        swaps += [Swap(*pair, begun, frame) for pair, begun in standing.items() if pair not in now]
        standing = {pair: standing.get(pair, frame) for pair in now}
    swaps += [Swap(*pair, begun, count) for pair, begun in standing.items()]
    swaps.sort(key=lambda swap: (swap.start, swap.first))
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
    breaks = np.stack([jumps[:, 0], jumps[:, 1], jumps[:, 1] + 1])
    seen = np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])
    if seen.all():
        return breaks
    # gaps up to the longest: a column disappears, and then appears
    (last, last_column), (first, first_column) = np.nonzero(seen[:-1] & ~seen[1:]), np.nonzero(~seen[:-1] & seen[1:])
    kind = np.repeat([0, 1], [len(last), len(first)])
    frame, column = np.concatenate([last, first + 1]), np.concatenate([last_column, first_column])
    order = np.lexsort((1 - kind, frame, column))  # a marker that is visible for one frame appears before it disappears
    kind, frame, column = kind[order], frame[order], column[order]
    closed = np.flatnonzero((kind[:-1] == 0) & (kind[1:] == 1) & (column[:-1] == column[1:]))
    closed = closed[frame[closed + 1] - frame[closed] - 1 <= round(_GAP * rate)]
    return np.concatenate([breaks, np.stack([column[closed], frame[closed], frame[closed + 1]])], axis=1)


def _drop_implausible(
    positions: FloatArray, breaks: _Breaks, source: IntArray, target: IntArray
) -> tuple[IntArray, IntArray]:
    """Return pairs of breaks, except those at adjacent frames whose own column is nearer to the expected position."""
    (column, last, following), (other, _, there) = breaks[:, source], breaks[:, target]
    start = positions[last, column]
    step = np.where((last > 0)[:, None], start - positions[last - 1, column], np.nan)
    start = start + np.where(np.isfinite(step), step, 0.0)
    own, cross = positions[following, column] - start, positions[there, other] - start
    longer = np.maximum(following, there) - last > 1
    gain = np.einsum("ni,ni->n", own, own) - np.einsum("ni,ni->n", cross, cross)
    keep = longer | (gain > 0)
    return source[keep], target[keep]


def _pair_overlapping(breaks: _Breaks) -> tuple[IntArray, IntArray]:
    """Return all ordered pairs of breaks of two columns that overlap in time, as two arrays of indices."""
    column, last, following = breaks
    order = np.argsort(last, kind="stable")
    stop = np.searchsorted(last[order], following[order], side="left")
    number = np.maximum(stop - np.arange(len(last)) - 1, 0)
    left = np.repeat(np.arange(len(last)), number)
    right = left + 1 + np.arange(len(left)) - np.repeat(np.cumsum(number) - number, number)
    one, two = order[left], order[right]
    apart = column[one] != column[two]
    one, two = one[apart], two[apart]
    return np.concatenate([one, two]), np.concatenate([two, one])


def _bound_swap(positions: FloatArray, rate: float, breaks: _Breaks, swap: Swap) -> Swap:
    """Return a swap without an end, bounded by a break at which one of its markers is hidden, if there is evidence.

    Backwards in time, the marker that a column contains after this break continues in the other column. If the break is
    before the swap, the labels are exchanged from the break to the start of the swap.
    """
    backwards, last = Continuations(positions[::-1], rate), len(positions) - 1
    exchanges: list[tuple[float, int]] = []
    for column, other in ((swap.first, swap.second), (swap.second, swap.first)):
        seen = np.isfinite(positions[:, other].sum(axis=1))
        for k in np.flatnonzero((breaks[0] == column) & ~seen[breaks[2]]):
            following = int(breaks[2, k])
            before = np.flatnonzero(seen[max(following - round(_GAP * rate), 0) : following][::-1])[:1]
            here, own = last - np.array([following]), last - breaks[1, [k]]
            if before.size:
                evidence = backwards.weigh_evidence(np.array([column]), here, own, np.array([other]), here + 1 + before)
                exchanges.append((float(evidence[0]), following))
    strongest, frame = max(exchanges, default=(0.0, 0))
    if strongest <= _EVIDENCE[1]:
        return swap
    return replace(swap, stop=frame) if frame > swap.start else replace(swap, start=frame, stop=swap.start)
