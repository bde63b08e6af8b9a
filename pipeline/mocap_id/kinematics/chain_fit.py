"""Equations of a planar chain, the fitted chain, the covariance of its centres, and its angles in a still pose.

A still pose of another recording may look in any direction; only the vertical is common to both recordings. The
sagittal plane of the pose is the one in which every cluster of markers has the same shape as in the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.geometry.planar import PlaneFrame, marker_positions, rotate
from mocap_id.kinematics.joint import arc


@dataclass(frozen=True)
class ChainProblem:
    """Trajectories of K moving markers in T frames, and their assignment to segments.

    A pinned marker is at the joint below its segment: its coordinates are zero and not unknown (3.15).
    """

    points: ComplexArray  # (T, K) positions, m; zero where missing
    weights: FloatArray  # (T, K) weight of every residual; zero where missing
    segment: IntArray  # (K,) segment of each marker, 1 … n
    pinned: BoolArray  # (K,) whether a marker is pinned
    joints: int  # number of joints n

    @classmethod
    def with_joint_markers(
        cls, points: ComplexArray, segment: IntArray, joint_tracks: Mapping[int, ComplexArray], joints: int
    ) -> ChainProblem:
        """Return a problem with weights of 1, from trajectories (T, K) and ``joint_tracks`` (T,) of joints 1 … n, m."""
        columns = np.concatenate([points, *(track[:, None] for track in joint_tracks.values())], axis=1)
        seen = np.isfinite(columns)
        return cls(
            np.where(seen, columns, 0),
            seen.astype(np.float64),
            np.concatenate([segment, np.array(list(joint_tracks), dtype=np.int64)]),
            np.arange(columns.shape[1]) >= len(segment),
            joints,
        )

    @classmethod
    def without_points(cls, weights: FloatArray, segment: IntArray, joints: int) -> ChainProblem:
        """Return a problem without measurements, with weights (T, K), to compute derivatives of a chain."""
        points, pinned = np.zeros(weights.shape, dtype=np.complex128), np.zeros(len(segment), dtype=np.bool_)
        return cls(points, weights, segment, pinned, joints)

    @property
    def free(self) -> IntArray:
        """Indices of the common unknowns without the coordinates of pinned markers."""
        return np.flatnonzero(np.repeat(np.append(np.zeros(self.joints, dtype=np.bool_), self.pinned), 2) == 0)

    def residuals(self, state: ChainState) -> ComplexArray:
        """Return measured minus predicted marker positions (T, K), m; meaningless where a marker is missing."""
        origin, turn = joint_positions(state)
        predicted = origin[:, self.segment - 1] + turn[:, self.segment - 1] * state.local
        return np.asarray(self.points - predicted)


@dataclass(frozen=True)
class ChainState:
    """Values of the unknowns of n joints, K markers and T frames."""

    centres: ComplexArray  # (n,) joint centres, m
    local: ComplexArray  # (K,) marker coordinates, m
    angles: FloatArray  # (T, n) absolute segment angles, rad

    def change(self, common: FloatArray, turns: FloatArray) -> ChainState:
        """Return the state after a change of the common unknowns (P,) and of the angles (T, n)."""
        joints, moved = len(self.centres), common[0::2] + 1j * common[1::2]
        return ChainState(self.centres + moved[:joints], self.local + moved[joints:], self.angles + turns)


def joint_positions(state: ChainState) -> tuple[ComplexArray, ComplexArray]:
    """Return the joint positions (T, n), m, and the rotations ``exp(i a)`` (T, n) of the segments."""
    turn = np.exp(1j * state.angles)
    arms = np.empty(turn.shape, dtype=np.complex128)
    arms[:, 0] = state.centres[0]
    arms[:, 1:] = turn[:, :-1] * state.centres[1:]
    return np.cumsum(arms, axis=1), turn


def angle_jacobian(problem: ChainProblem, state: ChainState) -> ComplexArray:
    """Return the derivatives (T, K, n) of the markers with respect to the absolute segment angles, m/rad."""
    turn = np.exp(1j * state.angles)
    below = np.arange(problem.joints) < problem.segment[:, None]
    swing = 1j * np.where(below, (turn * np.append(state.centres[1:], 0))[:, None, :], 0)
    swing[:, np.arange(len(below)), problem.segment - 1] = 1j * turn[:, problem.segment - 1] * state.local
    return np.asarray(swing)


def _levers(problem: ChainProblem, state: ChainState) -> tuple[ComplexArray, ComplexArray, BoolArray]:
    """Return the derivatives of the markers by the centres (T, n) and by their own coordinates (T, K).

    The third result is the centres (K, n) on which each marker depends.
    """
    turn = np.exp(1j * state.angles)
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)
    return lever, turn[:, problem.segment - 1], np.arange(problem.joints) < problem.segment[:, None]


def angle_blocks(problem: ChainProblem, state: ChainState) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Return the blocks of a frame's angles in the normal equations, for P = 2 (n + K) common unknowns.

    The results are the blocks (T, n, P) between angles and common unknowns, the blocks (T, n, n) of the angles, and the
    weighted conjugate derivatives (T, K, n) of the markers with respect to the angles.
    """
    lever, own, below = _levers(problem, state)
    swing = angle_jacobian(problem, state)
    pulled = np.asarray(np.conj(swing) * problem.weights[..., None], dtype=np.complex128)
    turned = np.swapaxes(pulled, 1, 2)
    cross = np.concatenate([turned @ below.astype(np.complex128) * lever[:, None, :], turned * own[:, None]], axis=2)
    interleaved = np.stack([cross.real, -cross.imag], axis=3).reshape(*cross.shape[:2], -1)
    return interleaved, (turned @ swing).real, pulled


