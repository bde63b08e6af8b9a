"""Chains as arrays, poses of single frames from their own markers, and the errors of each marker."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.smoothing import PAIRS, SKIN_MEMORY, find_gaps, find_rejected_segments, split_variance
from mocap_id.estimation.space.space_kernels import ChainModel, Found, Pose, Search, find_poses, locate_markers
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain

LEAST_MARKERS = 3  # of a segment, that determine its pose
_LEAST_SPREAD = 5e-3  # m, of a segment's markers across their longest direction


def make_chain_model(chain: SpatialChain) -> ChainModel:
    """Return the arrays of a chain for the compiled functions."""
    freedom = np.array([joint.dimension for joint in chain.joints], dtype=np.int64)

    def stack(name: str) -> FloatArray:
        parts = [getattr(joint, name) for joint in chain.joints]
        return np.array(parts, dtype=np.float64).reshape(len(parts), *((3, 3) if name == "offset" else (3,)))

    return ChainModel(
        ball=np.array([joint.kind == "ball" for joint in chain.joints], dtype=np.bool_),
        freedom=freedom,
        parent=np.array(chain.parents, dtype=np.int64),
        first=3 + np.concatenate([[0, 3], 3 + np.cumsum(freedom)[:-1]])[: len(freedom) + 1].astype(np.int64),
        centre=stack("centre"),
        first_axis=stack("first_axis"),
        second_axis=stack("second_axis"),
        offset=stack("offset"),
        glide=stack("glide"),
        rest=stack("rest"),
        long_axis=stack("long_axis"),
        segment=np.array(chain.segment, dtype=np.int64),
        local=np.array(chain.local, dtype=np.float64),
        on_glide=np.array(chain.on_glide, dtype=np.bool_),
    )


def degrees_of_freedom(model: ChainModel) -> int:
    """Return the number d of degrees of freedom: six of the base, and those of the joints."""
    return int(6 + model.freedom.sum())


def group_columns(model: ChainModel) -> list[slice]:
    """Return the slices of the degrees of freedom of the base (six) and of each joint, n + 1 in all."""
    starts = model.first[1:].tolist()
    return [slice(0, 6)] + [slice(at, at + int(size)) for at, size in zip(starts, model.freedom, strict=True)]


def make_track(model: ChainModel, frames: int) -> Pose:
    """Return poses for ``frames`` frames, at rest, with identity rotations and all coordinates zero."""
    n, d = len(model.freedom), degrees_of_freedom(model)
    turns = np.tile(np.eye(3), (frames, n + 1, 1, 1))
    return Pose(np.zeros((frames, 3)), turns, np.zeros((frames, n, 2)), np.zeros((frames, 3, d)))


def select_frames(track: Pose, frames: slice | IntArray) -> Pose:
    """Return a copy of the poses in the chosen frames."""
    return Pose(*(np.ascontiguousarray(each[frames]) for each in track))


def sum_steps(model: ChainModel, track: Pose) -> FloatArray:
    """Return one series (F, d) for each degree of freedom, m or rad.

    For the base and ball joints, it is the sum of the rotation vectors between successive frames, in the segment's
    axes. The position of the base and the coordinates of other joints are not changed.
    """
    steps = np.zeros((len(track.origin), degrees_of_freedom(model)))
    steps[:, :3] = track.origin
    for k in range(track.turn.shape[1]):
        at = int(model.first[k])
        if k == 0 or model.ball[k - 1]:
            stepwise = so3.log(np.swapaxes(track.turn[:-1, k], 1, 2) @ track.turn[1:, k])
            steps[1:, at : at + 3] = np.cumsum(stepwise, axis=0)
        else:
            size = int(model.freedom[k - 1])
            steps[:, at : at + size] = track.angle[:, k - 1, :size]
    return steps


def find_visible_clusters(chain: SpatialChain, points: FloatArray) -> BoolArray:
    """Return where (F, n + 1) the visible markers of a segment, without those of a glide, determine its pose.

    ``points`` (F, M, 3) are the markers, m; NaN where missing.
    """
    seen = np.asarray(np.isfinite(points).all(axis=2))
    found = np.zeros((len(points), len(chain.joints) + 1), dtype=np.bool_)
    for k in range(found.shape[1]):
        own = _own_markers(chain, k)
        if len(own) < LEAST_MARKERS:
            continue
        centred = chain.local[own] - chain.local[own].mean(axis=0)
        if float(np.linalg.svd(centred, compute_uv=False)[1]) > _LEAST_SPREAD:
            found[:, k] = seen[:, own].sum(axis=1) >= LEAST_MARKERS
    return found


def _estimate_start_poses(
    chain: SpatialChain, model: ChainModel, points: FloatArray, frames: IntArray
) -> tuple[Pose, BoolArray]:
    """Return the poses of F frames, estimated in ``frames`` (T,) from the marker cluster of each segment.

    Also return where (F, n + 1) the base or joint was estimated. All other coordinates are zero. ``points`` (F, M, 3)
    are the markers, m; NaN where missing.
    """
    track, started = make_track(model, len(points)), np.zeros((len(points), len(model.freedom) + 1), dtype=np.bool_)
    some = points[frames]
    known = find_visible_clusters(chain, some)
    turns = np.tile(np.eye(3), (*known.shape, 1, 1))
    for k in range(known.shape[1]):
        # the rotations that fit the chain's markers to the measured ones; the identity where not known
        own = _own_markers(chain, k)
        local, seen = chain.local[own], some[:, own]
        there = np.asarray(np.isfinite(seen).all(axis=2))[..., None]
        count = np.maximum(there.sum(axis=1), 1)
        middle = np.where(there, seen, 0.0).sum(axis=1) / count
        centre = (there * local).sum(axis=1) / count
        arms = np.where(there, seen - middle[:, None], 0.0)
        product = np.einsum("fmi,fmj->fij", arms, there * (local - centre[:, None]))
        product[~known[:, k]] = np.eye(3)
        u, _, v = np.linalg.svd(product)
        u[..., 2] *= np.linalg.det(u @ v)[:, None]
        turns[:, k] = u @ v
        if k == 0:
            track.origin[frames] = middle - np.einsum("fij,fj->fi", turns[:, 0], centre)
    track.turn[frames, 0], started[frames, 0] = turns[:, 0], known[:, 0]
    for k, joint in enumerate(chain.joints):
        between = np.swapaxes(turns[:, joint.parent], 1, 2) @ turns[:, k + 1]
        both = known[:, joint.parent] & known[:, k + 1]
        if joint.kind != "ball":
            angle = np.zeros((len(frames), 2))
            a, b, offset = joint.first_axis, joint.second_axis, joint.offset
            towards = offset @ b if joint.kind == "two-axis" else None
            if towards is None or np.linalg.norm(np.cross(a, towards)) < 0.1:
                angle[:, 0] = _nearest_angle(between @ offset.T, a)
            else:  # the angle about the first axis between the two directions of the second axis
                start, end = np.broadcast_to(towards, (len(frames), 3)), between @ b
                across = np.cross(start, end) @ a
                angle[:, 0] = np.arctan2(across, (start * end).sum(axis=1) - (start @ a) * (end @ a))
            if joint.kind == "two-axis":
                left = np.swapaxes(joint.rotation(angle * [1.0, 0.0]), 1, 2) @ between
                angle[:, 1] = _nearest_angle(left, b)
            between = joint.rotation(angle[:, : joint.dimension])
            track.angle[frames, k] = angle
        track.turn[frames, k + 1], started[frames, k + 1] = between, both
    return track, started


def _own_markers(chain: SpatialChain, k: int) -> IntArray:
    return np.flatnonzero((chain.segment == k) & ~chain.on_glide)


def _nearest_angle(rotation: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the angle (T,), rad, of the rotation about ``axis`` that is nearest to each rotation (T, 3, 3)."""
    r = rotation
    across = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    along = np.einsum("i,fij,j->f", axis, r, axis)
    return np.asarray(np.arctan2(across @ axis, np.trace(r, axis1=1, axis2=2) - along))


