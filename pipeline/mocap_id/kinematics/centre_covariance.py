"""Covariance of the joint centres from camera noise and from skin that slides with the joints.

Residuals of neighbouring frames are correlated. The scores of the frames are therefore summed over blocks of time
before they are squared (sandwich estimator). Slides in proportion to a joint angle leave almost no residual. They are
modelled and propagated through the normal equations: docs/concepts/sliding-skin.md.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray
from mocap_id.kinematics.chain_equations import (
    ChainProblem,
    ChainState,
    Reduced,
    angle_jacobian,
    joint_positions,
    remaining_share,
    residuals,
)

_BLOCKS = 20  # blocks of time assumed independent


def centre_covariance(problem: ChainProblem, state: ChainState, reduced: Reduced) -> FloatArray:
    """Return the covariance (2 n, 2 n) of the centres, m^2, in the order x, y of each centre.

    The arguments are values at the solution of the joint fit.
    """
    centres = reduced.inverse[:, : 2 * problem.joints]
    blocks = np.array_split(reduced.scores, min(_BLOCKS, len(reduced.scores)))
    sums = np.stack([block.sum(axis=0) for block in blocks]) @ centres
    noise = len(sums) / max(len(sums) - 1, 1) * sums.T @ sums
    sizes = np.sqrt(slide_variances(problem, state))
    moved = slide_responses(problem, state, reduced, slide_shapes(problem, state), centres)
    flat = (moved * sizes[:, None, None, None]).reshape(-1, 2 * problem.joints)
    return np.asarray(noise + flat.T @ flat)


def slide_variances(problem: ChainProblem, state: ChainState) -> FloatArray:
    """Return the variance (K,) of each marker's slide in one coordinate, m^2.

    The variance is the lag-one covariance of the residuals, divided by the fraction that remains after the segment's
    pose is fitted.
    """
    seen = problem.weights > 0
    off = np.where(seen, residuals(problem, state), 0)
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
    problem: ChainProblem, state: ChainState, reduced: Reduced, shape: FloatArray, towards: FloatArray
) -> FloatArray:
    """Return the change (K, S, 2, p) of p common unknowns if each marker slides along x or y of its segment.

    ``shape`` (T, K, S) are S time courses of the slide of each marker, m. ``towards`` (P, p) are the columns of
    ``reduced.inverse`` for the requested unknowns. The other arguments are values at the solution.
    """
    joints = problem.joints
    _, turn = joint_positions(state)
    own = turn[:, problem.segment - 1]  # (T, K)
    slid = (problem.weights * own)[..., None] * shape
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)
    below = np.arange(joints) < problem.segment[:, None]  # (K, n)
    centres = np.einsum("tj,tks->ksj", np.conj(lever), slid) * below[:, None, :]
    itself = np.einsum("tk,tks->ks", problem.weights, shape)
    of_centre = _split_directions(centres) @ towards[: 2 * joints]
    rows = towards[2 * joints :].reshape(-1, 2, towards.shape[1])  # (K, 2, p)
    of_itself = itself[:, :, None, None] * rows[:, None]
    pull = np.conj(angle_jacobian(problem, state))[:, :, None, :] * slid[..., None]  # (T, K, S, n)
    solved = reduced.solved[..., :-1]  # (T, n, P)
    turned = [np.tensordot(part, solved, axes=([0, 3], [0, 1])) for part in (pull.real, -pull.imag)]
    return np.asarray(of_centre + of_itself - np.stack(turned, axis=2) @ towards)


def _split_directions(pull: np.ndarray) -> FloatArray:
    """Return real gradients (..., 2, 2 n) for slides along x and y, from complex gradients (..., n) along x."""
    along = np.stack([pull.real, pull.imag], axis=-1).reshape(*pull.shape[:-1], -1)
    across = np.stack([-pull.imag, pull.real], axis=-1).reshape(*pull.shape[:-1], -1)
    return np.stack([along, across], axis=-2)


def slide_shapes(problem: ChainProblem, state: ChainState) -> FloatArray:
    """Return the angles (T, K, 2) of the joints below and above each marker, without mean, with a common rms of 1."""
    relative = np.diff(state.angles, axis=1, prepend=0.0, append=0.0)  # (T, n + 1)
    relative[:, -1] = 0
    relative = relative - relative.mean(axis=0)
    both = np.stack([relative[:, problem.segment - 1], relative[:, problem.segment]], axis=2)
    rms = np.sqrt(np.mean(np.sum(both**2, axis=2), axis=0))
    return np.asarray(both / np.where(rms > 0, rms, 1)[:, None])
