"""Joint centres, marker coordinates and angles of the whole chain at once (3.13-3.16).

In the plane, with complex numbers, a marker q on segment k stands at

    z = c_1 + e^{i a_1} c_2 + … + e^{i a_{k-1}} c_k + e^{i a_k} q,

a_j being segment j's angle from the plane's x and c_j the centre of joint j in the frame of segment j-1. The centres
and coordinates are common to all frames, the angles belong to one frame each: the normal equations are bordered
block-diagonal, and the angles are eliminated frame by frame (variable projection, by the Schur complement) before each
Gauss-Newton step. A frame's own turn is a gauge freedom: steps are the shortest ones, and :func:`fix_gauge` settles it
afterwards (this is what lambda_phi of 3.16 is for).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.kinematics.joint import arc, fit_joint
from mocap_id.kinematics.rigid import Body, fit_body, still_body

_ITERATIONS = 60
_CONVERGED = 1e-7  # relative fall of the cost
_HUBER = 3.0  # scales beyond which a residual is a burst
_BLOCKS = 20  # stretches of time taken as independent for the covariance


@dataclass(frozen=True)
class ChainFit:
    """The chain as recovered from the markers; segment frames as METHOD says only after :func:`fix_gauge`.

    Parameters
    ----------
    centres : (n,) complex array
        Joint j's centre in the frame of segment j-1, m.
    local : (M,) complex array
        Marker coordinates in their segment's frame, m; base markers in the plane frame.
    segment : (M,) int array
        Segment of each marker, 0 = base.
    angles : (F, n) array
        Absolute segment angles in the frames used, rad; NaN where a frame was not used.
    covariance : (n, 2, 2) array
        Of each centre, m^2: sandwich over stretches of time, so that residuals may be correlated within them.
    length_sd : (n - 1,) array
        Standard deviations of the lengths of segments 1 … n-1, m.
    residual : (M,) array
        rms residual of each marker, m.
    arcs : (n,) array
        Relative angle each joint travelled, 2.5 to 97.5 % quantile, rad.
    iterations : int
        Gauss-Newton steps taken.
    """

    centres: ComplexArray
    local: ComplexArray
    segment: IntArray
    angles: FloatArray
    covariance: FloatArray
    length_sd: FloatArray
    residual: FloatArray
    arcs: FloatArray
    iterations: int = 0

    @property
    def lengths(self) -> FloatArray:
        """(n - 1,) distances between the joints of segments 1 … n-1, m."""
        return np.asarray(np.abs(self.centres[1:]))


@dataclass(frozen=True)
class _Problem:
    """Trajectories of the moving markers and their layout; weights are per residual."""

    points: ComplexArray  # (T, K), zero where unseen
    weights: FloatArray  # (T, K), zero where unseen
    segment: IntArray  # (K,)
    joints: int

    @property
    def unknowns(self) -> int:
        return 2 * (self.joints + len(self.segment))


@dataclass(frozen=True)
class _State:
    centres: ComplexArray  # (n,)
    local: ComplexArray  # (K,)
    angles: FloatArray  # (T, n)


def fit_chain(points: ComplexArray, segment: IntArray) -> ChainFit:
    """Fit the serial chain to the markers of its segments.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    segment : (M,) int array
        Segment of each marker, 0 = base, 1 … n from base to tip; every segment has at least two markers.

    Raises
    ------
    NumericalError
        Too few frames hold every segment, or the iteration does not settle.
    """
    moving = np.flatnonzero(segment > 0)
    joints = int(segment.max())
    start = _start(points, segment, joints)
    used = np.flatnonzero(np.isfinite(start.angles).all(axis=1))
    if len(used) < 10 * joints:
        raise NumericalError(
            f"only {len(used)} of {len(points)} frames show at least two markers of each of {joints} moving segments"
        )
    seen = np.isfinite(points[np.ix_(used, moving)])
    problem = _Problem(
        np.where(seen, points[np.ix_(used, moving)], 0), seen.astype(np.float64), segment[moving], joints
    )
    state, problem, iterations = _solve(problem, replace(start, local=start.local[moving], angles=start.angles[used]))
    return replace(_collect(points, segment, used, problem, state), iterations=iterations)


def fix_gauge(fit: ChainFit) -> ChainFit:
    """Turn every segment frame so that +Y points to the next joint, on the last segment to its markers' centroid."""
    joints = len(fit.centres)
    tip = fit.local[fit.segment == joints].mean()
    towards = np.append(fit.centres[1:], tip)
    turn = np.exp(1j * (np.pi / 2 - np.angle(towards)))
    centres = fit.centres.copy()
    centres[1:] *= turn[:-1]
    per_segment = np.concatenate([[1], turn])
    covariance = fit.covariance.copy()
    for joint in range(1, joints):
        rotation = _matrix(turn[joint - 1])
        covariance[joint] = rotation @ fit.covariance[joint] @ rotation.T
    return replace(
        fit,
        centres=centres,
        local=fit.local * per_segment[fit.segment],
        angles=_continuous(fit.angles - np.angle(turn)),
        covariance=covariance,
    )


