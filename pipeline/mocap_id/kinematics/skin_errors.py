"""What slipping skin, and a chain fitted to it, do to the angles that the markers give.

The model is that of :mod:`mocap_id.kinematics.centre_covariance`: every marker slides within its segment, either way,
in proportion to the angle of the joint below and to that of the joint above. A slide e turns the segments by

    da = A^-1 (S^H W e - C dc),

A and C being the angles' blocks of the normal equations, S what the markers do as the segments turn, and dc what the
slide did to the centres and coordinates of the joint fit. What of a residual lasts without following the joints
(wander, curvature) counts beside it, and so does what camera noise did to the joint fit. No size is set by hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.centre_covariance import responses, swings
from mocap_id.kinematics.chain_equations import (
    Problem,
    State,
    joint_positions,
    left_by_pose,
    normal_equations,
    reduce,
    shared_variance,
)
from mocap_id.kinematics.sampling import frames_along_motion

_FRAMES = 400  # of the joint fit that is re-traced
_RATE = 30.0  # Hz; postures a second at which the errors are computed, a movement's own frequencies being below 3 Hz
_EXACT = 1e-4  # m; markers with smaller residuals weigh alike, as in the joint fit
_CHUNK = 500  # postures at a time, to bound the memory
_OVERLAP = 3  # postures that the next chunk has in common with this one, for the derivatives


@dataclass(frozen=True)
class _Skin:
    """The linearised chain with its markers' slides.

    Parameters
    ----------
    state : State
        Centres, coordinates, and absolute angles of all frames.
    problem : Problem
        Of all frames, without points; each marker weighs as often as it is seen.
    size, rest : (K,) arrays
        Variances of what lasts of a marker's residual, and of its part that does not follow the joints, m^2 a
        coordinate.
    mean, spread : (n,) and (K,) arrays
        Of the shapes.
    moved : (K, 2, 2, P) array
        The common unknowns' responses.
    noise : (P, P) array
        Square root of the common unknowns' covariance from camera noise, m.
    """

    state: State
    problem: Problem
    size: FloatArray
    rest: FloatArray
    mean: FloatArray
    spread: FloatArray
    moved: FloatArray
    noise: FloatArray


def angle_errors(
    points: ComplexArray,
    segment: IntArray,
    centres: ComplexArray,
    local: ComplexArray,
    angles: FloatArray,
    *,
    observed: BoolArray,
    camera_sd: float,
    rate: float,
) -> tuple[IntArray, FloatArray]:
    """Variance of the errors of angle and derivatives that last: those of skin, and of the chain's geometry.

    Parameters
    ----------
    points : (F, M) complex array
        Markers in the plane, m; NaN where unseen or left out.
    segment : (M,) int array
        Of each, 1 … n.
    centres, local : (n,) and (M,) complex arrays
        The fitted chain, m.
    angles : (F, n) array
        Angle of each joint, rad, finite.
    observed : (F,) bool array
        The frame's markers determine every angle.
    camera_sd : float
        Camera noise of a coordinate, m.
    rate : float
        Frames per second.

    Returns
    -------
    frames : (T,) int array
        At which the variances are given.
    variance : (T, n, 4) array
        Of angle less its mean error, velocity, acceleration and jerk of each joint, SI.
    """
    seen = np.isfinite(points).any(axis=0)
    points = points if seen.all() else points[:, seen]
    state = State(centres, local[seen], np.cumsum(angles, axis=1))
    skin = _linearised(points, segment[seen], state, np.flatnonzero(observed), camera_sd)
    step = max(1, round(rate / _RATE))
    frames = np.arange(0, len(angles), step)
    mean = _series(skin, frames[:: max(1, len(frames) // _FRAMES)])[0].mean(axis=0)
    parts = [_variance(skin, frames[own], mean, step / rate)[kept] for own, kept in _chunks(len(frames))]
    return frames, np.concatenate(parts)


def _linearised(points: ComplexArray, segment: IntArray, state: State, observed: IntArray, camera_sd: float) -> _Skin:
    """Sizes of the slides from what lasts of the residuals, and the joint fit's answer to each of them."""
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    mean = relative.mean(axis=0)
    relative -= mean
    spread = _spread(relative)[segment - 1]
    size, rest, square, often = _sizes(points, segment, state, relative, spread)
    used = frames_along_motion(points, _FRAMES, observed)
    seen, weight = np.isfinite(points[used]), 1.0 / np.maximum(square, _EXACT**2)
    pinned = np.zeros(len(segment), dtype=np.bool_)
    fitted = Problem(
        np.where(seen, points[used], 0), seen * (weight / weight.mean()), segment, pinned, len(state.centres)
    )
    traced = replace(state, angles=state.angles[used])
    reduced = reduce(fitted, traced)
    moved = responses(fitted, traced, reduced, _shapes(relative[used], spread, segment), reduced.inverse)
    values, vectors = np.linalg.eigh(reduced.inverse)
    noise = vectors * (camera_sd * np.sqrt(np.maximum(values, 0)))
    share = replace(fitted, points=fitted.points[:1], weights=often[None])
    return _Skin(state, share, size, rest, mean, spread, moved, noise)


def _spread(relative: FloatArray) -> FloatArray:
    """(n,) root mean square of a segment's shapes, 1 where nothing moves; from angles (F, n) off their mean."""
    square = np.zeros((relative.shape[1] + 1, len(relative)))
    square[:-1] = relative.T**2
    spread = np.sqrt(np.mean(square[:-1] + square[1:], axis=1))
    return np.where(spread > 0, spread, 1)


