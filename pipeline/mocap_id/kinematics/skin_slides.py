"""Model of skin that slides over the bone, and its effect on the fitted chain and on the joint angles.

A slide e of a marker rotates the segments by

    da = A^-1 (S^H W e - C dc),

where A and C are the blocks of the angles in the normal equations, S is the Jacobian of the markers with respect to the
segment angles, W are the weights, and dc is the change of the joint fit's centres and coordinates. The derivation is in
docs/concepts/sliding-skin.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, as_complex, as_xy
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.chain_fit import (
    ChainProblem,
    ChainState,
    angle_blocks,
    eliminate_angles,
    joint_positions,
    remaining_share,
    share_variance,
    slide_responses,
)

FRAMES = 400
"""Number of frames in which the response of the joint fit is computed."""
EXACT = 1e-4
"""Residual, m, below which markers have equal weights, as in the joint fit."""
_RIDGE = 1e-9  # ridge of the regression, for joints that do not move
_SHAPES = 2  # one for the joint below, one for the joint above
_MODES = 2 * _SHAPES  # slides of one marker: two shapes in two directions
_MEAN_OF = 400  # number of postures in the mean error
_RATE = 30.0  # Hz; rate of the postures, enough for movements, which stay below 3 Hz
_CHUNK = 500  # postures at a time, to limit memory
_OVERLAP = 3  # postures shared by neighbouring chunks, for the derivatives


@dataclass(frozen=True)
class SkinModel:
    """Chain, slides of its markers, and response of the joint fit to each slide.

    P = 2 (n + K) is the number of common unknowns of the joint fit, centres first. A slide has two time courses
    (shapes), which are proportional to the angles of the joints below and above the marker's segment.
    """

    centres: ComplexArray  # (n,) joint centres of the fitted chain, m
    local: ComplexArray  # (K,) marker coordinates, m
    segment: IntArray  # (K,) segment of each marker, 1 … n
    weight: FloatArray  # (K,) weight of each marker in the fit of the angles: fraction of frames in which it is visible
    size: FloatArray  # (K,) variance of the persistent part of a marker's residual, m² per coordinate
    rest: FloatArray  # (K,) variance of the part of this residual that does not follow the joints, m² per coordinate
    mean: FloatArray  # (n,) mean joint angles, rad
    spread: FloatArray  # (K,) scale of the joint angles that the slides follow, rad
    moved: FloatArray  # (K, 2, 2, P) change of the common unknowns per slide (m) of each shape, in x and y
    noise: FloatArray  # (P, P) square root of the common unknowns' covariance from other causes, m

    @property
    def common(self) -> FloatArray:
        """Changes (P, 4 K + P), m, of the common unknowns by one standard deviation of each mode of error."""
        moved = self.moved * np.sqrt(self.size)[:, None, None, None]
        return np.concatenate([moved.reshape(-1, moved.shape[-1]).T, self.noise], axis=1)

    def errors(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of the joint angles in postures (T, n), rad, and the effect of marker offsets.

        The errors (T, n, 4 K + P), rad, depend on the posture; they are for one standard deviation of each independent
        mode. The effect (T, n, K, 2), rad/m, is for offsets in x and y of the marker's segment.
        """
        segment, n = self.segment, len(self.centres)
        state = ChainState(self.centres, self.local, np.cumsum(angles, axis=1))
        weights = np.broadcast_to(self.weight, (len(angles), len(segment)))
        cross, normal, _ = angle_blocks(ChainProblem.without_points(weights, segment, n), state)
        turns = (np.eye(n) - np.eye(n, k=-1)) @ np.linalg.inv(normal) @ cross  # (T, n, P); absolute to joint angles
        gain = turns[..., 2 * n :].reshape(len(angles), n, len(segment), 2)
        shape = scale_angles(angles - self.mean, self.spread, segment)
        errors = turns @ -self.common
        slides = gain[:, :, :, None, :] * (shape * np.sqrt(self.size)[:, None])[:, None, :, :, None]
        errors[..., : _MODES * len(segment)] += slides.reshape(len(angles), n, -1)
        return errors, gain

    def stored_chain_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return the effect of every mode on centres (n, 2, 4 K + P), m, and joint angles (n, 4 K + P), rad.

        In the stored chain, +y of a segment points to its next joint (last segment: to the markers' centroid).
        Displaced joints therefore rotate the segment frames, which changes the joint angles by constants.
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


def fit_skin(
    points: ComplexArray, segment: IntArray, state: ChainState, observed: IntArray, camera_sd: float
) -> SkinModel:
    """Estimate the variances of the slides from the residuals, and the response of the joint fit to each slide.

    The markers ``points`` (F, K) are in the plane, m, NaN where missing or left out; their segments are 1 … n.
    ``state`` has finite angles in all frames. ``observed`` (T,) are frames whose markers determine every angle.
    ``camera_sd`` is the standard deviation of the camera noise of a coordinate, m.
    """
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    mean = relative.mean(axis=0)
    relative -= mean
    spread = slide_scales(relative)[segment - 1]
    # Only the part of a residual that persists to the next frame is a slide; the rest is camera noise. Markers are
    # regressed on their shapes one by one, to limit memory.
    origin, turn = joint_positions(state)
    size, rest, square, often = np.empty((4, len(segment)))
    for k, joint in enumerate(segment - 1):
        off = (points[:, k] - (origin[:, joint] + turn[:, joint] * state.local[k])) * np.conj(turn[:, joint])
        seen = np.isfinite(off)
        off = np.where(seen, off, 0)
        shape = scale_angles(relative, spread[k : k + 1], segment[k : k + 1])[:, 0]
        basis = np.column_stack([seen, shape * seen[:, None]])
        normal = basis.T @ basis + _RIDGE * len(basis) * np.eye(basis.shape[1])
        left = off - as_complex(basis @ np.linalg.solve(normal, basis.T @ as_xy(off)))
        size[k], rest[k] = _lag_one_variance(off, seen), _lag_one_variance(left, seen)
        square[k] = float(np.sum(np.abs(off) ** 2) / max(np.count_nonzero(seen), 1) / 2)
        often[k] = float(np.mean(seen))
    square = share_variance(square, often, segment, state.local)  # the weights of the joint fit
    for k in range(1, len(state.centres) + 1):
        members = segment == k
        weights = often[members] / np.maximum(square[members], EXACT**2)
        share = remaining_share(weights, state.local[members])
        size[members] /= share
        rest[members] /= share
    rest = np.minimum(rest, size)
    used = frames_along_motion(points, FRAMES, observed)
    seen, weight = np.isfinite(points[used]), 1.0 / np.maximum(square, EXACT**2)
    pinned = np.zeros(len(segment), dtype=np.bool_)
    fitted = ChainProblem(
        np.where(seen, points[used], 0), seen * (weight / weight.mean()), segment, pinned, len(state.centres)
    )
    traced = replace(state, angles=state.angles[used])
    moved, noise = fit_response(fitted, traced, scale_angles(relative[used], spread, segment), camera_sd)
    return SkinModel(state.centres, state.local, segment, often, size, rest, mean, spread, moved, noise)


def fit_response(
    problem: ChainProblem, state: ChainState, shape: FloatArray, camera_sd: float
) -> tuple[FloatArray, FloatArray]:
    """Return the changes (K, 2, 2, P) of the common unknowns per slide, and the root (P, P) of their noise covariance.

    ``shape`` (T, K, 2) are the time courses (shapes) of the slides; ``camera_sd`` is the standard deviation of the
    camera noise, m.
    """
    inverse, _, solved = eliminate_angles(problem, state)
    values, vectors = np.linalg.eigh(inverse)
    noise = vectors * (camera_sd * np.sqrt(np.maximum(values, 0)))
    return slide_responses(problem, state, solved, shape, inverse), noise


def skin_from_residuals(
    state: ChainState, segment: IntArray, residual: FloatArray, centre_covariance: FloatArray
) -> SkinModel:
    """Return a skin model in which residuals count as slides, and slides do not change the centres.

    The whole rms ``residual`` (K,), m, counts as a slide, persistent or not. The errors of the centres follow
    ``centre_covariance`` (n, 2, 2), m², independent of the skin. If the covariance is NaN (``estimator: circle``), the
    centres have no error.
    """
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    mean = relative.mean(axis=0)
    spread = slide_scales(relative - mean)[segment - 1]
    joints, markers = len(state.centres), len(segment)
    noise = np.zeros((2 * (joints + markers), 2 * (joints + markers)))
    for joint, own in enumerate(np.nan_to_num(centre_covariance)):
        values, vectors = np.linalg.eigh(own)
        rows = slice(2 * joint, 2 * joint + 2)
        noise[rows, rows] = vectors * np.sqrt(np.maximum(values, 0.0))
    moved = np.zeros((markers, _SHAPES, 2, len(noise)))
    size, none = residual**2 / 2, np.zeros(markers)
    return SkinModel(state.centres, state.local, segment, np.ones(markers), size, none, mean, spread, moved, noise)


def slide_scales(relative: FloatArray) -> FloatArray:
    """Return for each of n segments the scale, rad, of the angles of the joints at its two ends; 1 if neither moves.

    The scale is the root of the sum of both mean squares. ``relative`` (F, n) are joint angles without mean, rad.
    """
    square = np.zeros((relative.shape[1] + 1, len(relative)))
    square[:-1] = relative.T**2
    spread = np.sqrt(np.mean(square[:-1] + square[1:], axis=1))
    return np.where(spread > 0, spread, 1)


def scale_angles(relative: FloatArray, spread: FloatArray, segment: IntArray) -> FloatArray:
    """Return the centred angles (T, K, 2) of the joints below and above each marker, divided by ``spread`` (K,)."""
    beyond = np.concatenate([relative, np.zeros((len(relative), 1))], axis=1)
    return np.asarray(np.stack([beyond[:, segment - 1], beyond[:, segment]], axis=2) / spread[:, None])


def _lag_one_variance(off: ComplexArray, seen: BoolArray) -> float:
    """Return the lag-one covariance of a marker's offset (F,) per coordinate, at least 0, m^2."""
    pairs = max(int(np.count_nonzero(seen[1:] & seen[:-1])), 1)
    return max(float((np.conj(off[1:]) * off[:-1]).real.sum()) / pairs, 0.0) / 2


def angle_errors(skin: SkinModel, angles: FloatArray, rate: float) -> tuple[IntArray, FloatArray]:
    """Return the variances of persistent errors of joint angles and their derivatives.

    The joint angles (F, n) are in rad, finite; ``rate`` is in frames per second. The results are the frames (T,) of the
    variances, and the variances (T, n, 4) of angle (without its mean error), velocity, acceleration and jerk, in SI
    units.
    """
    step = max(1, round(rate / _RATE))
    frames = np.arange(0, len(angles), step)
    mean = skin.errors(angles[frames[:: max(1, len(frames) // _MEAN_OF)]])[0].mean(axis=0)
    variances = []
    for start in range(0, len(frames), _CHUNK):
        stop, before = min(start + _CHUNK, len(frames)), max(start - _OVERLAP, 0)
        errors, gain = skin.errors(angles[frames[before : min(stop + _OVERLAP, len(frames))]])
        part, parts = errors - mean, []
        for _ in range(4):  # the errors and their derivatives
            parts.append(np.sum(part**2, axis=2))
            part = np.gradient(part, step / rate, axis=0) if len(part) > 1 else np.zeros_like(part)
        # errors that do not follow the posture are added to the angle only
        parts[0] = parts[0] + np.einsum("tnkd,k->tn", gain**2, skin.rest)
        variances.append(np.stack(parts, axis=2)[start - before : stop - before])
    return frames, np.concatenate(variances)


def predict_skin(skin: SkinModel, angles: FloatArray, camera_sd: float, seen: int, frames: int = FRAMES) -> SkinModel:
    """Predict the skin model of another movement of the same body, to which the same chain would be fitted again.

    The slide of a marker per radian of its joints is a property of the marker. In larger arcs it slides farther, and in
    other postures the joint fit responds differently (docs/concepts/sliding-skin.md).

    ``skin`` is the model of the recorded movement, estimated from ``seen`` frames; the part of its variances that
    camera noise causes does not grow. ``angles`` (F, n) are the joint angles of the other movement, rad, finite; each
    posture counts as often as it occurs. ``camera_sd`` is the standard deviation of the camera noise of a coordinate,
    m. About ``frames`` postures are used.
    """
    mean = angles.mean(axis=0)
    relative = angles - mean
    spread = slide_scales(relative)[skin.segment - 1]
    chance = camera_sd**2 * np.sqrt(2.0 / np.maximum(seen * skin.weight, 1.0))  # two standard deviations without skin
    sliding = np.maximum(skin.size - skin.rest - chance, 0.0)
    size = skin.size + sliding * ((spread / skin.spread) ** 2 - 1.0)
    chosen = slice(None, None, max(1, len(angles) // frames))
    traced = ChainState(skin.centres, skin.local, np.cumsum(angles[chosen], axis=1))
    weight = 1.0 / np.maximum(camera_sd**2 + size, EXACT**2)
    weights = np.broadcast_to(skin.weight * weight / weight.mean(), (len(traced.angles), len(weight)))
    fitted = ChainProblem.without_points(weights, skin.segment, len(skin.centres))
    averaging = np.sqrt(len(weights) / FRAMES)  # camera noise averages over FRAMES frames in a fit
    shape = scale_angles(relative[chosen], spread, skin.segment)
    moved, noise = fit_response(fitted, traced, shape, camera_sd * averaging)
    return replace(skin, size=size, mean=mean, spread=spread, moved=moved, noise=noise)