def joint_angles(absolute: FloatArray) -> FloatArray:
    """(F, n) angles of each segment relative to its parent from the absolute ones, rad."""
    return np.diff(absolute, axis=1, prepend=0.0)


def _start(points: ComplexArray, segment: IntArray, joints: int) -> _State:
    """Rigid bodies, and the joint of every neighbouring pair: a start that needs no angle and no guess."""
    bodies: list[Body] = [still_body(points, np.flatnonzero(segment == 0))]
    bodies += [fit_body(points, np.flatnonzero(segment == k)) for k in range(1, joints + 1)]
    pairs = [fit_joint(parent, child) for parent, child in pairwise(bodies)]
    origins = [0j, *(pair.in_child for pair in pairs)]
    centres = np.array([pair.in_parent - origin for pair, origin in zip(pairs, origins, strict=False)])
    local = np.zeros(points.shape[1], dtype=np.complex128)
    for body, origin in zip(bodies, origins, strict=True):
        local[body.markers] = body.template - origin
    angles = np.stack([np.angle(body.rotation) for body in bodies[1:]], axis=1)
    return _State(centres, local, angles)


def _solve(problem: _Problem, state: _State) -> tuple[_State, _Problem, int]:
    """Reweighted Gauss-Newton: bursts beyond a few scales of their segment's residual lose their say."""
    cost = np.inf
    for iteration in range(1, _ITERATIONS + 1):
        problem = _reweighted(problem, state)
        step, _, _ = _step(problem, state)
        state = _moved(state, step)
        previous, cost = cost, _cost(problem, state)
        if abs(previous - cost) <= _CONVERGED * cost + 1e-18:
            return state, problem, iteration
    raise NumericalError(f"the joint fit has not settled after {_ITERATIONS} iterations; are the segments right?")


def _predicted(problem: _Problem, state: _State) -> ComplexArray:
    """(T, K) markers from the unknowns."""
    origin, turn = _origins(state)
    return np.asarray(origin[:, problem.segment - 1] + turn[:, problem.segment - 1] * state.local)


def _origins(state: _State) -> tuple[ComplexArray, ComplexArray]:
    """(T, n) joint positions and ``exp(i a)`` of the segments."""
    turn = np.exp(1j * state.angles)
    arms = np.empty(turn.shape, dtype=np.complex128)
    arms[:, 0] = state.centres[0]
    arms[:, 1:] = turn[:, :-1] * state.centres[1:]
    return np.cumsum(arms, axis=1), turn


def _cost(problem: _Problem, state: _State) -> float:
    off = problem.points - _predicted(problem, state)
    return float(np.sum(problem.weights * np.abs(off) ** 2))


def _reweighted(problem: _Problem, state: _State) -> _Problem:
    """Huber weights on each segment's own scale."""
    seen = problem.weights > 0
    off = np.abs(problem.points - _predicted(problem, state))
    weights = seen.astype(np.float64)
    for k in range(1, problem.joints + 1):
        members = problem.segment == k
        scale = np.median(off[:, members][seen[:, members]]) / 1.1774  # Rayleigh: median of |off| is 1.1774 sigma
        limit = _HUBER * max(scale, 1e-9)
        weights[:, members] *= np.minimum(1, limit / np.maximum(off[:, members], limit))
    return replace(problem, weights=weights)