def normal_equations(
    problem: ChainProblem, state: ChainState
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the weighted normal equations of all frames, bordered block-diagonal, for P = 2 (n + K) common unknowns.

    The results are the block of the common unknowns summed over frames (P, P), the two blocks of :func:`angle_blocks`,
    and the right-hand sides of the common unknowns (T, P) and of the angles (T, n). Real and imaginary parts of the
    common unknowns alternate. No dense Jacobian is built, because a marker depends on few unknowns.
    """
    lever, own, below = _levers(problem, state)
    cross, angles, pulled = angle_blocks(problem, state)
    joints, markers, weights = problem.joints, len(problem.segment), problem.weights
    off = problem.residuals(state)
    carried = weights @ (below[:, :, None] & below[:, None, :]).reshape(markers, -1).astype(np.float64)
    centres = np.einsum("ti,tj,tij->ij", np.conj(lever), lever, carried.reshape(-1, joints, joints))
    border = (np.conj(lever).T @ (weights * own)) * below.T
    hermitian = np.block([[centres, border], [np.conj(border).T, np.diag(weights.sum(axis=0))]])
    size = len(hermitian)
    common = np.empty((size, 2, size, 2))  # the real form of the Hermitian matrix
    common[:, 0, :, 0] = common[:, 1, :, 1] = hermitian.real
    common[:, 1, :, 0] = hermitian.imag
    common[:, 0, :, 1] = -hermitian.imag
    pull = np.concatenate([np.conj(lever) * ((weights * off) @ below), np.conj(own) * weights * off], axis=1)
    return (
        common.reshape(2 * size, 2 * size),
        cross,
        angles,
        np.stack([pull.real, pull.imag], axis=2).reshape(len(pull), -1),
        (off[:, None] @ pulled)[:, 0].real,
    )


def eliminate_angles(problem: ChainProblem, state: ChainState) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the normal equations of the common unknowns after elimination of the angles, frame by frame.

    The results are the pseudo-inverse (P, P) of the Schur complement, which is zero for pinned coordinates; the reduced
    gradient (T, P) of every frame; and the solutions (T, n, P + 1) of the angle blocks for cross terms and right-hand
    side. The pseudo-inverse ignores the orientations of the segment frames, which do not change marker positions.
    """
    common, cross, angles, pull, turn = normal_equations(problem, state)
    # with as many right-hand sides as unknowns, the product with the inverse is twice as fast as solving
    solved = np.linalg.inv(angles) @ np.concatenate([cross, turn[..., None]], axis=2)
    flat = cross.reshape(-1, cross.shape[2])
    hessian = common - flat.T @ solved[..., :-1].reshape(flat.shape)
    free = np.ix_(problem.free, problem.free)
    values, vectors = np.linalg.eigh((hessian[free] + hessian[free].T) / 2)
    kept = slice(problem.joints, None)
    inverse = np.zeros_like(hessian)
    inverse[free] = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return inverse, pull - np.einsum("tnp,tn->tp", cross, solved[..., -1]), solved


def gauss_newton_step(problem: ChainProblem, state: ChainState) -> tuple[FloatArray, FloatArray]:
    """Return the shortest Gauss-Newton step: (P,) of the common unknowns and (T, n) of the angles."""
    inverse, scores, solved = eliminate_angles(problem, state)
    delta = inverse @ scores.sum(axis=0)
    return delta, solved[..., -1] - solved[..., :-1] @ delta


def remaining_share(weights: FloatArray, local: ComplexArray) -> FloatArray:
    """Return the fraction (K,) of each coordinate's variance that remains after the segment's pose is fitted.

    The pose has two translations and a rotation, and the fraction is one minus the leverage. The fraction is limited to
    at least 0.2, because the residual of a marker with more leverage contains little information about its error.
    ``weights`` (K,) and coordinates ``local`` (K,), m, are those of the segment's markers.
    """
    share = weights / weights.sum()
    arm = share * np.abs(local - np.sum(share * local)) ** 2
    leverage = share + arm / (2 * max(float(arm.sum()), 1e-12))
    return np.asarray(np.maximum(1 - leverage, 0.2))


def share_variance(square: FloatArray, weights: FloatArray, segment: IntArray, local: ComplexArray) -> FloatArray:
    """Return the variance (K,) that weights each marker: one third its own, two thirds the mean of its segment.

    With its own residual alone, a segment would finally follow only its two best markers. The variance is the mean
    squared residual ``square``, m^2, in a fit with the given weights, divided by the fraction that remains after the
    pose is fitted.
    """
    shared = np.empty_like(square)
    for k in np.unique(segment):
        members = segment == k
        own = square[members] / remaining_share(weights[members], local[members])
        shared[members] = (own + 2 * own.mean()) / 3
    return shared


@dataclass(frozen=True)
class ChainFit:
    """Planar chain fitted to markers. Segment frames are final only after :func:`orient_frames`."""

    centres: ComplexArray  # (n,) centre of joint j in the frame of segment j-1, m
    local: ComplexArray  # (M,) marker coordinates in their segment's frame, m; base markers in the plane frame
    segment: IntArray  # (M,) segment of each marker, 0 = base
    angles: FloatArray  # (F, n) absolute segment angles, rad; NaN in frames that were not used
    covariance: FloatArray  # (n, 2, 2) covariance of each centre from camera noise and sliding skin, m^2
    length_sd: FloatArray  # (n - 1,) standard deviations of the lengths of segments 1 … n-1, m
    residual: FloatArray  # (M,) rms residual of each marker, m
    arcs: FloatArray  # (n,) 2.5 to 97.5 % range of each joint angle, rad
    iterations: int = 0  # number of Gauss-Newton steps

    @property
    def lengths(self) -> FloatArray:
        """Lengths (n - 1,) of segments 1 … n-1, m: the distances between neighbouring joints."""
        return np.asarray(np.abs(self.centres[1:]))


def orient_frames(fit: ChainFit) -> ChainFit:
    """Return the fit with segment frames rotated so that +Y points to the next joint.

    In the last segment, +Y points to the markers' centroid.
    """
    joints = len(fit.centres)
    tip = fit.local[fit.segment == joints].mean()
    towards = np.append(fit.centres[1:], tip)
    turn = np.exp(1j * (np.pi / 2 - np.angle(towards)))
    centres = fit.centres.copy()
    centres[1:] *= turn[:-1]
    per_segment = np.concatenate([[1], turn])
    covariance = fit.covariance.copy()
    for joint in range(1, joints):
        c, s = turn[joint - 1].real, turn[joint - 1].imag
        rotation = np.array([[c, -s], [s, c]])
        covariance[joint] = rotation @ fit.covariance[joint] @ rotation.T
    return replace(
        fit,
        centres=centres,
        local=fit.local * per_segment[fit.segment],
        angles=unwrap_angles(fit.angles - np.angle(turn)),
        covariance=covariance,
    )


def joint_angles(absolute: FloatArray) -> FloatArray:
    """Return the angles (F, n) of each segment relative to its parent, rad, from the absolute angles."""
    return np.diff(absolute, axis=1, prepend=0.0)


def joint_arcs(absolute: FloatArray) -> FloatArray:
    """Return the 2.5 to 97.5 % ranges (n,) of the joint angles, rad, from the absolute angles (F, n)."""
    return np.array([arc(np.exp(1j * relative)) for relative in joint_angles(absolute).T])


def length_sd(centres: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviations (n - 1,) of the distances between neighbouring joints, m."""
    along = np.stack([centres.real, centres.imag], axis=1)[1:] / np.abs(centres[1:])[:, None]
    return np.asarray(np.sqrt(np.einsum("ji,jik,jk->j", along, covariance[1:], along)))


def unwrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles (F, n), rad, without jumps of 2 pi between the frames that are not NaN, starting in [-pi, pi]."""
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    out[known] = np.unwrap(angles[known], axis=0)
    return np.asarray(out - 2 * np.pi * np.round(out[known][0] / (2 * np.pi)))


_BLOCKS = 20  # blocks of time assumed independent


def centre_covariance(problem: ChainProblem, state: ChainState) -> FloatArray:
    """Return the covariance (2 n, 2 n) of the centres, m^2, in the order x, y of each centre, at the solution."""
    inverse, scores, solved = eliminate_angles(problem, state)
    centres = inverse[:, : 2 * problem.joints]
    blocks = np.array_split(scores, min(_BLOCKS, len(scores)))
    sums = np.stack([block.sum(axis=0) for block in blocks]) @ centres
    noise = len(sums) / max(len(sums) - 1, 1) * sums.T @ sums
    sizes = np.sqrt(slide_variances(problem, state))
    moved = slide_responses(problem, state, solved, slide_shapes(problem, state), centres)
    flat = (moved * sizes[:, None, None, None]).reshape(-1, 2 * problem.joints)
    return np.asarray(noise + flat.T @ flat)


def slide_variances(problem: ChainProblem, state: ChainState) -> FloatArray:
    """Return the variance (K,) of each marker's slide in one coordinate, m^2.

    The variance is the lag-one covariance of the residuals, divided by the fraction that remains after the segment's
    pose is fitted.
    """
    seen = problem.weights > 0
    off = np.where(seen, problem.residuals(state), 0)
    lasting, chance = lag_one_covariance(off, seen)
    slide = np.zeros(len(lasting))
    for k in range(1, problem.joints + 1):
        members = (problem.segment == k) & ~problem.pinned
        left = remaining_share(problem.weights[:, members].mean(axis=0), state.local[members])
        slide[members] = np.maximum(lasting[members] - chance[members], 0) / 2 / left
    return slide


def lag_one_covariance(off: ComplexArray, seen: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the lag-one covariance (K,) of residuals (T, K), m^2, and twice its standard deviation for white noise.

    Residuals are 0 where a marker is not ``seen``.
    """
    pairs = np.maximum((seen[1:] & seen[:-1]).sum(axis=0), 1)
    lasting = (np.conj(off[1:]) * off[:-1]).real.sum(axis=0) / pairs
    return lasting, np.mean(np.abs(off) ** 2, axis=0) * np.sqrt(2 / pairs)


def slide_responses(
    problem: ChainProblem, state: ChainState, solved: FloatArray, shape: FloatArray, towards: FloatArray
) -> FloatArray:
    """Return the change (K, S, 2, p) of p common unknowns if each marker slides along x or y of its segment.

    ``shape`` (T, K, S) are S time courses of the slide of each marker, m. ``solved`` is that of
    :func:`eliminate_angles`, and ``towards`` (P, p) are the columns of its inverse for the requested unknowns.
    """
    joints = problem.joints
    lever, own, below = _levers(problem, state)
    slid = (problem.weights * own)[..., None] * shape
    centres = np.einsum("tj,tks->ksj", np.conj(lever), slid) * below[:, None, :]
    # real gradients (K, S, 2, 2 n) for slides along x and y, from the complex gradients for slides along x
    both = (centres.real, centres.imag), (-centres.imag, centres.real)
    gradients = [np.stack(each, axis=-1).reshape(*centres.shape[:-1], -1) for each in both]
    of_centre = np.stack(gradients, axis=-2) @ towards[: 2 * joints]
    itself = np.einsum("tk,tks->ks", problem.weights, shape)
    rows = towards[2 * joints :].reshape(-1, 2, towards.shape[1])  # (K, 2, p)
    of_itself = itself[:, :, None, None] * rows[:, None]
    pull = np.conj(angle_jacobian(problem, state))[:, :, None, :] * slid[..., None]  # (T, K, S, n)
    solved = solved[..., :-1]  # (T, n, P)
    turned = [np.tensordot(part, solved, axes=([0, 3], [0, 1])) for part in (pull.real, -pull.imag)]
    return np.asarray(of_centre + of_itself - np.stack(turned, axis=2) @ towards)


def slide_shapes(problem: ChainProblem, state: ChainState) -> FloatArray:
    """Return the angles (T, K, 2) of the joints below and above each marker, without mean, with a common rms of 1."""
    relative = np.diff(state.angles, axis=1, prepend=0.0, append=0.0)  # (T, n + 1)
    relative[:, -1] = 0
    relative = relative - relative.mean(axis=0)
    both = np.stack([relative[:, problem.segment - 1], relative[:, problem.segment]], axis=2)
    rms = np.sqrt(np.mean(np.sum(both**2, axis=2), axis=0))
    return np.asarray(both / np.where(rms > 0, rms, 1)[:, None])


_MARKER_SD = 0.005  # m; skin motion between the pose and the movement
_BASE_SD = np.radians(1.0)  # the feet are flat on the floor in both recordings
_STEPS = 72  # directions of the first search
_UNKNOWN = np.radians(20.0)  # standard deviation above which the markers do not determine an angle


def fit_static_pose(
    points: FloatArray, lateral: FloatArray, segment: IntArray, local: FloatArray, centres: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Fit a chain to the marker positions of a still pose.

    The results are the joint angles (n,) with the zero of the chain's frames, rad, NaN where not determined; their
    standard deviations (n,), rad; and the rms distance of the markers from the chain, m.

    ``points`` (M, 3) are the markers in the pose, in a lab with Z up, m. ``lateral`` (M,) are the mean out-of-plane
    coordinates of the same markers in the trial of the chain, m; they and ``local`` determine the direction of the
    plane. The other arguments are as for :func:`mocap_id.geometry.planar.marker_positions`.
    """
    count = len(centres)
    groups = [np.flatnonzero(segment == k) for k in range(count + 1)]
    own = local[:, 0] + 1j * local[:, 1]

    def turn(yaw: float) -> tuple[FloatArray, list[complex], float]:
        """Return the points in a plane, the rotation of each cluster (0 for one marker), and the squared misfit."""
        plane = PlaneFrame(yaw).to_plane(points)
        at, misfit, turned = plane[:, 0] + 1j * plane[:, 1], 0.0, []
        for group in groups:
            if not len(group):
                turned.append(0j)
                continue
            seen, shape, side = (each[group] - each[group].mean() for each in (at, own, plane[:, 2] - lateral))
            common = complex(np.vdot(shape, seen))
            misfit += float(np.sum(np.abs(seen) ** 2 + np.abs(shape) ** 2 + side**2)) - 2 * abs(common)
            turned.append(common)
        return plane, turned, misfit

    step = 2 * np.pi / _STEPS
    first = min((k * step for k in range(_STEPS)), key=lambda yaw: turn(yaw)[2])
    yaw = minimize_scalar(lambda yaw: turn(yaw)[2], bounds=(first - step, first + step), method="bounded").x
    plane, turned, _ = turn(float(yaw))
    angles = np.zeros(count + 1)
    for k in range(1, count + 1):  # a segment with one marker starts with the angle of the segment below
        angles[k] = np.angle(turned[k]) if abs(turned[k]) > 1e-9 else angles[k - 1]

    def residuals(state: FloatArray) -> FloatArray:
        placed = rotate(state[2], marker_positions(state[3:], centres, segment, local)) + state[:2]
        return np.append(((placed - plane[:, :2]) / _MARKER_SD).ravel(), state[2] / _BASE_SD)

    start = np.concatenate([[0.0, 0.0, 0.0], np.diff(angles)])
    start[:2] = (plane[:, :2] - marker_positions(start[3:], centres, segment, local)).mean(axis=0)
    fit = least_squares(residuals, start)
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    size = max(1.0, 2 * fit.cost / max(len(fit.fun) - len(start), 1))  # the misfit, if it is more than skin motion
    weak = np.diag(np.full(len(start), 1e-6))  # keeps the inverse finite; its sd of 1000 rad counts as unknown
    sd = np.sqrt(size * np.diag(np.linalg.inv(jacobian.T @ jacobian + weak)))[3:]
    theta = (fit.x[3:] + np.pi) % (2 * np.pi) - np.pi
    distance = np.linalg.norm(fit.fun[:-1].reshape(-1, 2), axis=1) * _MARKER_SD
    return np.where(sd < _UNKNOWN, theta, np.nan), sd, float(np.sqrt(np.mean(distance**2)))
