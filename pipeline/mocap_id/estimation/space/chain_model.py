"""Chains in space as arrays for the compiled filter, and start poses from the marker clusters of the segments."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.space.space_kernels import ChainModel, Pose
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
    return Pose(
        np.zeros((frames, 3)),
        np.tile(np.eye(3), (frames, n + 1, 1, 1)),
        np.zeros((frames, n, 2)),
        np.zeros((frames, 3, d)),
    )


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
        if len(own) >= LEAST_MARKERS and _measure_spread(chain.local[own]) > _LEAST_SPREAD:
            found[:, k] = seen[:, own].sum(axis=1) >= LEAST_MARKERS
    return found


def estimate_start_poses(
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
        turns[:, k], middle, centre = _fit_rotations(
            chain.local[_own_markers(chain, k)], some[:, _own_markers(chain, k)], known[:, k]
        )
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
            else:
                angle[:, 0] = _angle_between(np.broadcast_to(towards, (len(frames), 3)), between @ b, a)
            if joint.kind == "two-axis":
                left = np.swapaxes(joint.rotation(angle * [1.0, 0.0]), 1, 2) @ between
                angle[:, 1] = _nearest_angle(left, b)
            between = joint.rotation(angle[:, : joint.dimension])
            track.angle[frames, k] = angle
        track.turn[frames, k + 1], started[frames, k + 1] = between, both
    return track, started


def _own_markers(chain: SpatialChain, k: int) -> IntArray:
    return np.flatnonzero((chain.segment == k) & ~chain.on_glide)


def _measure_spread(local: FloatArray) -> float:
    return float(np.linalg.svd(local - local.mean(axis=0), compute_uv=False)[1])


def _fit_rotations(local: FloatArray, seen: FloatArray, known: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rotations (T, 3, 3) that fit ``local`` (m, 3) to ``seen`` (T, m, 3), and centroids of both (T, 3), m.

    The centroid of ``seen`` is first. Frames that are not ``known`` (T,) have the identity.
    """
    there = np.asarray(np.isfinite(seen).all(axis=2))[..., None]
    count = np.maximum(there.sum(axis=1), 1)
    middle = np.where(there, seen, 0.0).sum(axis=1) / count
    centre = (there * local).sum(axis=1) / count
    arms = np.where(there, seen - middle[:, None], 0.0)
    product = np.einsum("fmi,fmj->fij", arms, there * (local - centre[:, None]))
    product[~known] = np.eye(3)
    u, _, v = np.linalg.svd(product)
    u[..., 2] *= np.linalg.det(u @ v)[:, None]
    return u @ v, middle, centre


def _nearest_angle(rotation: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the angle (T,), rad, of the rotation about ``axis`` that is nearest to each rotation (T, 3, 3)."""
    across = np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    along = np.einsum("i,fij,j->f", axis, rotation, axis)
    return np.asarray(np.arctan2(across @ axis, np.trace(rotation, axis1=1, axis2=2) - along))


def _angle_between(start: FloatArray, end: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the angle (T,), rad, about ``axis`` from the directions ``start`` to the directions ``end`` (T, 3)."""
    across = np.cross(start, end) @ axis
    return np.asarray(np.arctan2(across, (start * end).sum(axis=1) - (start @ axis) * (end @ axis)))