def _jacobians(problem: _Problem, state: _State) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the predicted coordinates.

    Returns
    -------
    common : (T, 2K, P) array
        By the centres and local coordinates, x and y interleaved, P = 2 (n + K).
    angles : (T, 2K, n) array
        By the absolute angles.
    """
    frames, markers = problem.points.shape
    joints = problem.joints
    _, turn = _origins(state)
    factor = np.zeros((frames, markers, joints + markers), dtype=np.complex128)
    swing = np.zeros((frames, markers, joints), dtype=np.complex128)
    for k in range(1, joints + 1):
        members = np.flatnonzero(problem.segment == k)
        factor[:, members, 0] = 1
        for j in range(1, k):
            factor[:, members, j] = turn[:, j - 1, None]
            swing[:, members, j - 1] = 1j * (turn[:, j - 1] * state.centres[j])[:, None]
        factor[:, members, joints + members] = turn[:, k - 1, None]
        swing[:, members, k - 1] = 1j * turn[:, k - 1, None] * state.local[members]
    common = np.empty((frames, markers, 2, joints + markers, 2))
    common[:, :, 0, :, 0] = common[:, :, 1, :, 1] = factor.real
    common[:, :, 1, :, 0] = factor.imag
    common[:, :, 0, :, 1] = -factor.imag
    angles = np.stack([swing.real, swing.imag], axis=2)
    return common.reshape(frames, 2 * markers, -1), angles.reshape(frames, 2 * markers, joints)


def _step(problem: _Problem, state: _State) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
    """One Gauss-Newton step with the angles eliminated.

    Returns
    -------
    step : ((P,), (T, n)) arrays
        Of the common unknowns and of the angles.
    hessian : (P, P) array
        Schur complement of the angles.
    scores : (T, P) array
        Every frame's reduced gradient.
    """
    common, swing = _jacobians(problem, state)
    root = np.repeat(np.sqrt(problem.weights), 2, axis=1)[..., None]  # (T, 2K, 1)
    off = problem.points - _predicted(problem, state)
    residual = np.stack([off.real, off.imag], axis=2).reshape(len(off), -1) * root[..., 0]
    common *= root
    swing *= root
    inner = np.swapaxes(swing, 1, 2) @ swing  # (T, n, n)
    cross = np.swapaxes(swing, 1, 2) @ common  # (T, n, P)
    pull = np.einsum("tkn,tk->tn", swing, residual)
    solved = np.linalg.solve(inner, np.concatenate([cross, pull[..., None]], axis=2))
    flat = common.reshape(-1, problem.unknowns)
    hessian = flat.T @ flat - np.einsum("tnp,tnq->pq", cross, solved[..., :-1], optimize=True)
    scores = np.einsum("tkp,tk->tp", common, residual) - np.einsum("tnp,tn->tp", cross, solved[..., -1])
    delta = _pseudo_inverse(hessian, problem.joints) @ scores.sum(axis=0)
    turns = solved[..., -1] - solved[..., :-1] @ delta
    return (delta, turns), hessian, scores


def _pseudo_inverse(hessian: FloatArray, joints: int) -> FloatArray:
    """Inverse off the gauge: every segment's own turn is a direction in which nothing changes."""
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
    kept = slice(joints, None)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _moved(state: _State, step: tuple[FloatArray, FloatArray]) -> _State:
    common, turns = step
    joints = len(state.centres)
    change = common[0::2] + 1j * common[1::2]
    return _State(state.centres + change[:joints], state.local + change[joints:], state.angles + turns)


def _collect(points: ComplexArray, segment: IntArray, used: IntArray, problem: _Problem, state: _State) -> ChainFit:
    """Residuals, arcs and covariance of the solution."""
    moving, still = np.flatnonzero(segment > 0), np.flatnonzero(segment == 0)
    base = still_body(points, still)
    local = np.zeros(len(segment), dtype=np.complex128)
    local[still], local[moving] = base.template, state.local
    residual = np.zeros(len(segment))
    residual[still] = _rms(points[:, still] - base.template)
    seen = problem.weights > 0
    residual[moving] = _rms(np.where(seen, problem.points - _predicted(problem, state), np.nan))
    angles = np.full((len(points), problem.joints), np.nan)
    angles[used] = state.angles
    angles = _continuous(angles)
    full = _sandwich(problem, state)
    covariance = np.stack([full[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(problem.joints)])
    arcs = np.array([arc(np.exp(1j * relative)) for relative in joint_angles(angles[used]).T])
    return ChainFit(
        state.centres,
        local,
        segment,
        angles,
        covariance,
        _length_sd(state.centres, covariance),
        residual,
        arcs,
    )


def _sandwich(problem: _Problem, state: _State) -> FloatArray:
    """(P, P) covariance of the common unknowns: H^-1 (sum of outer products of the blocks' scores) H^-1."""
    _, hessian, scores = _step(problem, state)
    blocks: Sequence[FloatArray] = np.array_split(scores, min(_BLOCKS, len(scores)))
    sums = np.stack([block.sum(axis=0) for block in blocks])
    inverse = _pseudo_inverse(hessian, problem.joints)
    correction = len(sums) / max(len(sums) - 1, 1)
    return np.asarray(correction * inverse @ (sums.T @ sums) @ inverse)


def _length_sd(centres: ComplexArray, covariance: FloatArray) -> FloatArray:
    """(n - 1,) standard deviation of |c_j| for joints 2 … n."""
    along = np.stack([centres.real, centres.imag], axis=1)[1:] / np.abs(centres[1:])[:, None]
    return np.asarray(np.sqrt(np.einsum("ji,jik,jk->j", along, covariance[1:], along)))


def _continuous(angles: FloatArray) -> FloatArray:
    """Angles (F, n) without jumps over the frames that are known, starting in (-pi, pi]."""
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    out[known] = np.unwrap(angles[known], axis=0)
    return np.asarray(out - 2 * np.pi * np.round(out[known][0] / (2 * np.pi)))


def _rms(off: ComplexArray) -> FloatArray:
    """(K,) rms modulus of the columns, NaN left out."""
    return np.asarray(np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0)))


def _matrix(turn: complex) -> FloatArray:
    """(2, 2) rotation matrix of a unit complex number."""
    return np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
