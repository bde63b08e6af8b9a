"""Poses of single frames from their own markers, and the size of each marker's errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.space.chain_model import degrees_of_freedom, empty_track, seen_clusters, start_poses
from mocap_id.estimation.space.slips import find_slips, slow_part
from mocap_id.estimation.space.space_kernels import ChainModel, Found, Pose, Search, find_poses, predict_markers
from mocap_id.geometry.spatial_chain import SpatialChain

OBSERVED_SD = 0.1
"""Largest standard deviation of an angle, rad, that a frame's own markers determine."""

_WEAK_SD = 1.0  # rad and m; prior of what no marker determines
_SOME = 300  # frames for the size of the errors
_ROUNDS = 3  # the sizes depend on the poses, and these on the sizes
_WIDE = 0.05  # m; residual that counts little before the sizes are known
_LEAST_SHARE = 0.25  # of the segment's rms size, least size of a marker
_QUANTILE, _BEYOND = 0.8, 6.0  # larger squares than this multiple of their quantile do not count in full
_FILLS = 2  # the residuals beside a gap depend on poses in other markers' gaps
_USUAL, _OF_NORMAL = 0.975, 3.06  # quantile of residuals that are no outliers, and its value for unit variance
_LARGEST = 3.0  # times its size, largest deviation of a marker that is ordinary


@dataclass(frozen=True)
class FramePoses:
    """Poses of single frames.

    Parameters
    ----------
    track : Pose
        Poses of F frames, no rates.
    variance : (F, d) array
        Variances of the pose for errors of the markers' size, rad² or m².
    observed : (F, n + 1) bool array
        The frame's markers determine the base and each joint.
    used : (F, M) bool array
        Markers that are not outliers.
    residual : (F, M, 3) array
        m, in the frame of the trial; NaN where unseen.
    leverage : (F, M) array
        Share of a marker's error that the pose follows.
    slips : (F, M, 3) array
        Displacements with which markers that are not used push, in their segments' frames, m.
    """

    track: Pose
    variance: FloatArray
    observed: BoolArray
    used: BoolArray
    residual: FloatArray
    leverage: FloatArray
    slips: FloatArray


def marker_sizes(chain: SpatialChain, model: ChainModel, points: FloatArray, floor: float) -> FloatArray:
    """Return the standard deviation (M,) of a coordinate of each marker around its place on the chain, m.

    It includes the skin. It is estimated from some frames, and corrected for the part of the error that the fitted pose
    absorbs (leverage). It is at least a share of the rms value of the segment, and at least ``floor``.

    Parameters
    ----------
    chain : SpatialChain
    model : ChainModel
    points : (F, M, 3) array
        Measured markers, m; NaN where missing.
    floor : float
        m.
    """
    ready = seen_clusters(chain, points)
    complete = ready.sum(axis=1)
    frames = np.unique(np.linspace(0, len(points) - 1, _SOME).round().astype(np.int64))
    frames = frames[complete[frames] == complete[frames].max()]
    size, limit = np.full(len(model.segment), 5e-3), np.full(len(model.segment), _WIDE)
    some = np.ascontiguousarray(points[frames])
    for _ in range(_ROUNDS):
        found = _search(chain, model, some, size=size, limit=limit)
        own = own_sizes(found)
        for s in np.unique(model.segment):
            mine = model.segment == s
            usual = np.sqrt(np.nanmean(own[mine] ** 2)) if np.isfinite(own[mine]).any() else 5e-3
            size[mine] = np.maximum(np.where(np.isfinite(own[mine]), own[mine], usual), _LEAST_SHARE * usual)
        size = np.maximum(size, floor)
        limit = np.maximum(8.0 * size, 10 * floor)
    return size


def own_sizes(found: FramePoses) -> FloatArray:
    """Return the standard deviation (M,) of a coordinate's residual, with the share that the pose follows; or NaN."""
    own = np.full(found.used.shape[1], np.nan)
    for m in np.flatnonzero(found.used.any(axis=0)):
        kept = found.used[:, m]
        squares = np.sum(found.residual[kept, m] ** 2, axis=1)
        left = max(1.0 - float(found.leverage[kept, m].mean()), 0.05)
        most = np.quantile(squares, _QUANTILE) * _BEYOND
        own[m] = np.sqrt(np.mean(np.minimum(squares, most)) / 3.0 / left)
    return own


