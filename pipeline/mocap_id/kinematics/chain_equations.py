"""A chain's markers from its unknowns, and their weighted normal equations (3.13-3.16).

In the plane, with complex numbers, a marker q on segment k stands at

    z = c_1 + e^{i a_1} c_2 + … + e^{i a_{k-1}} c_k + e^{i a_k} q,

a_j being segment j's angle from the plane's x and c_j the centre of joint j in the frame of segment j-1. The centres
and coordinates are common to all frames, the angles belong to one frame each: the normal equations are bordered
block-diagonal, and the angles are eliminated frame by frame (variable projection, by the Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class Problem:
    """Trajectories of the moving markers and their layout.

    Parameters
    ----------
    points : (T, K) complex array
        m; zero where unseen.
    weights : (T, K) array
        Of every residual; zero where unseen.
    segment : (K,) int array
        1 … n.
    pinned : (K,) bool array
        Markers that stand for their segment's own joint: their coordinates are zero and no unknowns (3.15).
    joints : int
    """

    points: ComplexArray
    weights: FloatArray
    segment: IntArray
    pinned: BoolArray
    joints: int

    @property
    def unknowns(self) -> int:
        """Real numbers common to all frames, those of pinned markers counted in."""
        return 2 * (self.joints + len(self.segment))

    @property
    def free(self) -> IntArray:
        """Indices of those that are unknown indeed."""
        return np.flatnonzero(np.repeat(np.append(np.zeros(self.joints, dtype=np.bool_), self.pinned), 2) == 0)


@dataclass(frozen=True)
class State:
    """Values of the unknowns: centres and coordinates in m, absolute angles in rad."""

    centres: ComplexArray  # (n,)
    local: ComplexArray  # (K,)
    angles: FloatArray  # (T, n)


def predicted(problem: Problem, state: State) -> ComplexArray:
    """(T, K) markers from the unknowns."""
    origin, turn = joint_positions(state)
    return np.asarray(origin[:, problem.segment - 1] + turn[:, problem.segment - 1] * state.local)


def joint_positions(state: State) -> tuple[ComplexArray, ComplexArray]:
    """(T, n) joint positions and ``exp(i a)`` of the segments."""
    turn = np.exp(1j * state.angles)
    arms = np.empty(turn.shape, dtype=np.complex128)
    arms[:, 0] = state.centres[0]
    arms[:, 1:] = turn[:, :-1] * state.centres[1:]
    return np.cumsum(arms, axis=1), turn


@dataclass(frozen=True)
class Normal:
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


def normal_equations(problem: Problem, state: State) -> Normal:
    """Assemble without a dense Jacobian: a marker touches its own coordinates and the joints below it, no more."""
    joints, markers = problem.joints, len(problem.segment)
    _, turn = joint_positions(state)
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)  # (T, n): d z / d c_j
    below = np.arange(joints) < problem.segment[:, None]  # (K, n): joint j carries the marker
    own = turn[:, problem.segment - 1]  # (T, K): d z / d q
    swing = 1j * np.where(below, (turn * np.append(state.centres[1:], 0))[:, None, :], 0)  # (T, K, n): d z / d a_j
    swing[:, np.arange(markers), problem.segment - 1] = 1j * own * state.local
    off = problem.points - predicted(problem, state)
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
    return Normal(
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


@dataclass(frozen=True)
class Reduced:
    """The normal equations with the angles eliminated.

    Parameters
    ----------
    normal : Normal
    inverse : (P, P) array
        Of the Schur complement of the angles, off the gauge and zero where a coordinate is pinned.
    scores : (T, P) array
        Every frame's reduced gradient.
    solved : (T, n, P + 1) array
        The angles' blocks solved for the cross terms and for their own right-hand side.
    """

    normal: Normal
    inverse: FloatArray
    scores: FloatArray
    solved: FloatArray

    def step(self) -> tuple[FloatArray, FloatArray]:
        """Gauss-Newton step (P,) of the common unknowns and (T, n) of the angles, the shortest one."""
        delta = self.inverse @ self.scores.sum(axis=0)
        return delta, self.solved[..., -1] - self.solved[..., :-1] @ delta


def reduce(problem: Problem, state: State) -> Reduced:
    """Eliminate the angles, frame by frame."""
    normal = normal_equations(problem, state)
    solved = np.linalg.solve(normal.angles, np.concatenate([normal.cross, normal.turn[..., None]], axis=2))
    flat = normal.cross.reshape(-1, problem.unknowns)
    hessian = normal.common - flat.T @ solved[..., :-1].reshape(flat.shape)
    scores = normal.pull - np.einsum("tnp,tn->tp", normal.cross, solved[..., -1])
    return Reduced(normal, _pseudo_inverse(hessian, problem), scores, solved)


def _pseudo_inverse(hessian: FloatArray, problem: Problem) -> FloatArray:
    """Inverse off the gauge: every segment's own turn is a direction in which nothing changes."""
    free = np.ix_(problem.free, problem.free)
    values, vectors = np.linalg.eigh((hessian[free] + hessian[free].T) / 2)
    kept = slice(problem.joints, None)
    inverse = np.zeros_like(hessian)
    inverse[free] = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return inverse


def moved(state: State, step: tuple[FloatArray, FloatArray]) -> State:
    """The state after a step."""
    common, turns = step
    joints = len(state.centres)
    change = common[0::2] + 1j * common[1::2]
    return State(state.centres + change[:joints], state.local + change[joints:], state.angles + turns)


def left_by_pose(weights: FloatArray, local: ComplexArray) -> FloatArray:
    """(K,) share of each coordinate's variance that a segment's own pose (two shifts and a turn) leaves in its markers.

    One less the leverage; not below a fifth: a marker that the pose follows further says little of its own error.

    Parameters
    ----------
    weights : (K,) array
        Of the segment's markers.
    local : (K,) complex array
        Their coordinates, m.
    """
    share = weights / weights.sum()
    arm = share * np.abs(local - np.sum(share * local)) ** 2
    leverage = share + arm / (2 * max(float(arm.sum()), 1e-12))
    return np.asarray(np.maximum(1 - leverage, 0.2))


def shared_variance(square: FloatArray, weights: FloatArray, segment: IntArray, local: ComplexArray) -> FloatArray:
    """(K,) variance by whose inverse each marker weighs: a third its own, the rest its segment's mean.

    A marker's own residual alone would in the end pull the segment onto its two best markers.

    Parameters
    ----------
    square : (K,) array
        Mean squared residual, m^2; what the pose took out of it is put back.
    weights : (K,) array
        That it was fitted with.
    segment : (K,) int array
    local : (K,) complex array
        Coordinates, m.
    """
    shared = np.empty_like(square)
    for k in np.unique(segment):
        members = segment == k
        own = square[members] / left_by_pose(weights[members], local[members])
        shared[members] = (own + 2 * own.mean()) / 3
    return shared