_SLOW = 0.15  # s, length of a moving average; three of them pass less than half of the amplitude above 2 Hz


def remove_fast_part(series: FloatArray, rate: float) -> FloatArray:
    """Return series (F, …) smoothed by three moving averages; ``rate`` is in samples per second."""
    half = max(round(_SLOW * rate / 2), 1)
    slow, every = series, np.arange(len(series))
    low, high = np.maximum(every - half, 0), np.minimum(every + half + 1, len(series))
    count = (high - low).reshape(-1, *[1] * (series.ndim - 1))
    for _ in range(3):
        total = np.concatenate([np.zeros((1, *slow.shape[1:])), np.cumsum(slow, axis=0)])
        slow = (total[high] - total[low]) / count
    return slow


OBSERVED_SD = 0.1  # largest standard deviation of an angle, rad, that a frame's own markers determine

_WEAK_SD = 1.0  # rad and m; prior of degrees of freedom that no marker determines
_SOME = 300  # frames from which the standard deviations of the errors are estimated
_ROUNDS = 3  # the errors depend on the poses, and the poses on the standard deviations of the errors
_WIDE = 0.05  # m; larger residuals count little as long as the standard deviations of the errors are unknown
_LEAST_SHARE = 0.25  # least standard deviation of a marker, relative to the rms of its segment
_QUANTILE, _BEYOND = 0.8, 6.0  # squares larger than this multiple of their quantile do not count in full
_FILLS = 2  # iterations, because the residuals beside a gap depend on the poses in other markers' gaps
_USUAL, _OF_NORMAL = 0.975, 3.06  # quantile of residuals that are no outliers, and its value for unit variance
_LARGEST = 3.0  # largest ordinary displacement of a marker, in standard deviations