def find_frame_poses(
    chain: SpatialChain, model: ChainModel, points: FloatArray, size: FloatArray, *, rate: float, gate: float
) -> FramePoses:
    """Find the poses of all frames, from the most complete frame to both ends.

    Parameters
    ----------
    chain : SpatialChain
    model : ChainModel
    points : (F, M, 3) array
        Markers, m; NaN where unseen.
    size : (M,) array
        Standard deviation of each marker's errors, m.
    rate : float
        Frames per second.
    gate : float
        Limit of a residual, in standard deviations.
    """
    ready = seen_clusters(chain, points)
    best = int(np.argmax(ready.sum(axis=1)))
    order = np.concatenate([np.arange(best, len(points)), np.arange(best - 1, -1, -1)])
    new = np.zeros(len(points), dtype=np.bool_)
    new[1:] = (ready[1:] & ~ready[:-1]).any(axis=1)
    new[:-1] |= (ready[:-1] & ~ready[1:]).any(axis=1)  # the search also runs backwards
    new[best] = True
    found = _search(chain, model, points, size=size, limit=gate * _LARGEST * size, order=order, starts=new)
    limit = gate * ordinary_sizes(found, size)
    for _ in range(_FILLS):
        with np.errstate(invalid="ignore"):
            found = replace(found, used=np.linalg.norm(found.residual, axis=2) < limit)
        partly = np.flatnonzero(~found.used.all(axis=1))
        if not partly.size:
            break
        slips = find_slips(_in_segments(chain, found), found.used, rate)
        kept = np.where(found.used[partly, :, None], points[partly], np.nan)
        near = Pose(*(each[partly] for each in found.track))
        push = slips[partly] * found.observed[partly][:, model.segment, None]  # it would spin what no marker holds
        again = _search(chain, model, kept, size=size, slips=push, near=near)
        for old, newer in zip(found.track, again.track, strict=True):
            old[partly] = newer
        for name in ("variance", "observed", "leverage"):
            getattr(found, name)[partly] = getattr(again, name)
        found.residual[partly] = points[partly] - predicted_markers(model, again.track)
        found = replace(found, slips=slips)
    return found


def ordinary_sizes(found: FramePoses, size: FloatArray) -> FloatArray:
    """Return standard deviations (M,) that include the largest ordinary displacements of the skin, m."""
    sizes = size.copy()
    for m in range(len(size)):
        off = np.linalg.norm(found.residual[:, m], axis=1)
        off = off[np.isfinite(off)]
        if off.size:
            sizes[m] = min(max(size[m], float(np.quantile(off, _USUAL)) / _OF_NORMAL), _LARGEST * size[m])
    return sizes


def without_displacements(
    chain: SpatialChain, model: ChainModel, points: FloatArray, found: FramePoses, *, rate: float, camera: float
) -> tuple[FramePoses, FloatArray]:
    """Return poses from equally weighted markers without their lasting displacements, and these markers (F, M, 3).

    Slow displacements then follow the weights of the whole error, and white noise averages over all markers. Where a
    marker is missing, the others show no step.
    """
    own = np.where(found.used[..., None], _in_segments(chain, found), found.slips)
    slow = slow_part(own, rate)
    turns = chain.place(found.track.origin, found.track.turn[:, 0], found.track.turn[:, 1:])[1]
    kept = np.where(found.used[..., None], points, np.nan)
    for m, s in enumerate(model.segment.tolist()):
        kept[:, m] -= np.einsum("fij,fj->fi", turns[:, s], slow[:, m])
    again = _search(chain, model, kept, size=np.full(len(model.segment), camera), near=found.track)
    return replace(again, observed=found.observed), kept


def predicted_markers(model: ChainModel, track: Pose) -> FloatArray:
    """Return the positions (F, M, 3) of all markers, m."""
    predicted = np.empty((len(track.origin), len(model.segment), 3))
    predict_markers(model, track, predicted, np.empty((0, len(model.segment), 3, track.rate.shape[2])))
    return predicted


def _in_segments(chain: SpatialChain, found: FramePoses) -> FloatArray:
    """Return the residuals (F, M, 3) in the frames of the segments."""
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
    size: FloatArray,
    limit: FloatArray | None = None,
    order: IntArray | None = None,
    starts: BoolArray | None = None,
    slips: FloatArray | None = None,
    near: Pose | None = None,
) -> FramePoses:
    """Run Gauss–Newton from the clusters where ``starts`` (F,), or from the poses ``near`` in every frame."""
    frames, count = points.shape[:2]
    d = degrees_of_freedom(model)
    if near is None:
        start, started = start_poses(
            chain, model, points, np.flatnonzero(np.ones(frames) if starts is None else starts)
        )
    else:
        start, started = near, np.ones((frames, len(model.freedom) + 1), dtype=np.bool_)
    slips = np.zeros(points.shape) if slips is None else slips
    search = Search(
        order=np.arange(frames) if order is None else order.astype(np.int64),
        weight=1.0 / size**2,
        limit=np.full(count, np.inf) if limit is None else limit,
        prior=np.full(d, 1.0 / _WEAK_SD**2),
    )
    used = np.zeros((frames, count), dtype=np.bool_)
    found = Found(empty_track(model, frames), used, np.empty((frames, d)), np.empty((frames, count)))
    find_poses(model, search, np.ascontiguousarray(points), slips, start, started, found)
    residual = points - predicted_markers(model, found.track)
    observed = _observed(model, found.variance)
    return FramePoses(found.track, found.variance, observed, used, residual, found.leverage, slips)


def _observed(model: ChainModel, variance: FloatArray) -> BoolArray:
    weak = variance > OBSERVED_SD**2
    first = np.concatenate([[0], model.first[1:]])
    return np.asarray(~np.logical_or.reduceat(weak, first, axis=1), dtype=np.bool_)