def _shapes(relative: FloatArray, spread: FloatArray, segment: IntArray) -> FloatArray:
    """(T, K, 2) angles (T, n) of the joints below and above each marker, over its spread."""
    beyond = np.concatenate([relative, np.zeros((len(relative), 1))], axis=1)
    return np.asarray(np.stack([beyond[:, segment - 1], beyond[:, segment]], axis=2) / spread[:, None])


def _sizes(
    points: ComplexArray, segment: IntArray, state: State, relative: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Variances (K,), m^2 a coordinate, of what lasts, of what of it does not follow the shapes, and weights' inverse.

    What of a residual is still there one frame later is no camera noise. The last is how often each marker is seen.
    """
    origin, turn = joint_positions(state)
    found = np.empty((4, len(segment)))
    for k, joint in enumerate(segment - 1):  # one by one, to bound the memory
        off = (points[:, k] - (origin[:, joint] + turn[:, joint] * state.local[k])) * np.conj(turn[:, joint])
        found[:, k] = _own_sizes(off, _shapes(relative, spread[k : k + 1], segment[k : k + 1])[:, 0])
    size, rest, square, often = found
    square = shared_variance(square, often, segment, state.local)  # as the joint fit weighs
    for k in range(1, len(state.centres) + 1):
        members = segment == k
        weights = often[members] / np.maximum(square[members], _EXACT**2)
        size[members] /= left_by_pose(weights, state.local[members])
        rest[members] /= left_by_pose(weights, state.local[members])
    return size, np.minimum(rest, size), square, often


def _own_sizes(off: ComplexArray, shape: FloatArray) -> tuple[float, float, float, float]:
    """Variances of what lasts of a marker's offset (F,), of what is left of it beside its shapes (F, 2), and of the
    offset, m^2 a coordinate; and how often the marker is seen.
    """
    seen = np.isfinite(off)
    off = np.where(seen, off, 0)
    basis, left = np.column_stack([np.ones(np.count_nonzero(seen)), shape[seen]]), off.copy()
    left[seen] -= basis @ np.linalg.lstsq(basis, off[seen], rcond=None)[0]
    square = np.sum(np.abs(off) ** 2) / max(np.count_nonzero(seen), 1) / 2
    return _lasting(off, seen), _lasting(left, seen), float(square), float(np.mean(seen))


def _lasting(off: ComplexArray, seen: BoolArray) -> float:
    """Covariance of a marker's offset (F,) with itself one frame later, a coordinate, m^2."""
    pairs = max(int(np.count_nonzero(seen[1:] & seen[:-1])), 1)
    return max(float((np.conj(off[1:]) * off[:-1]).real.sum()) / pairs, 0.0) / 2


def _series(skin: _Skin, frames: IntArray) -> tuple[FloatArray, FloatArray]:
    """(T, n, 4 K + P) joint angle errors that follow the posture, one standard deviation each, and (T, n) variance of
    those that do not.
    """
    count, n, segment = len(frames), skin.problem.joints, skin.problem.segment
    state = replace(skin.state, angles=skin.state.angles[frames])
    weights = np.broadcast_to(skin.problem.weights, (count, len(segment)))
    problem = replace(skin.problem, points=np.zeros(weights.shape, dtype=np.complex128), weights=weights)
    normal = normal_equations(problem, state)
    relative = np.diff(state.angles, axis=1, prepend=0.0) - skin.mean
    back = (np.eye(n) - np.eye(n, k=-1)) @ np.linalg.inv(normal.angles)  # (T, n, n), absolute to joint angles
    _, turn = joint_positions(state)
    pull = np.swapaxes(np.conj(swings(problem, state)) * (weights * turn[:, segment - 1])[..., None], 1, 2)
    gain = np.stack([back @ pull.real, back @ -pull.imag], axis=3)  # (T, n, K, 2)
    shape = _shapes(relative, skin.spread, segment)
    moved = skin.moved * np.sqrt(skin.size)[:, None, None, None]
    common = np.concatenate([moved.reshape(-1, moved.shape[-1]).T, skin.noise], axis=1)  # (P, 4 K + P)
    errors = -(back @ normal.cross) @ common
    slides = gain[:, :, :, None, :] * (shape * np.sqrt(skin.size)[:, None])[:, None, :, :, None]
    errors[..., : 4 * len(segment)] += slides.reshape(count, n, -1)
    return errors, np.einsum("tnkd,k->tn", gain**2, skin.rest)


def _variance(skin: _Skin, frames: IntArray, mean: FloatArray, step: float) -> FloatArray:
    """(T, n, 4) summed squares of the series and of their derivatives."""
    errors, unshaped = _series(skin, frames)
    part, parts = errors - mean, []
    for _ in range(4):
        parts.append(np.sum(part**2, axis=2))
        part = np.gradient(part, step, axis=0) if len(part) > 1 else np.zeros_like(part)
    parts[0] = parts[0] + unshaped
    return np.stack(parts, axis=2)


def _chunks(count: int) -> Iterator[tuple[slice, slice]]:
    """Stretches of postures with their neighbours, and which of each stretch are its own."""
    for start in range(0, count, _CHUNK):
        first = max(start - _OVERLAP, 0)
        stop = min(start + _CHUNK, count)
        yield slice(first, min(stop + _OVERLAP, count)), slice(start - first, stop - first)