@dataclass(frozen=True)
class FramePoses:
    """Poses of F single frames."""

    track: Pose  # poses without rates
    variance: FloatArray  # (F, d) variances of the pose due to the markers' errors, rad² or m²
    observed: BoolArray  # (F, n + 1) the frame's markers determine the base and each joint
    used: BoolArray  # (F, M) markers that are not outliers
    residual: FloatArray  # (F, M, 3) in the frame of the trial, m; NaN where missing
    leverage: FloatArray  # (F, M) fraction of a marker's error that the pose follows
    slips: FloatArray  # (F, M, 3) assumed displacements of unused markers in their segments' frames, m


def estimate_marker_sds(chain: SpatialChain, model: ChainModel, points: FloatArray, floor: float) -> FloatArray:
    """Return the standard deviation (M,) of a coordinate of each marker around its position on the chain, m.

    It includes errors from skin. It is estimated from some frames of ``points`` (F, M, 3), m, and corrected for the
    fraction of the error that the fitted pose follows (leverage). It is at least ``floor``, m, and at least a quarter
    of the rms value of its segment.
    """
    ready = find_visible_clusters(chain, points)
    determined = ready.sum(axis=1)
    frames = np.unique(np.linspace(0, len(points) - 1, _SOME).round().astype(np.int64))
    frames = frames[determined[frames] == determined[frames].max()]
    sd, limit = np.full(len(model.segment), 5e-3), np.full(len(model.segment), _WIDE)
    some = np.ascontiguousarray(points[frames])
    for _ in range(_ROUNDS):
        found = _search(chain, model, some, sd=sd, limit=limit)
        own = estimate_residual_sds(found)
        for s in np.unique(model.segment):
            mine = model.segment == s
            usual = np.sqrt(np.nanmean(own[mine] ** 2)) if np.isfinite(own[mine]).any() else 5e-3
            sd[mine] = np.maximum(np.where(np.isfinite(own[mine]), own[mine], usual), _LEAST_SHARE * usual)
        sd = np.maximum(sd, floor)
        limit = np.maximum(8.0 * sd, 10 * floor)
    return sd


def estimate_residual_sds(found: FramePoses) -> FloatArray:
    """Return the standard deviation (M,) of each marker's coordinate, m, from its residuals; NaN if never used."""
    own = np.full(found.used.shape[1], np.nan)
    for m in np.flatnonzero(found.used.any(axis=0)):
        kept = found.used[:, m]
        squares = np.sum(found.residual[kept, m] ** 2, axis=1)
        left = max(1.0 - float(found.leverage[kept, m].mean()), 0.05)
        most = np.quantile(squares, _QUANTILE) * _BEYOND
        own[m] = np.sqrt(np.mean(np.minimum(squares, most)) / 3.0 / left)
    return own


