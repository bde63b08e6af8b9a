"""How far off the joint centres may be: camera noise, and skin that slips with the joints.

Residuals that last are not those of independent frames, so the frames' scores are summed over stretches of time before
they are squared (a sandwich). That cannot see skin which slides in step with a joint's angle: much of it looks like a
centre elsewhere and leaves hardly a trace. It is therefore carried through the fit as a model of its own: every marker
slides within its segment, in either direction, in proportion to the angle of the joint below and to that of the joint
above, by as much as its residuals last from one frame to the next, and each such slide moves the centres by what the
normal equations make of it.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics.chain_equations import Problem, Reduced, State, joint_positions, left_by_pose, predicted

_BLOCKS = 20  # stretches of time taken as independent


def centre_covariance(problem: Problem, state: State, reduced: Reduced) -> FloatArray:
    """(2 n, 2 n) covariance of the centres, m^2, x and y of each in turn.

    Parameters
    ----------
    problem, state, reduced
        At the solution.
    """
    return _scatter(problem, reduced) + _slip(problem, state, reduced)


def _scatter(problem: Problem, reduced: Reduced) -> FloatArray:
    """Inverse times the summed outer products of the blocks' scores times inverse."""
    blocks = np.array_split(reduced.scores, min(_BLOCKS, len(reduced.scores)))
    sums = np.stack([block.sum(axis=0) for block in blocks]) @ reduced.inverse[:, : 2 * problem.joints]
    return np.asarray(len(sums) / max(len(sums) - 1, 1) * sums.T @ sums)


def _slip(problem: Problem, state: State, reduced: Reduced) -> FloatArray:
    size = lasting_residuals(problem, state)  # (K,) m^2 a coordinate
    centres = reduced.inverse[:, : 2 * problem.joints]
    moved = responses(problem, state, reduced, shapes(problem, state), centres) * np.sqrt(size)[:, None, None, None]
    flat = moved.reshape(-1, 2 * problem.joints)
    return np.asarray(flat.T @ flat)


def lasting_residuals(problem: Problem, state: State) -> FloatArray:
    """(K,) variance of the skin's slide in one coordinate of each marker, m^2.

    What of the residuals is still there one frame later is no camera noise. The fit has taken three of a segment's
    2 M coordinates' worth out of it, from each marker by its leverage, which is put back.
    """
    seen = problem.weights > 0
    off = np.where(seen, problem.points - predicted(problem, state), 0)
    pairs = np.maximum((seen[1:] & seen[:-1]).sum(axis=0), 1)
    lasting = (np.conj(off[1:]) * off[:-1]).real.sum(axis=0) / pairs
    chance = np.mean(np.abs(off) ** 2, axis=0) * np.sqrt(2 / pairs)  # two standard deviations, were it all noise
    slide = np.zeros(len(lasting))
    for k in range(1, problem.joints + 1):
        members = (problem.segment == k) & ~problem.pinned
        left = left_by_pose(problem.weights[:, members].mean(axis=0), state.local[members])
        slide[members] = np.maximum(lasting[members] - chance[members], 0) / 2 / left
    return slide


def responses(problem: Problem, state: State, reduced: Reduced, shape: FloatArray, towards: FloatArray) -> FloatArray:
    """By how much the fit's common unknowns move for each marker's slide.

    Parameters
    ----------
    problem, state, reduced
        At the solution.
    shape : (T, K, S) array
        Course of each marker's slides, of either direction in its segment, m.
    towards : (P, p) array
        The columns of ``reduced.inverse`` that belong to the unknowns wanted.

    Returns
    -------
    (K, S, 2, p) array
        m, for every marker, shape, and direction x and y of the segment.
    """
    joints = problem.joints
    _, turn = joint_positions(state)
    own = turn[:, problem.segment - 1]  # (T, K)
    slid = (problem.weights * own)[..., None] * shape
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)
    below = np.arange(joints) < problem.segment[:, None]  # (K, n)
    centres = np.einsum("tj,tks->ksj", np.conj(lever), slid) * below[:, None, :]
    itself = np.einsum("tk,tks->ks", problem.weights, shape)
    of_centre = _real(centres) @ towards[: 2 * joints]
    rows = towards[2 * joints :].reshape(-1, 2, towards.shape[1])  # (K, 2, p)
    of_itself = itself[:, :, None, None] * rows[:, None]
    pull = np.conj(swings(problem, state))[:, :, None, :] * slid[..., None]  # (T, K, S, n)
    solved = reduced.solved[..., :-1]  # (T, n, P)
    turned = [np.tensordot(part, solved, axes=([0, 3], [0, 1])) for part in (pull.real, -pull.imag)]
    return np.asarray(of_centre + of_itself - np.stack(turned, axis=2) @ towards)


def swings(problem: Problem, state: State) -> ComplexArray:
    """(T, K, n) where each marker goes as each segment turns, m/rad."""
    _, turn = joint_positions(state)
    below = np.arange(problem.joints) < problem.segment[:, None]
    swing = 1j * np.where(below, (turn * np.append(state.centres[1:], 0))[:, None, :], 0)
    swing[:, np.arange(len(below)), problem.segment - 1] = 1j * turn[:, problem.segment - 1] * state.local
    return np.asarray(swing)


def _real(pull: np.ndarray) -> FloatArray:
    """(..., 2, 2 n) real pulls of a slide along the segment's x and y from complex ones (..., n) along x."""
    along = np.stack([pull.real, pull.imag], axis=-1).reshape(*pull.shape[:-1], -1)
    across = np.stack([-pull.imag, pull.real], axis=-1).reshape(*pull.shape[:-1], -1)
    return np.stack([along, across], axis=-2)


def shapes(problem: Problem, state: State) -> FloatArray:
    """(T, K, 2) angles of the joints below and above each marker's segment without their mean, 1 rms together."""
    relative = np.diff(state.angles, axis=1, prepend=0.0, append=0.0)  # (T, n + 1)
    relative[:, -1] = 0
    relative = relative - relative.mean(axis=0)
    both = np.stack([relative[:, problem.segment - 1], relative[:, problem.segment]], axis=2)
    rms = np.sqrt(np.mean(np.sum(both**2, axis=2), axis=0))
    return np.asarray(both / np.where(rms > 0, rms, 1)[:, None])
