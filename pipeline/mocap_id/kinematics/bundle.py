"""Joint centres, marker coordinates and angles of the whole chain at once (3.13-3.16).

Gauss-Newton on :mod:`mocap_id.kinematics.chain_equations`, robust against bursts. A segment frame's own turn is a gauge
freedom: steps are the shortest ones, and :func:`fix_gauge` settles it afterwards (this is what lambda_phi of 3.16 is
for). Markers do not count alike: skin over muscle slides more than skin over bone, and every marker weighs as its own
residuals say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.kinematics.centre_covariance import centre_covariance
from mocap_id.kinematics.chain_equations import Problem, State, moved, predicted, reduce, shared_variance
from mocap_id.kinematics.chain_fit import ChainFit, continuous, joint_angles, length_sd
from mocap_id.kinematics.joint import arc
from mocap_id.kinematics.links import frames_used, rigid_body_links
from mocap_id.kinematics.rigid import still_body

_ITERATIONS = 200
_CONVERGED = 1e-7  # relative fall of the cost
_NEARLY = 1e-3  # relative fall of the cost after which the markers' weights are taken from their residuals
_WEIGHINGS = 2
_HUBER = 3.0  # scales beyond which a residual is a burst
_EXACT = 1e-4  # m; markers with smaller residuals weigh alike


def fit_chain(
    points: ComplexArray, segment: IntArray, auxiliary: Mapping[int, ComplexArray] | None = None, pull: float = 0.01
) -> ChainFit:
    """Fit the serial chain to the markers of its segments.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    segment : (M,) int array
        Segment of each marker, 0 = base, 1 … n from base to tip; every segment has at least two markers.
    auxiliary : mapping of int to (F,) complex array
        Where markers put a joint (1 … n) in the plane, m; NaN where unseen (p_A of 3.15).
    pull : float
        Weight of an auxiliary point against an average marker (lambda_A of 3.16).

    Raises
    ------
    Refused
        ``too-few-frames`` show every segment.
    NumericalError
        The iteration does not settle.
    """
    moving = np.flatnonzero(segment > 0)
    joints = int(segment.max())
    start = rigid_body_links(points, segment)
    used = np.flatnonzero(frames_used(start.angles))
    problem = _problem(points[np.ix_(used, moving)], segment[moving], auxiliary or {}, used, joints)
    local = np.concatenate([start.local[moving], np.zeros(int(problem.pinned.sum()))])
    state, problem, iterations = _solve(problem, State(start.centres, local, start.angles[used]), pull)
    return replace(_collect(points, segment, used, problem, state), iterations=iterations)


def _problem(
    points: ComplexArray, segment: IntArray, auxiliary: Mapping[int, ComplexArray], used: IntArray, joints: int
) -> Problem:
    """The moving markers, and the auxiliary points as markers that sit on their joint."""
    columns = np.concatenate([points, *(track[used, None] for track in auxiliary.values())], axis=1)
    seen = np.isfinite(columns)
    return Problem(
        np.where(seen, columns, 0),
        seen.astype(np.float64),
        np.concatenate([segment, np.array(list(auxiliary), dtype=np.int64)]),
        np.arange(columns.shape[1]) >= len(segment),
        joints,
    )


def _solve(problem: Problem, state: State, pull: float) -> tuple[State, Problem, int]:
    """Reweighted Gauss-Newton: bursts beyond a few scales of their segment's residual lose their say."""
    scale = np.where(problem.pinned, pull, 1.0)
    cost, weighings = np.inf, 0
    for iteration in range(1, _ITERATIONS + 1):
        problem = _reweighted(problem, state, scale)
        state = moved(state, reduce(problem, state).step())
        previous, cost = cost, _cost(problem, state)
        fall = abs(previous - cost)
        if fall <= _NEARLY * cost and weighings < _WEIGHINGS:
            scale[~problem.pinned] = _marker_weights(problem, state)
            cost, weighings = np.inf, weighings + 1
        elif fall <= _CONVERGED * cost + 1e-18:
            return state, problem, iteration
    raise NumericalError(f"the joint fit has not settled after {_ITERATIONS} iterations; are the segments right?")


def _cost(problem: Problem, state: State) -> float:
    off = problem.points - predicted(problem, state)
    return float(np.sum(problem.weights * np.abs(off) ** 2))


def _reweighted(problem: Problem, state: State, scale: FloatArray) -> Problem:
    """The markers' weights, with Huber's on each segment's own scale."""
    seen = problem.weights > 0
    off = np.abs(problem.points - predicted(problem, state))
    weights = np.where(seen, scale, 0.0)
    for k in range(1, problem.joints + 1):
        members = (problem.segment == k) & ~problem.pinned
        limit = _HUBER * max(np.median(off[:, members][seen[:, members]]) / 1.1774, 1e-9)  # median of Rayleigh's law
        weights[:, members] *= np.minimum(1, limit / np.maximum(off[:, members], limit))
    return replace(problem, weights=weights)


def _marker_weights(problem: Problem, state: State) -> FloatArray:
    """Inverse variance of each marker that is not pinned, 1 on average."""
    own = ~problem.pinned
    seen = (problem.weights > 0)[:, own]
    off = np.where(seen, np.abs(problem.points - predicted(problem, state))[:, own], 0)
    square = np.minimum(off, _HUBER * np.sqrt(np.mean(off**2, axis=0))) ** 2
    variance = square.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    variance = shared_variance(variance, problem.weights[:, own].mean(axis=0), problem.segment[own], state.local[own])
    weight = 1 / np.maximum(variance, _EXACT**2)
    return np.asarray(weight / weight.mean())


def _collect(points: ComplexArray, segment: IntArray, used: IntArray, problem: Problem, state: State) -> ChainFit:
    """Residuals, arcs and covariance of the solution."""
    moving, still = np.flatnonzero(segment > 0), np.flatnonzero(segment == 0)
    base = still_body(points, still)
    local = np.zeros(len(segment), dtype=np.complex128)
    local[still], local[moving] = base.template, state.local[~problem.pinned]
    residual = np.zeros(len(segment))
    residual[still] = _rms(points[:, still] - base.template)
    seen = problem.weights > 0
    off = np.where(seen, problem.points - predicted(problem, state), np.nan)
    residual[moving] = _rms(off[:, ~problem.pinned])
    angles = np.full((len(points), problem.joints), np.nan)
    angles[used] = state.angles
    angles = continuous(angles)
    full = centre_covariance(problem, state, reduce(problem, state))
    covariance = np.stack([full[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(problem.joints)])
    arcs = np.array([arc(np.exp(1j * relative)) for relative in joint_angles(angles[used]).T])
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


def _rms(off: ComplexArray) -> FloatArray:
    """(K,) rms modulus of the columns, NaN left out."""
    return np.asarray(np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0)))