def find_frame_poses(
    chain: SpatialChain, model: ChainModel, points: FloatArray, sd: FloatArray, *, rate: float, gate: float
) -> FramePoses:
    """Return the poses of all frames, found one after the other from the most complete frame to both ends.

    ``sd`` (M,) is the standard deviation of each marker's errors, m, and ``gate`` the limit of a residual in standard
    deviations.
    """
    ready = find_visible_clusters(chain, points)
    best = int(np.argmax(ready.sum(axis=1)))
    order = np.concatenate([np.arange(best, len(points)), np.arange(best - 1, -1, -1)])
    new = np.zeros(len(points), dtype=np.bool_)
    new[1:] = (ready[1:] & ~ready[:-1]).any(axis=1)
    new[:-1] |= (ready[:-1] & ~ready[1:]).any(axis=1)  # the search also runs backwards
    new[best] = True
    found = _search(chain, model, points, sd=sd, limit=gate * _LARGEST * sd, order=order, starts=new)
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    # The search follows the frame before. After markers that were wrong, it can stay at a wrong pose for ever. It is
    # repeated from the clusters where over half of a segment's visible markers are not used.
    rejected = find_rejected_segments(model.segment, ready.shape[1], visible, found.used)
    lost = np.flatnonzero((rejected & ready).any(axis=1))
    if lost.size:
        near, some = select_frames(found.track, lost), np.ascontiguousarray(points[lost])
        start, started = _estimate_start_poses(chain, model, some, np.arange(len(lost)))
        near.origin[started[:, 0]] = start.origin[started[:, 0]]
        near.turn[started] = start.turn[started]
        near.angle[started[:, 1:]] = start.angle[started[:, 1:]]
        again = _search(chain, model, some, sd=sd, limit=gate * _LARGEST * sd, near=near)
        own = model.segment[:, None] == np.arange(ready.shape[1])
        before, after = found.used[lost].astype(np.int64) @ own, again.used.astype(np.int64) @ own
        fits = ~find_rejected_segments(model.segment, ready.shape[1], visible[lost], again.used)
        fits &= after >= LEAST_MARKERS
        better = (rejected[lost] & fits).any(axis=1) & (after.sum(axis=1) > before.sum(axis=1))
        for name in ("variance", "observed", "used", "residual", "leverage"):
            getattr(found, name)[lost[better]] = getattr(again, name)[better]
        for old, newer in zip(found.track, again.track, strict=True):
            old[lost[better]] = newer[better]
    limit = gate * widen_sds(found, sd)
    for _ in range(_FILLS):
        with np.errstate(invalid="ignore"):
            found = replace(found, used=np.linalg.norm(found.residual, axis=2) < limit)
        partly = np.flatnonzero(~found.used.all(axis=1))
        if not partly.size:
            break
        # the expected displacement of each marker where it is not used, from its residuals beside its gaps
        own, slips = _express_in_segments(chain, found), np.zeros(points.shape)
        for m in np.flatnonzero(~found.used.all(axis=0) & found.used.any(axis=0)).tolist():
            residual, there = own[:, m], found.used[:, m]
            gaps, pairs = find_gaps(there, SKIN_MEMORY * rate), np.flatnonzero(there[1:] & there[:-1])
            pairs = pairs[:: max(1, len(pairs) // PAIRS)]
            lasting, noise = split_variance(residual[pairs], residual[pairs + 1]) if pairs.size else (0.0, 1.0)
            means = []  # (G, 3) before and after the gaps, reduced towards zero according to their noise
            for at in gaps.beside:
                seen = (at >= 0) & there[at]
                count = seen.sum(axis=1, keepdims=True)
                total = np.where(seen[..., None], residual[at], 0.0).sum(axis=1)
                weight = np.maximum(count * lasting + noise, np.finfo(np.float64).tiny)
                means.append(np.where(count > 0, lasting * total / weight, np.nan))
            slips[gaps.missing, m] = gaps.bridge(*means)
        del own
        kept = np.where(found.used[partly, :, None], points[partly], np.nan)
        near = Pose(*(each[partly] for each in found.track))
        # a segment that the markers do not determine would spin without any limit
        displacements = slips[partly] * found.observed[partly][:, model.segment, None]
        again = _search(chain, model, kept, sd=sd, slips=displacements, near=near)
        for old, newer in zip(found.track, again.track, strict=True):
            old[partly] = newer
        for name in ("variance", "observed", "leverage"):
            getattr(found, name)[partly] = getattr(again, name)
        found.residual[partly] = points[partly] - predict_positions(model, again.track)
        found = replace(found, slips=slips)
    rejected = find_rejected_segments(model.segment, found.observed.shape[1], visible, found.used)
    return replace(found, observed=found.observed & ~rejected)


def widen_sds(found: FramePoses, sd: FloatArray) -> FloatArray:
    """Return ``sd`` (M,), m, increased by up to a factor of 3 where residuals are large but not outliers."""
    wide = sd.copy()
    for m in range(len(sd)):
        off = np.linalg.norm(found.residual[:, m], axis=1)
        off = off[np.isfinite(off)]
        if off.size:
            wide[m] = min(max(sd[m], float(np.quantile(off, _USUAL)) / _OF_NORMAL), _LARGEST * sd[m])
    return wide


def remove_displacements(
    chain: SpatialChain, model: ChainModel, points: FloatArray, found: FramePoses, *, rate: float, camera: float
) -> tuple[FramePoses, FloatArray]:
    """Return poses fitted to the markers without their slow displacements, and these markers (F, M, 3), m.

    The displacements are the slow part of the residuals of ``found``, in which markers with large errors have small
    weights. The new fit weights all markers equally, because only their white noise, with the standard deviation
    ``camera``, m, is left. The poses do not jump when a marker vanishes.
    """
    own = np.where(found.used[..., None], _express_in_segments(chain, found), found.slips)
    slow = remove_fast_part(own, rate)
    turns = chain.place(found.track.origin, found.track.turn[:, 0], found.track.turn[:, 1:])[1]
    kept = np.where(found.used[..., None], points, np.nan)
    for m, s in enumerate(model.segment.tolist()):
        kept[:, m] -= np.einsum("fij,fj->fi", turns[:, s], slow[:, m])
    again = _search(chain, model, kept, sd=np.full(len(model.segment), camera), near=found.track)
    return replace(again, observed=found.observed), kept


def predict_positions(model: ChainModel, track: Pose) -> FloatArray:
    """Return the positions (F, M, 3) of all markers on the chain, m."""
    predicted = np.empty((len(track.origin), len(model.segment), 3))
    locate_markers(model, track, predicted, np.empty((0, len(model.segment), 3, track.rate.shape[2])))
    return predicted


def _express_in_segments(chain: SpatialChain, found: FramePoses) -> FloatArray:
    """Return the residuals (F, M, 3), m, in the axes of the markers' segments."""
    turns = chain.place(found.track.origin, found.track.turn[:, 0], found.track.turn[:, 1:])[1]
    own = np.empty_like(found.residual)
    for s in np.unique(chain.segment):
        mine = chain.segment == s
        own[:, mine] = found.residual[:, mine] @ turns[:, s]
    return own


def _search(
    chain: SpatialChain,
    model: ChainModel,
    points: FloatArray,
    *,
    sd: FloatArray,
    limit: FloatArray | None = None,
    order: IntArray | None = None,
    starts: BoolArray | None = None,
    slips: FloatArray | None = None,
    near: Pose | None = None,
) -> FramePoses:
    """Fit poses by Gauss–Newton from ``near`` if given, otherwise from the clusters in the frames ``starts`` (F,).

    ``starts`` (all frames if None) and ``order`` (F,), the sequence of frames, belong to a search without ``near``.
    """
    frames, count = points.shape[:2]
    d = degrees_of_freedom(model)
    if near is None:
        start, started = _estimate_start_poses(
            chain, model, points, np.flatnonzero(np.ones(frames) if starts is None else starts)
        )
    else:
        start, started = near, np.ones((frames, len(model.freedom) + 1), dtype=np.bool_)
    slips = np.zeros(points.shape) if slips is None else slips
    search = Search(
        order=np.arange(frames) if order is None else order.astype(np.int64),
        weight=1.0 / sd**2,
        limit=np.full(count, np.inf) if limit is None else limit,
        prior=np.full(d, 1.0 / _WEAK_SD**2),
    )
    used = np.zeros((frames, count), dtype=np.bool_)
    found = Found(make_track(model, frames), used, np.empty((frames, d)), np.empty((frames, count)))
    find_poses(model, search, np.ascontiguousarray(points), slips, start, started, found)
    residual = points - predict_positions(model, found.track)
    weak = found.variance > OBSERVED_SD**2
    observed = np.asarray(~np.logical_or.reduceat(weak, np.concatenate([[0], model.first[1:]]), axis=1), dtype=np.bool_)
    return FramePoses(found.track, found.variance, observed, used, residual, found.leverage, slips)
