"""Time window and motion of the base: feet that stand still, slide, step, rotate, or lift their heels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex, find_runs
from mocap_id.kinematics.joint import count_positions

STILL_RADIUS = 0.015
"""Largest distance (m) of a base marker from its rest position: skin, toes and heels move by a few millimetres."""

_TRAVEL = 5.0  # least travel of a moving marker, in still radii
_STANDS = 0.7  # least fraction of the recording in which a displaced base stands still
_TRIED = 200  # stretches tried, the longest first

MIN_SECONDS = 2.0
"""Shortest window, s; shorter still phases are steps while walking."""


def propose_window(positions: FloatArray, rate: float) -> tuple[int, int]:
    """Return first frame and stop of the longest interval in which two markers stand still and two others move.

    The whole recording is returned if its base is always fixed or only changes its position, or if there is no interval
    of :data:`MIN_SECONDS`. Positions (F, M, 3) are in the lab, m, NaN where missing; ``rate`` is in frames per second.
    """
    frames = len(positions)
    # markers that are within the still radius of their median in 98 % of the visible frames
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    tracks, counts = np.swapaxes(positions, 0, 1), seen.sum(axis=0)
    median = np.array(
        [np.median(p[s], axis=0) if s.any() else np.full(3, np.nan) for p, s in zip(tracks, seen.T, strict=True)]
    )
    away = (np.linalg.norm(positions - median, axis=2) > STILL_RADIUS) & seen
    if ((counts > frames / 2) & (away.sum(axis=0) * 50 <= counts)).sum() >= 2:
        return 0, frames
    base = find_base_motion(positions, np.arange(frames) / rate, rate)
    if base is not None and sum(each.end - each.start for each in base.stretches) * rate > _STANDS * frames:
        return 0, frames

    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d  # noqa: PLC0415  a fixed base is usual

    # a marker is still in a frame if it stays within the still radius of the centre of its bounding box in the second
    # around it; missing samples are ignored, but half of the second must be visible
    size = 2 * max(1, round(rate / 2)) + 1
    low = minimum_filter1d(np.where(seen[..., None], positions, np.inf), size, axis=0, mode="nearest")
    high = maximum_filter1d(np.where(seen[..., None], positions, -np.inf), size, axis=0, mode="nearest")
    often = uniform_filter1d(seen.astype(np.float64), size, axis=0, mode="nearest") > 0.5 - 1e-9
    extent = np.where(often[..., None], high - low, np.inf)
    still = np.linalg.norm(extent, axis=2) / 2 < STILL_RADIUS
    least = MIN_SECONDS * rate
    stillness = [run for own in still.T for run in find_runs(own)]
    runs = [(run.start, run.stop) for run in stillness if run.stop - run.start >= least]
    shared = {(max(a[0], b[0]), min(a[1], b[1])) for a, b in combinations(runs, 2)}
    longest_first = sorted((s for s in shared if s[1] - s[0] >= least), key=lambda s: s[0] - s[1])
    for start, stop in longest_first[:_TRIED]:
        # at least two markers travel far beyond the still radius, unlike markers on a waiting person
        part, there = positions[start:stop], seen[start:stop, :, None]
        low, high = np.where(there, part, np.inf).min(axis=0), np.where(there, part, -np.inf).max(axis=0)
        travel = np.linalg.norm(np.where(high >= low, high - low, 0), axis=1)
        if int(np.sum(travel > _TRAVEL * STILL_RADIUS)) >= 2:
            return start, stop
    return 0, frames


_BLOCK_S = 0.1  # positions are averaged over blocks of this length
_STEP_S = 0.5  # a marker stands still if it moves less than _STILL_M in this time
_STILL_M = 0.004
_BODY_M = 0.03  # the body moves if a quarter of the markers move farther than this in _STEP_S
_STANDING = 0.8  # least fraction of the body's moving time in which a base marker stands still
_STRETCH_S = 1.5  # shortest interval in which the base stands still
_MARGIN_S = 0.3  # a change of position may begin this long before, and end this long after, the visible motion
_SAME_M = 0.003  # smaller displacements of the base are motion of the skin
_FIXED_M = 0.005  # markers that stay within this range stand on the floor or on a plate
_STEP_M = 0.6  # markers on the other foot are at most this far away
_AS_HIGH_M = 0.002  # markers on a plate are lower than foot markers by more than this
_RIGID_M = 0.005  # largest rms distance from a rigid motion of both feet
_SPREAD_M = 0.05  # markers closer together than this do not determine a rotation

LOW_M = 0.2
"""Markers of the feet are at most this much higher, m, than the lowest marker that stands still."""

MOVED_M = 0.008
"""Least displacement of the base, m; standing feet roll by less."""


@dataclass(frozen=True)
class BaseStretch:
    """Time interval in which the base stands still."""

    start: float  # s
    end: float  # s
    shift: FloatArray  # (2,) horizontal displacement since the first interval, lab axes, m
    turn: float  # rotation about the vertical since the first interval, rad
    misfit: float  # rms distance of the foot markers from this rigid motion, m


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base since the first interval, to be removed from markers and wrench."""

    stretches: tuple[BaseStretch, ...]  # intervals in which the base stands still, at least two, in time order
    feet: tuple[int, ...]  # columns of the markers that move with the base
    fixed: BoolArray  # (M,) markers that keep their positions, on the floor or on a plate
    centre: FloatArray  # (2,) centre of the feet in the first interval, lab, m
    alone: bool  # a foot keeps its place while the other one moves
    knots: FloatArray  # (K,) times at which the pose of the base was determined, s
    poses: FloatArray  # (K, 3) shift, m, and rotation about ``centre``, rad

    def undo_positions(self, positions: FloatArray, time: FloatArray) -> FloatArray:
        """Return marker positions (F, M, 3), m, without the motion of the base. Fixed markers keep their positions.

        Positions are in lab axes with Z up, at the times (F,), s.
        """
        place, turn = self._interpolate_pose(time)
        moved = self._rotate_back(positions - place[:, None], turn[:, None])
        return np.where(self.fixed[:, None], positions, moved + np.append(self.centre, 0.0))

    def undo_wrench(self, force: FloatArray, moment: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force and moment about the lab's origin (F, 3) as if the base stood still, N and N·m.

        Body and wrench undergo the same rigid motion, so the wrench relative to the body does not change.
        """
        place, turn = self._interpolate_pose(time)
        about = self._rotate_back(moment - np.cross(place, force), turn)
        force = self._rotate_back(force, turn)
        return force, about + np.cross(np.append(self.centre, 0.0), force)

    @property
    def rigid(self) -> bool:
        """Whether one rigid motion describes both feet."""
        return not self.alone and all(each.misfit <= _RIGID_M for each in self.stretches)

    def _interpolate_pose(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the place of the feet's centre (F, 3) at height 0, m, and the rotation of the base (F,), rad."""
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415  a fixed base is usual

        pose = PchipInterpolator(self.knots, self.poses)(np.clip(time, self.knots[0], self.knots[-1]))
        return np.column_stack([self.centre + pose[:, :2], np.zeros(len(pose))]), pose[:, 2]

    @staticmethod
    def _rotate_back(vectors: FloatArray, turn: FloatArray) -> FloatArray:
        """Return vectors (..., 3) rotated about the vertical by the angle ``-turn``, rad."""
        c, s = np.cos(turn), np.sin(turn)
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def find_base_motion(positions: FloatArray, time: FloatArray, rate: float) -> BaseMotion | None:
    """Return the motion of the base; None if the base keeps its position, or if fewer than two markers locate it.

    The base consists of the low markers that stand still while the body moves. If they move to another position and
    stay there, the base has moved. When this motion is removed, the other markers move like a body on a fixed base.
    Positions (F, M, 3) are in lab axes with Z up, m, NaN where missing; ``rate`` is in frames per second.
    """
    size = max(1, round(_BLOCK_S * rate))
    blocks, middle = block_means(positions, size), block_means(time[:, None, None], size)[:, 0, 0]
    standing = find_standing(blocks, size / rate)

    # markers that keep their positions: the distance from the 2.5 to the 97.5 percentile of their tracks is small
    tracks = blocks[:, standing, :2]
    ordered, seen = np.sort(tracks, axis=0), np.isfinite(tracks[..., 0]).sum(axis=0)  # NaN last
    low, high = ((share * (seen - 1)).astype(np.int64) for share in (0.025, 0.975))
    every = np.arange(tracks.shape[1])
    keep = np.asarray(np.linalg.norm(ordered[high, every] - ordered[low, every], axis=1)) < _FIXED_M
    if (~keep).sum() < 2:
        return None
    # but not those on a foot that keeps its position: near the moving feet, and at the same height
    places = np.nan_to_num(np.nanmean(blocks[:, standing], axis=0))
    near = np.linalg.norm(places[:, :2] - places[~keep, :2].mean(axis=0), axis=1) < _STEP_M
    other = keep & near & (places[:, 2] > np.median(places[~keep, 2]) - _AS_HIGH_M)
    fixed = standing.copy()
    fixed[standing] = keep & ~other
    feet = np.flatnonzero(standing & ~fixed)

    # blocks in which most foot markers stand still (compared with a block later) or all are hidden
    step = max(1, round(_STEP_S * rate / size))
    travel = np.linalg.norm(blocks[step:, feet] - blocks[:-step, feet], axis=2)
    moved = (travel >= _STILL_M).sum(axis=1) * 2 > np.isfinite(travel).sum(axis=1)
    still = np.ones(len(blocks), np.bool_)
    for k in np.flatnonzero(moved):
        still[k : k + step + 1] = False
    tracks, least = blocks[:, feet, :2], _STRETCH_S * rate / size
    runs: list[tuple[int, int]] = []
    for run in find_runs(still):
        if run.stop - run.start < least:
            continue
        # Feet that slide by a millimetre per second stand still in every step, but not where they stood before. Such
        # an interval is divided.
        count = (run.stop - run.start) // math.ceil(least)
        sections = list(pairwise(run.start + (run.stop - run.start) * k // count for k in range(count + 1)))
        begun, *later = (_median_positions(tracks, section) for section in sections)
        within = any(_measure_distance(begun, place) >= MOVED_M for place in later)
        runs += sections if within and (_slides(tracks[run]) or _slides(tracks)) else [(run.start, run.stop)]
    at = [_median_positions(tracks, run) for run in runs]
    if not any(_measure_distance(at[0], place) >= MOVED_M for place in at[1:]):
        return None
    # intervals are joined where the feet have the same positions
    merged: list[tuple[int, int]] = []
    for (begin, end), place in zip(runs, at, strict=True):
        same = merged and _measure_distance(_median_positions(tracks, merged[-1]), place) < _SAME_M
        merged.append((merged.pop()[0] if same else begin, end))
    feet = feet[np.isfinite(_median_positions(tracks, merged[0])[:, 0])]
    if len(merged) < 2 or len(feet) < 2:
        return None

    # the motion of the foot markers that are visible in the first interval
    tracks, margin, last = blocks[:, feet, :2], round(_MARGIN_S * rate / size), len(merged) - 1
    first = _median_positions(tracks, merged[0])
    centre = first.mean(axis=0)

    def fit(places: FloatArray) -> tuple[FloatArray, float]:
        return _fit_rigid_motion(first - centre, places - centre, turning=turning)

    turning, alone = True, bool(other.any())
    fits = [fit(_median_positions(tracks, run)) for run in merged]
    turning = all(misfit <= (_SAME_M if alone else _RIGID_M) for _, misfit in fits)
    alone &= not turning  # feet may also rotate about a marker that keeps its place
    if not turning:
        fits = [fit(_median_positions(tracks, run)) for run in merged]
    section = max(2, round(_STRETCH_S / float(middle[1] - middle[0])))
    stretches, knots = [], dict[float, FloatArray]()
    for n, ((start, stop), (pose, misfit)) in enumerate(zip(merged, fits, strict=True)):
        # ``margin`` blocks at the inner ends of the intervals count as motion
        begin, end = start + margin * (n > 0), max(stop - 1 - margin * (n < last), start + margin + 1)
        stretches.append(BaseStretch(float(middle[begin]), float(middle[end]), pose[:2], float(pose[2]), misfit))
        if (n > 0 and merged[n - 1][1] == start) or (n < last and merged[n + 1][0] == stop):  # a slow slide is followed
            parts = [(a, min(a + section, stop)) for a in range(start, stop - section // 2, section)]
            knots |= {float(middle[(a + b - 1) // 2]): fit(_median_positions(tracks, (a, b)))[0] for a, b in parts}
        else:
            knots |= {float(middle[begin]): pose, float(middle[end]): pose}
        between = range(end + 1, merged[n + 1][0] + margin) if n < last and merged[n + 1][0] > stop else range(0)
        seen_in = [block for block in between if np.isfinite(tracks[block, :, 0]).sum() >= 2]
        knots |= {float(middle[block]): fit(tracks[block])[0] for block in seen_in}
    times, poses = np.array(sorted(knots)), np.array([pose for _, pose in sorted(knots.items())])
    markers = tuple(int(marker) for marker in feet)
    return BaseMotion(tuple(stretches), markers, fixed, centre, alone, times, poses)


def find_standing(blocks: FloatArray, block_s: float, least: float = _STANDING) -> BoolArray:
    """Return the low markers (M,) that stand still while the body moves; none if the body hardly moves.

    ``blocks`` (K, M, 3) are mean positions over blocks of ``block_s`` seconds, m, NaN where missing. A marker is
    returned if it stands still in at least the fraction ``least`` of the time in which the body moves.
    """
    none = np.zeros(blocks.shape[1], np.bool_)
    step = max(1, round(_STEP_S / block_s))
    if len(blocks) < 4 * step:
        return none
    travel = np.linalg.norm(blocks[step:] - blocks[:-step], axis=2)
    known = np.isfinite(travel)
    count = known.sum(axis=1)
    moving = (count > 0) & (4 * (travel > _BODY_M).sum(axis=1) >= count)
    if moving.sum() * block_s < _STRETCH_S:
        return none
    seen = known[moving].sum(axis=0)
    standing = (seen > moving.sum() / 2) & ((travel[moving] < _STILL_M).sum(axis=0) >= least * seen)
    if not standing.any():
        return none
    height = np.full(blocks.shape[1], np.inf)
    height[standing] = np.nanmean(blocks[:, standing, 2], axis=0)
    return np.asarray(standing & (height < height.min() + LOW_M))


def _slides(feet: FloatArray) -> bool:
    """Return whether feet (K, N, 2) are elsewhere in the last third than in the first: the skin returns every time."""
    third = len(feet) // 3
    before, after = (_median_positions(feet, part) for part in ((0, third), (len(feet) - third, len(feet))))
    return _measure_distance(before, after) >= MOVED_M


def _median_positions(feet: FloatArray, run: tuple[int, int]) -> FloatArray:
    """Return the median position (N, 2) of each marker in an interval; NaN if the marker is not visible."""
    part = feet[slice(*run)]
    places = np.full(part.shape[1:], np.nan)
    seen = np.isfinite(part[..., 0]).any(axis=0)
    places[seen] = np.nanmedian(part[:, seen], axis=0)
    return places


def _measure_distance(here: FloatArray, there: FloatArray) -> float:
    """Return the largest distance between two positions of the same markers, m; 0 if none is visible in both."""
    away = np.linalg.norm(here - there, axis=1)
    return float(np.nanmax(away, initial=0.0))


def _fit_rigid_motion(before: FloatArray, after: FloatArray, *, turning: bool) -> tuple[FloatArray, float]:
    """Return shift, m, and rotation about the origin, (3,), that move points (N, 2), and the rms distance left, m."""
    seen = np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])
    if not seen.any():
        return np.zeros(3), 0.0
    start, end = (points[seen, 0] + 1j * points[seen, 1] for points in (before, after))
    middle = start.mean()
    spread = np.sqrt(np.mean(np.abs(start - middle) ** 2))
    rotation: complex = 1.0
    if turning and spread > _SPREAD_M:
        rotation = complex(np.vdot(start - middle, end - end.mean()))
        rotation /= abs(rotation)
    shift = end.mean() - rotation * middle
    misfit = float(np.sqrt(np.mean(np.abs(end - rotation * start - shift) ** 2)))
    return np.array([shift.real, shift.imag, np.angle(rotation)]), misfit


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Return the means (K, M, C) of values (F, M, C) over blocks of ``size`` frames; NaN if all are missing."""
    count = len(values) // size
    parts = values[: count * size].reshape(count, size, *values.shape[1:])
    known = np.isfinite(parts)
    number = known.sum(axis=1)
    return np.asarray(np.where(number > 0, np.where(known, parts, 0.0).sum(axis=1), np.nan) / np.maximum(number, 1))


_LASTING_S = 0.3  # shortest lift
_LIFT_M = 0.012  # least lift; markers on heels that stay on the ground rise by up to 9 mm
_FLAT = 0.4  # least fraction of the body's moving time in which feet are flat; shanks move in most of it
_ON_FOOT_M = (0.1, 0.35)  # range of distances of two markers on one foot
_CONSTANT_M = 0.003  # largest change of distance of two markers on one foot
_AT_REST_M = 0.001  # markers that move less are on the ground, not on a rotating foot
_MOSTLY = 0.98  # quantile of a marker's distance from its usual position
_LEAST_POSITIONS = 2  # fewest distinct marker positions that determine the pose of a foot

LEAST_TURN = float(np.radians(3.0))
"""Least rotation of a foot that is reported, rad."""


def find_heel_lift(positions: FloatArray, time: FloatArray, rate: float) -> tuple[int, int, float, float, float] | None:
    """Return the largest rotation of a foot; None if all feet stay flat, or if no two markers of a foot rotate.

    The results are the column of the marker that rises and that of a marker on the same foot that rises less, the rise
    that lasts 0.3 s, m, the rotation of the foot, rad, and the time when the marker first rises, s. A rotation is
    visible in two low markers that keep their distance while one of them rises. Positions (F, M, 3) are in lab axes
    with Z up, m, NaN where missing; ``rate`` is in frames per second.
    """
    size = max(1, round(_BLOCK_S * rate))
    blocks = block_means(positions, size)
    low = np.flatnonzero(find_standing(blocks, size / rate, _FLAT))
    blocks, lasting = blocks[:, low], max(1, round(_LASTING_S * rate / size))
    if len(low) < 2:
        return None
    usual = np.nanmedian(blocks, axis=0)
    away = np.sort(np.nan_to_num(np.linalg.norm(blocks - usual, axis=2)), axis=0)[-lasting]
    height = np.sort(np.nan_to_num(blocks[..., 2] - usual[:, 2]), axis=0)[-lasting]
    largest: tuple[int, int, float, float, float] | None = None
    for up in np.flatnonzero(height > _LIFT_M):
        for down in np.flatnonzero((away > _AT_REST_M) & (height < height[up])):
            # the rotation, for ``lasting`` blocks, of the line between two markers of one foot
            between = blocks[:, up] - blocks[:, down]
            between = between[np.isfinite(between[:, 0])]
            if len(between) <= lasting:
                continue
            lengths = np.linalg.norm(between, axis=1)
            length, line = float(np.median(lengths)), np.median(between, axis=0)
            level = abs(line[2]) < np.hypot(line[0], line[1])
            rigid = np.quantile(np.abs(lengths - length), 0.98) <= _CONSTANT_M
            if not (level and _ON_FOOT_M[0] < length < _ON_FOOT_M[1] and rigid):
                continue
            slope = np.arcsin(np.clip(between[:, 2] / length, -1, 1))
            turn = float(np.sort(slope - np.median(slope))[-lasting])
            if turn > LEAST_TURN and (largest is None or turn > largest[3]):
                first = int(np.argmax(blocks[:, up, 2] - usual[up, 2] > _LIFT_M))
                largest = int(low[up]), int(low[down]), float(height[up]), turn, float(time[size * first])
    return largest


def find_moving_markers(points: FloatArray, rate: float) -> BoolArray:
    """Return which base markers (m,) are on feet that move; none if the moving markers do not determine a pose.

    Marker positions (F, m, 2) are in the plane frame, m, NaN where missing; the rate is in frames per second.
    """
    blocks = block_means(points, max(1, round(_BLOCK_S * rate)))
    moving: BoolArray = np.asarray(np.isfinite(blocks).any(axis=(0, 2)))
    if not moving.any():
        return moving
    usual = np.nanmedian(blocks[:, moving], axis=0)
    low = usual[:, 1] < usual[:, 1].min() + LOW_M  # a table or a chair that is touched is not a foot
    moving[moving], usual = low, usual[low]
    away = np.linalg.norm(blocks[:, moving] - usual, axis=2)
    moves = np.nanquantile(away, _MOSTLY, axis=0) > _AT_REST_M
    moving[moving] = moves & (count_positions(as_complex(usual[moves])) >= _LEAST_POSITIONS)
    return moving
