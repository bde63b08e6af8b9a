"""Markers that are bad for a part of a trial: frozen, attached again elsewhere, mislabelled, or not on the body.

Every marker is followed in the frame of its own segment, after the chain is fitted robustly to every frame. A good
marker keeps its position there, within the motion of the skin. In a bad interval, the marker is elsewhere. The interval
also begins or ends with a jump, or the marker stands still in the laboratory while its segment moves. Limbs outside the
chain also leave their positions, but without a jump and without standing still.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, find_runs
from mocap_id.kinematics.bundle import chain_angles, frames_along_motion, rigid_body_links
from mocap_id.kinematics.chain_fit import ChainProblem, angle_jacobian, joint_positions
from mocap_id.kinematics.segmentation import Segmentation
from mocap_id.kinematics.swaps import find_jumps

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
_REPEATED_MOVES = 0.003  # m; the same, if exactly the same coordinates are repeated


@dataclass(frozen=True)
class _Position:
    """Usual position of a marker on a segment."""

    segment: int
    local: complex  # coordinates, m
    usual: float  # usual distance from this position, m
    share: float  # fraction of the motion in which the marker is there


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
    tracks = _express_in_segments(recorded, segmentation, fitted)
    if tracks is None:
        return ()
    plane = recorded.points[..., 0] + 1j * recorded.points[..., 1]
    along = tracks[:, frames_along_motion(plane, _ALONG)]
    own = [_find_position(along, int(k), m) if k >= 0 else None for m, k in enumerate(segmentation.segment)]
    typical = {
        k: float(np.median([place.usual for place in own if place is not None and place.segment == k]))
        for k in {place.segment for place in own if place is not None}
    }
    bad: list[BadStretch] = []
    strays: list[int] = []
    for marker in (int(marker) for marker in examined):
        place = own[marker]
        if place is not None:
            place = replace(place, usual=max(place.usual, typical[place.segment]))
        else:  # on the moving segment where the marker stays longest, or on the base
            places = [_find_position(along, k, marker) for k in range(len(along))]
            moving = [each for each in places[1:] if each is not None]
            best = max(moving, key=lambda each: each.share, default=None)
            place = best if best is not None and best.share >= _LEAST_SHARE else places[0]
        found = []
        if place is not None and place.share >= _LEAST_SHARE:
            found = _find_stretches(recorded, tracks[place.segment, :, marker], place, marker)
        if not found and segmentation.segment[marker] < 0:
            strays.append(marker)
        bad += found
    ghosts = np.intersect1d(strays, np.flatnonzero(find_lone_markers(recorded.points)))
    return (*bad, *(BadStretch(int(marker), 0, int(recorded.rows[-1]), "ghost") for marker in ghosts))


def _express_in_segments(
    recorded: RecordedMarkers, segmentation: Segmentation, fitted: ComplexArray
) -> ComplexArray | None:
    """Return every marker in the frame of every segment, (n + 1, T, M), m; NaN where unknown.

    The angles of the segments are fitted to each frame with Cauchy's loss. The result is None if the angles are known
    in too few frames.
    """
    rows, plane = recorded.rows, recorded.points[..., 0] + 1j * recorded.points[..., 1]
    segment, assigned = segmentation.segment, np.flatnonzero(segmentation.segment >= 0)
    if segmentation.links is None:
        state = rigid_body_links(fitted[:, assigned], segment[assigned])
        joint_tracks = {}
    else:
        state = replace(segmentation.links.state, local=segmentation.links.state.local[assigned])
        joint_tracks = {pin.joint + 1: plane[:, pin.unit].mean(axis=1) for pin in segmentation.links.pins}
    start = chain_angles(plane[:, assigned], segment[assigned], state.centres, state.local, joint_tracks)
    known = np.isfinite(start)
    if known.all(axis=1).sum() < _FEWEST:
        return None
    start = np.stack([np.interp(rows, rows[k], np.unwrap(a[k])) for a, k in zip(start.T, known.T, strict=True)], axis=1)
    moving, joints = segment[assigned] > 0, len(state.centres)
    state = replace(state, local=state.local[moving], angles=start)
    problem = ChainProblem.with_joint_markers(plane[:, assigned[moving]], segment[assigned[moving]], {}, joints)
    seen, ridge = np.isfinite(plane[:, assigned[moving]]), _RIDGE * np.eye(joints)
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
    return np.stack([plane, *(np.conj(turns[:, k, None]) * (plane - origin[:, k, None]) for k in range(joints))])


def _find_position(along: ComplexArray, segment: int, marker: int) -> _Position | None:
    """Return the position of a marker in a segment's frame for most of the motion; None if it is hardly visible.

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
    return _Position(segment, place, float(np.median(off[near])), float(near.mean()))


