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
from mocap_id.errors import NumericalError, Refused
from mocap_id.kinematics.chain_fit import ChainFit, continuous, joint_angles, length_sd
from mocap_id.kinematics.joint import arc, fit_joint
from mocap_id.kinematics.rigid import Body, fit_body, still_body

_ITERATIONS = 60
_CONVERGED = 1e-7  # relative fall of the cost
_HUBER = 3.0  # scales beyond which a residual is a burst
_UNSEEN = 4.5  # slip along the angle over the slip that shows in the residuals
_FRAMES_A_JOINT = 10
_BLOCKS = 20  # stretches of time taken as independent for the covariance


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
    Refused
        ``too-few-frames`` show every segment.
    NumericalError
        The iteration does not settle.
    """
    moving = np.flatnonzero(segment > 0)
    joints = int(segment.max())
    start = _start(points, segment, joints)
    used = np.flatnonzero(np.isfinite(start.angles).all(axis=1))
    if len(used) < _FRAMES_A_JOINT * joints:
        raise Refused(
            "too-few-frames",
            f"{len(used)} of {len(points)} frames show at least two markers of each of {joints} moving segments; "
            f"{_FRAMES_A_JOINT * joints} are needed to place their joints. Use a longer `window:`, or fill the gaps.",
            float(len(used)),
            float(_FRAMES_A_JOINT * joints),
        )
    seen = np.isfinite(points[np.ix_(used, moving)])
    problem = _Problem(
        np.where(seen, points[np.ix_(used, moving)], 0), seen.astype(np.float64), segment[moving], joints
    )
    state, problem, iterations = _solve(problem, replace(start, local=start.local[moving], angles=start.angles[used]))
    return replace(_collect(points, segment, used, problem, state), iterations=iterations)


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


@dataclass(frozen=True)
class _Normal:
    """Weighted normal equations of all frames, bordered block-diagonal.

    Parameters
    ----------
    common : (P, P) array
        Between the common unknowns (real and imaginary parts interleaved, P = 2 (n + K)), summed over frames.
    cross : (T, n, P) array
        Between a frame's angles and the common unknowns.
    angles : (T, n, n) array
        Between a frame's angles.
    pull, turn : (T, P) and (T, n) arrays
        Right-hand sides.
    """

    common: FloatArray
    cross: FloatArray
    angles: FloatArray
    pull: FloatArray
    turn: FloatArray


def _normal_equations(problem: _Problem, state: _State) -> _Normal:
    """Assemble without a dense Jacobian: a marker touches its own coordinates and the joints below it, no more."""
    joints, markers = problem.joints, len(problem.segment)
    _, turn = _origins(state)
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)  # (T, n): d z / d c_j
    below = np.arange(joints) < problem.segment[:, None]  # (K, n): joint j carries the marker
    own = turn[:, problem.segment - 1]  # (T, K): d z / d q
    swing = 1j * np.where(below, (turn * np.append(state.centres[1:], 0))[:, None, :], 0)  # (T, K, n): d z / d a_j
    swing[:, np.arange(markers), problem.segment - 1] = 1j * own * state.local
    off = problem.points - _predicted(problem, state)
    weights = problem.weights
    pulled = np.conj(swing) * weights[..., None]  # (T, K, n)
    carried = weights @ (below[:, :, None] & below[:, None, :]).reshape(markers, -1).astype(np.float64)
    centres = np.einsum("ti,tj,tij->ij", np.conj(lever), lever, carried.reshape(-1, joints, joints))
    border = np.einsum("ti,tk,ki->ik", np.conj(lever), weights * own, below.astype(np.float64))
    hermitian = np.block([[centres, border], [np.conj(border).T, np.diag(weights.sum(axis=0))]])
    cross = np.concatenate(
        [np.einsum("tki,kj->tij", pulled, below) * lever[:, None, :], np.swapaxes(pulled * own[..., None], 1, 2)],
        axis=2,
    )
    pull = np.concatenate([np.conj(lever) * ((weights * off) @ below), np.conj(own) * weights * off], axis=1)
    return _Normal(
        _interleaved(hermitian),
        np.stack([cross.real, -cross.imag], axis=3).reshape(len(turn), joints, -1),
        (np.swapaxes(pulled, 1, 2) @ swing).real,
        np.stack([pull.real, pull.imag], axis=2).reshape(len(turn), -1),
        np.einsum("tkn,tk->tn", pulled, off).real,
    )


def _interleaved(hermitian: ComplexArray) -> FloatArray:
    """(2P, 2P) real form of a (P, P) Hermitian matrix, real and imaginary parts of the unknowns interleaved."""
    size = len(hermitian)
    real = np.empty((size, 2, size, 2))
    real[:, 0, :, 0] = real[:, 1, :, 1] = hermitian.real
    real[:, 1, :, 0] = hermitian.imag
    real[:, 0, :, 1] = -hermitian.imag
    return real.reshape(2 * size, 2 * size)


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
    normal = _normal_equations(problem, state)
    solved = np.linalg.solve(normal.angles, np.concatenate([normal.cross, normal.turn[..., None]], axis=2))
    flat = normal.cross.reshape(-1, problem.unknowns)
    hessian = normal.common - flat.T @ solved[..., :-1].reshape(flat.shape)
    scores = normal.pull - np.einsum("tnp,tn->tp", normal.cross, solved[..., -1])
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
    angles = continuous(angles)
    full = _sandwich(problem, state)
    covariance = np.stack([full[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(problem.joints)])
    arcs = np.array([arc(np.exp(1j * relative)) for relative in joint_angles(angles[used]).T])
    covariance = covariance + _slip(problem, state, arcs)[:, None, None] * np.eye(2)
    return ChainFit(
        state.centres,
        local,
        segment,
        angles,
        covariance,
        length_sd(state.centres, covariance),
        residual,
        arcs,
    )


def _slip(problem: _Problem, state: _State, arcs: FloatArray) -> FloatArray:
    """(n,) variance that skin slipping with the angle adds to each centre, m^2.

    Skin that moves by s over an arc shifts the centre by about s / arc, unseen. What is seen of it, the part of the
    residuals that lasts from one frame used to the next, stands for what is not; :data:`_UNSEEN` is how much larger
    that is, calibrated on simulated bodies. A centre is placed from the joint below it, so that one's share comes in.
    """
    seen = problem.weights > 0
    off = np.where(seen, problem.points - _predicted(problem, state), 0)
    pairs = np.maximum((seen[1:] & seen[:-1]).sum(axis=0), 1)
    lasting = (np.conj(off[1:]) * off[:-1]).real.sum(axis=0) / pairs
    chance = np.mean(np.abs(off) ** 2, axis=0) * np.sqrt(2 / pairs)  # two standard deviations, were it all noise
    slip = np.empty(problem.joints)
    for k in range(1, problem.joints + 1):
        members = problem.segment == k
        slip[k - 1] = max(np.mean(lasting[members] - chance[members]), 0) / 2 / members.sum()
    below = np.concatenate([[0.0], slip[:-1]])
    at_joint = (slip + below) / np.maximum(arcs, 1e-6) ** 2
    return np.asarray(_UNSEEN**2 * (at_joint + np.concatenate([[0.0], at_joint[:-1]])))


def _sandwich(problem: _Problem, state: _State) -> FloatArray:
    """(P, P) covariance of the common unknowns: H^-1 (sum of outer products of the blocks' scores) H^-1."""
    _, hessian, scores = _step(problem, state)
    blocks: Sequence[FloatArray] = np.array_split(scores, min(_BLOCKS, len(scores)))
    sums = np.stack([block.sum(axis=0) for block in blocks])
    inverse = _pseudo_inverse(hessian, problem.joints)
    correction = len(sums) / max(len(sums) - 1, 1)
    return np.asarray(correction * inverse @ (sums.T @ sums) @ inverse)


def _rms(off: ComplexArray) -> FloatArray:
    """(K,) rms modulus of the columns, NaN left out."""
    return np.asarray(np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0)))
