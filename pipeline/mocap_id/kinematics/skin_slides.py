"""Skin that slips over the bone, a chain fitted to markers on it, and what both do to the angles in every posture.

The model is that of :mod:`mocap_id.kinematics.centre_covariance`: every marker slides within its segment, either way,
in proportion to the angle of the joint below and to that of the joint above. A slide e turns the segments by

    da = A^-1 (S^H W e - C dc),

A and C being the angles' blocks of the normal equations, S what the markers do as the segments turn, and dc what the
slide did to the centres and coordinates of the joint fit. What of a residual lasts without following the joints
(wander, curvature) counts beside it, and so does what camera noise did to the joint fit. No size is set by hand.
"""

from __future__ import annotations

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

FRAMES = 400
"""Of the joint fit that is re-traced."""
EXACT = 1e-4
"""m; markers with smaller residuals weigh alike, as in the joint fit."""
_SHAPES = 2  # a slide follows the joint below or the joint above
_MODES = 2 * _SHAPES  # slides of one marker, of one standard deviation each


@dataclass(frozen=True)
class SkinModel:
    """A chain, the slides of its markers, and the joint fit's answer to each of them.

    Parameters
    ----------
    centres, local : (n,) and (K,) complex arrays
        The fitted chain, m.
    segment : (K,) int array
        Of each marker, 1 … n.
    weight : (K,) array
        Of each marker's coordinates in the angles of a frame: as often as it is seen.
    size, rest : (K,) arrays
        Variances of what lasts of a marker's residual, and of its part that does not follow the joints, m² a
        coordinate.
    mean, spread : (n,) and (K,) arrays
        Of the joint angles that the slides follow, rad.
    moved : (K, 2, 2, P) array
        By how much the fit's common unknowns move for a marker's slide of one metre along each shape, in x and y of
        its segment; P = 2 (n + K): centres first.
    noise : (P, P) array
        Square root of the common unknowns' covariance from other causes, m.
    """

    centres: ComplexArray
    local: ComplexArray
    segment: IntArray
    weight: FloatArray
    size: FloatArray
    rest: FloatArray
    mean: FloatArray
    spread: FloatArray
    moved: FloatArray
    noise: FloatArray

    @property
    def common(self) -> FloatArray:
        """(P, 4 K + P) changes of the common unknowns with every mode, one standard deviation each, m."""
        moved = self.moved * np.sqrt(self.size)[:, None, None, None]
        return np.concatenate([moved.reshape(-1, moved.shape[-1]).T, self.noise], axis=1)

    def errors(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors of the joint angles in some postures.

        Parameters
        ----------
        angles : (T, n) array
            Joint angles, rad.

        Returns
        -------
        errors : (T, n, 4 K + P) array
            That follow the posture: of every mode, one standard deviation each, rad. Modes are independent.
        unshaped : (T, n) array
            Variance of those that do not, rad².
        """
        segment, n = self.segment, len(self.centres)
        state = State(self.centres, self.local, np.cumsum(angles, axis=1))
        weights = np.broadcast_to(self.weight, (len(angles), len(segment)))
        pinned = np.zeros(len(segment), dtype=np.bool_)
        problem = Problem(np.zeros(weights.shape, dtype=np.complex128), weights, segment, pinned, n)
        normal = normal_equations(problem, state)
        back = (np.eye(n) - np.eye(n, k=-1)) @ np.linalg.inv(normal.angles)  # (T, n, n), absolute to joint angles
        _, turn = joint_positions(state)
        pull = np.swapaxes(np.conj(swings(problem, state)) * (weights * turn[:, segment - 1])[..., None], 1, 2)
        gain = np.stack([back @ pull.real, back @ -pull.imag], axis=3)  # (T, n, K, 2)
        shape = shapes_of(angles - self.mean, self.spread, segment)
        errors = -(back @ normal.cross) @ self.common
        slides = gain[:, :, :, None, :] * (shape * np.sqrt(self.size)[:, None])[:, None, :, :, None]
        errors[..., : _MODES * len(segment)] += slides.reshape(len(angles), n, -1)
        return errors, np.einsum("tnkd,k->tn", gain**2, self.rest)

    def frames_turned(self) -> tuple[FloatArray, FloatArray]:
        """What every mode does to the chain as it is written down, +y of a segment towards its next joint.

        Returns
        -------
        centres : (n, 2, 4 K + P) array
            Changes of the joint centres, m.
        angles : (n, 4 K + P) array
            Constant changes of the joint angles, rad, as frames turn with the joints, or the markers' middle in the
            last segment.
        """
        n = len(self.centres)
        moved = self.common.reshape(n + len(self.segment), 2, -1)
        centres = moved[:n].copy()
        last = self.segment == n
        across = np.concatenate([centres[1:, 0], moved[n:][last, 0].mean(axis=0, keepdims=True)])
        arm = np.append(np.abs(self.centres[1:]), np.abs(self.local[last].mean()))
        turned = -across / arm[:, None]
        centres[1:, 0] = 0.0
        return centres, np.diff(turned, axis=0, prepend=0.0)


def skin_model(
    points: ComplexArray, segment: IntArray, state: State, observed: IntArray, camera_sd: float
) -> SkinModel:
    """Sizes of the slides from what lasts of the residuals, and the joint fit's answer to each of them.

    Parameters
    ----------
    points : (F, K) complex array
        Markers in the plane, m; NaN where unseen or left out.
    segment : (K,) int array
        Of each, 1 … n.
    state : State
        Centres, coordinates, and absolute angles of all frames, finite.
    observed : (T,) int array
        Frames whose markers determine every angle.
    camera_sd : float
        Camera noise of a coordinate, m.
    """
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    mean = relative.mean(axis=0)
    relative -= mean
    spread = spread_of(relative)[segment - 1]
    size, rest, square, often = _sizes(points, segment, state, relative, spread)
    used = frames_along_motion(points, FRAMES, observed)
    seen, weight = np.isfinite(points[used]), 1.0 / np.maximum(square, EXACT**2)
    pinned = np.zeros(len(segment), dtype=np.bool_)
    fitted = Problem(
        np.where(seen, points[used], 0), seen * (weight / weight.mean()), segment, pinned, len(state.centres)
    )
    traced = replace(state, angles=state.angles[used])
    reduced = reduce(fitted, traced)
    moved = responses(fitted, traced, reduced, shapes_of(relative[used], spread, segment), reduced.inverse)
    values, vectors = np.linalg.eigh(reduced.inverse)
    noise = vectors * (camera_sd * np.sqrt(np.maximum(values, 0)))
    return SkinModel(state.centres, state.local, segment, often, size, rest, mean, spread, moved, noise)


def skin_without_fit(state: State, segment: IntArray, residual: FloatArray, centre_covariance: FloatArray) -> SkinModel:
    """The same where it is not known how the joints were fitted, or what of a residual lasts.

    All of a residual counts as skin, and the centres are off by their covariance, whatever the skin.

    Parameters
    ----------
    state : State
        Centres, coordinates, and absolute angles, finite.
    segment : (K,) int array
        1 … n.
    residual : (K,) array
        rms distance of each marker from its place, m.
    centre_covariance : (n, 2, 2) array
        m².
    """
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    mean = relative.mean(axis=0)
    spread = spread_of(relative - mean)[segment - 1]
    joints, markers = len(state.centres), len(segment)
    noise = np.zeros((2 * (joints + markers), 2 * (joints + markers)))
    for joint, own in enumerate(centre_covariance):
        values, vectors = np.linalg.eigh(own)
        rows = slice(2 * joint, 2 * joint + 2)
        noise[rows, rows] = vectors * np.sqrt(np.maximum(values, 0.0))
    moved = np.zeros((markers, _SHAPES, 2, len(noise)))
    size, none = residual**2 / 2, np.zeros(markers)
    return SkinModel(state.centres, state.local, segment, np.ones(markers), size, none, mean, spread, moved, noise)


def spread_of(relative: FloatArray) -> FloatArray:
    """(n,) root mean square of a segment's shapes, 1 where nothing moves; from angles (F, n) off their mean."""
    square = np.zeros((relative.shape[1] + 1, len(relative)))
    square[:-1] = relative.T**2
    spread = np.sqrt(np.mean(square[:-1] + square[1:], axis=1))
    return np.where(spread > 0, spread, 1)


def shapes_of(relative: FloatArray, spread: FloatArray, segment: IntArray) -> FloatArray:
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
        found[:, k] = _own_sizes(off, shapes_of(relative, spread[k : k + 1], segment[k : k + 1])[:, 0])
    size, rest, square, often = found
    square = shared_variance(square, often, segment, state.local)  # as the joint fit weighs
    for k in range(1, len(state.centres) + 1):
        members = segment == k
        weights = often[members] / np.maximum(square[members], EXACT**2)
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