def _find_stretches(recorded: RecordedMarkers, local: ComplexArray, place: _Position, marker: int) -> list[BadStretch]:
    """Return the bad intervals of a marker that is otherwise on its segment, in whose frame its track is ``local``."""
    points, rate = recorded.points[:, marker], recorded.rate
    seen = np.flatnonzero(np.isfinite(local))
    rows, local = recorded.rows[seen], local[seen]
    out = np.abs(local - place.local) > max(_LEAST_OFF, _OFF * place.usual)
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
        reach = _measure_range(local[run])
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
            away = abs(np.median(local[run].real) + 1j * np.median(local[run].imag) - place.local)
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


def _measure_range(track: ComplexArray) -> float:
    """Return the largest 5 to 95 % range of the coordinates of a track, m."""
    low, high = np.quantile(np.stack([track.real, track.imag]), [0.05, 0.95], axis=1)
    return float(np.max(high - low))


_FRAMES = 120
_SIMPLE_FAULTS_FEWEST = 20  # fewest frames in which both markers are visible
_MOVES = 0.02  # m rms; least scatter of a moving marker
_NEAR_BASE = 0.07  # m rms; a marker that moves less may be near the first joint and keep its distance from the base
_SIMPLE_FAULTS_MOST = 0.1  # largest fraction of lone markers; more of them are limbs with one marker each
_SHARE = 0.3  # least 10 to 90 % range of a lone marker's distances, relative to its own scatter
_STRAYS = (0.02, 0.04)  # m; range of this limit
_SIMPLE_FAULTS_SHORTEST = 0.2  # s; shortest repetition
_NEIGHBOURS = 3  # number of nearest markers whose motion is compared
_REPEAT_MOVES = 0.003  # m; least motion of the neighbours, and least jump of the marker afterwards
_SIMPLE_FAULTS_MOSTLY = 0.8  # largest fraction of the interval in which a neighbour also repeats its position


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
    moves = (scatter > _MOVES) & (counts >= _SIMPLE_FAULTS_FEWEST)
    lone = moves.copy()
    for marker in np.flatnonzero(moves):
        others = (moves | (scatter[marker] < _NEAR_BASE)) & (np.arange(len(moves)) != marker)
        # 10 to 90 % ranges of the distances from the others; inf if hardly visible together
        distance = np.sort(np.linalg.norm(some[:, others] - some[:, [marker]], axis=2), axis=0)  # NaN last
        together = np.isfinite(distance).sum(axis=0)
        last, column = np.maximum(together - 1, 0), np.arange(distance.shape[1])
        low, high = (distance[np.round(share * last).astype(np.int64), column] for share in (0.1, 0.9))
        nearest = np.where(together >= _SIMPLE_FAULTS_FEWEST, high - low, np.inf).min(initial=np.inf)
        lone[marker] = np.isfinite(nearest) and nearest > np.clip(_SHARE * scatter[marker], *_STRAYS)
    return lone if lone.mean() <= _SIMPLE_FAULTS_MOST else np.zeros_like(lone)


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
            if run.stop - run.start < _SIMPLE_FAULTS_SHORTEST * rate:
                continue
            inside = slice(run.start, run.stop + 1)
            away = np.linalg.norm(points[inside] - points[run.start, marker], axis=2)
            later = points[inside.stop :, marker]
            seen = later[np.isfinite(later).all(axis=1)]
            if not len(seen) or np.linalg.norm(seen[0] - points[run.start, marker]) <= _REPEAT_MOVES:
                continue
            known = np.flatnonzero(np.isfinite(away).any(axis=0) & (same[run].mean(axis=0) < _SIMPLE_FAULTS_MOSTLY))
            near = known[np.argsort(np.nanmedian(away[:, known], axis=0))[:_NEIGHBOURS]]
            travel = np.nanmax(points[inside][:, near], axis=0) - np.nanmin(points[inside][:, near], axis=0)
            if len(near) and float(np.median(travel.max(axis=1))) > _REPEAT_MOVES:
                bad.append(BadStretch(marker, inside.start, inside.stop - 1, "frozen"))
    return tuple(bad)
