"""Poses of single frames from their own markers, and the standard deviation of each marker's errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.dropouts import find_rejected_segments
from mocap_id.estimation.space.chain_model import (
    LEAST_MARKERS,
    degrees_of_freedom,
    estimate_start_poses,
    find_visible_clusters,
    make_track,
    select_frames,
)
from mocap_id.estimation.space.slips import estimate_slips, remove_fast_part
from mocap_id.estimation.space.space_kernels import ChainModel, Found, Pose, Search, find_poses, predict_markers
from mocap_id.geometry.spatial_chain import SpatialChain

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

    ``points`` (F, M, 3) are the markers, m; NaN where missing. ``sd`` (M,) is the standard deviation of each marker's
    errors, m, ``rate`` the number of frames per second, and ``gate`` the limit of a residual in standard deviations.
    """
    ready = find_visible_clusters(chain, points)
    best = int(np.argmax(ready.sum(axis=1)))
    order = np.concatenate([np.arange(best, len(points)), np.arange(best - 1, -1, -1)])
    new = np.zeros(len(points), dtype=np.bool_)
    new[1:] = (ready[1:] & ~ready[:-1]).any(axis=1)
    new[:-1] |= (ready[:-1] & ~ready[1:]).any(axis=1)  # the search also runs backwards
    new[best] = True
    found = _search(chain, model, points, sd=sd, limit=gate * _LARGEST * sd, order=order, starts=new)
    _search_lost_again(chain, model, points, found, sd=sd, limit=gate * _LARGEST * sd)
    limit = gate * widen_sds(found, sd)
    for _ in range(_FILLS):
        with np.errstate(invalid="ignore"):
            found = replace(found, used=np.linalg.norm(found.residual, axis=2) < limit)
        partly = np.flatnonzero(~found.used.all(axis=1))
        if not partly.size:
            break
        slips = estimate_slips(_express_in_segments(chain, found), found.used, rate)
        kept = np.where(found.used[partly, :, None], points[partly], np.nan)
        near = Pose(*(each[partly] for each in found.track))
        displacements = (
            slips[partly] * found.observed[partly][:, model.segment, None]
        )  # others would spin without any limit
        again = _search(chain, model, kept, sd=sd, slips=displacements, near=near)
        for old, newer in zip(found.track, again.track, strict=True):
            old[partly] = newer
        for name in ("variance", "observed", "leverage"):
            getattr(found, name)[partly] = getattr(again, name)
        found.residual[partly] = points[partly] - predict_positions(model, again.track)
        found = replace(found, slips=slips)
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    rejected = find_rejected_segments(model.segment, found.observed.shape[1], visible, found.used)
    return replace(found, observed=found.observed & ~rejected)


def _search_lost_again(
    chain: SpatialChain, model: ChainModel, points: FloatArray, found: FramePoses, *, sd: FloatArray, limit: FloatArray
) -> None:
    """Search again, from the clusters, where over half of a segment's visible markers are not used; change ``found``.

    The search follows the frame before. After markers that were wrong, it can stay at a wrong pose for ever.
    """
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    rejected = find_rejected_segments(model.segment, found.observed.shape[1], visible, found.used)
    lost = np.flatnonzero((rejected & find_visible_clusters(chain, points)).any(axis=1))
    if not lost.size:
        return
    near, some = select_frames(found.track, lost), np.ascontiguousarray(points[lost])
    start, started = estimate_start_poses(chain, model, some, np.arange(len(lost)))
    near.origin[started[:, 0]] = start.origin[started[:, 0]]
    near.turn[started] = start.turn[started]
    near.angle[started[:, 1:]] = start.angle[started[:, 1:]]
    again = _search(chain, model, some, sd=sd, limit=limit, near=near)
    own = model.segment[:, None] == np.arange(rejected.shape[1])
    before, after = found.used[lost].astype(np.int64) @ own, again.used.astype(np.int64) @ own
    fits = ~find_rejected_segments(model.segment, rejected.shape[1], visible[lost], again.used) & (
        after >= LEAST_MARKERS
    )
    better = (rejected[lost] & fits).any(axis=1) & (after.sum(axis=1) > before.sum(axis=1))
    for name in ("variance", "observed", "used", "residual", "leverage"):
        getattr(found, name)[lost[better]] = getattr(again, name)[better]
    for old, newer in zip(found.track, again.track, strict=True):
        old[lost[better]] = newer[better]


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
    predict_markers(model, track, predicted, np.empty((0, len(model.segment), 3, track.rate.shape[2])))
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
        start, started = estimate_start_poses(
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
    observed = _find_observed(model, found.variance)
    return FramePoses(found.track, found.variance, observed, used, residual, found.leverage, slips)


def _find_observed(model: ChainModel, variance: FloatArray) -> BoolArray:
    weak = variance > OBSERVED_SD**2
    first = np.concatenate([[0], model.first[1:]])
    return np.asarray(~np.logical_or.reduceat(weak, first, axis=1), dtype=np.bool_)
