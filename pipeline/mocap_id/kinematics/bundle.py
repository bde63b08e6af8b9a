"""Joint centres, marker coordinates and angles of the whole chain, fitted together (3.13 to 3.16).

The fit solves :mod:`mocap_id.kinematics.chain_equations` by Gauss-Newton; bursts (large residuals) have less weight.
The data do not determine the orientation of a segment frame. Each iteration therefore takes the shortest step, and
:func:`orient_frames` sets the orientation afterwards (the purpose of lambda_phi in 3.16). Each marker is weighted by
its residuals, because skin over muscle slides more than skin over bone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics.centre_covariance import centre_covariance
from mocap_id.kinematics.chain_equations import (
    ChainProblem,
    ChainState,
    apply_step,
    eliminate_angles,
    residuals,
    share_variance,
)
from mocap_id.kinematics.chain_fit import ChainFit, joint_angles, length_sd, unwrap_angles
from mocap_id.kinematics.joint import arc
from mocap_id.kinematics.links import find_used_frames, rigid_body_links
from mocap_id.kinematics.rigid_body import still_body

_ITERATIONS = 300
_ADAPTED = 100  # iterations in which the limits of bursts follow the residuals; later, they could alternate
_CONVERGED = 1e-7  # relative decrease of the cost
_NEARLY = 1e-3  # relative decrease of the cost at which the markers are weighted by their residuals
_WEIGHINGS = 2
_SHORTENINGS = 6
_HUBER = 3.0  # a residual larger than this many times the scale is a burst
_OFF_JOINT = 0.01  # m; standard deviation of a marker from the joint that it represents, in x and in y
_EXACT = 1e-4  # m; markers with smaller residuals have equal weights


def fit_chain(
    points: ComplexArray,
    segment: IntArray,
    auxiliary: Mapping[int, ComplexArray] | None = None,
    pull: float = 0.01,
    start: ChainState | None = None,
) -> ChainFit:
    """Fit the serial chain to the markers of its segments.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where missing.
    segment : (M,) int array
        Segment of each marker, 0 = base, 1 … n from base to tip. Every segment has at least two markers unless
        ``start`` is given.
    auxiliary : mapping of int to (F,) complex array
        Positions in the plane, m, of joints 1 … n according to markers at the joints; NaN where missing (p_A of 3.15).
    pull : float
        Weight of an auxiliary point relative to an average marker (lambda_A of 3.16).
    start : ChainState, optional
        First guess: centres, coordinates of all M markers, angles (F, n); NaN where unknown.

    Raises
    ------
    Refused
        ``too-few-frames`` if too few frames contain all segments; ``joint-unsettled`` if the iteration does not
        converge.
    """
    moving = np.flatnonzero(segment > 0)
    joints = int(segment.max())
    start = start or rigid_body_links(points, segment)
    used = np.flatnonzero(find_used_frames(start.angles))
    tracks = {joint: track[used] for joint, track in (auxiliary or {}).items()}
    problem = ChainProblem.with_joint_markers(points[np.ix_(used, moving)], segment[moving], tracks, joints)
    local = np.concatenate([start.local[moving], np.zeros(int(problem.pinned.sum()))])
    state, problem, iterations = _solve(problem, ChainState(start.centres, local, start.angles[used]), pull)
    return replace(_collect(points, segment, used, problem, state), iterations=iterations)


def _solve(problem: ChainProblem, state: ChainState, pull: float) -> tuple[ChainState, ChainProblem, int]:
    """Return the best state, the problem with final weights (``pull`` for pinned markers) and the iteration count."""
    scale = np.where(problem.pinned, pull, 1.0)
    cost, weighings = np.inf, 0
    limits, moved, off = np.zeros(problem.joints), np.zeros(problem.joints), np.abs(residuals(problem, state))
    for iteration in range(1, _ITERATIONS + 1):
        if iteration <= _ADAPTED:
            limits = _find_burst_limits(problem, off)
        limit = limits[problem.segment - 1]
        bursts = np.where(problem.pinned, 1.0, limit / np.maximum(off, limit))  # Huber weights
        problem = replace(problem, weights=np.where(problem.weights > 0, scale * bursts, 0.0))
        before, (state, off) = state, _take_step(problem, state, off)
        moved = np.abs(state.centres - before.centres)
        previous, cost = cost, _cost(problem, off)
        fall = abs(previous - cost)
        if fall <= _NEARLY * cost and weighings < _WEIGHINGS:
            scale[~problem.pinned] = _weight_markers(problem, state, off)
            cost, weighings = np.inf, weighings + 1
        elif fall <= _CONVERGED * cost + 1e-18:
            return state, problem, iteration
    raise Refused(
        "joint-unsettled",
        f"the centre of joint {np.argmax(moved) + 1} still changes after {_ITERATIONS} iterations of the joint fit. "
        "Either the two segments of this joint hardly rotate relative to each other, or a marker is on the wrong "
        "segment. Check their markers in the report (segments), and set `segment: {count: …}`, list markers that are "
        "`together` or `apart`, or list markers to `ignore`",
        float(moved.max()),
    )


def _take_step(problem: ChainProblem, state: ChainState, off: FloatArray) -> tuple[ChainState, FloatArray]:
    """Return the state after a step, which is halved while the cost increases, and the residual distances (T, K), m."""
    common, turns = eliminate_angles(problem, state).step()
    before = _cost(problem, off)
    for _ in range(_SHORTENINGS):
        tried = apply_step(state, (common, turns))
        off = np.abs(residuals(problem, tried))
        if _cost(problem, off) <= before * (1 + _CONVERGED):
            return tried, off
        common, turns = common / 2, turns / 2
    tried = apply_step(state, (common, turns))
    return tried, np.abs(residuals(problem, tried))


def _cost(problem: ChainProblem, off: FloatArray) -> float:
    return float(np.sum(problem.weights * off**2))


def _find_burst_limits(problem: ChainProblem, off: FloatArray) -> FloatArray:
    """Return the distance, m, above which a residual is a burst, for each segment (n,)."""
    seen = problem.weights > 0
    limits = np.zeros(problem.joints)
    for k in range(1, problem.joints + 1):
        members = (problem.segment == k) & ~problem.pinned
        median = np.median(off[:, members][seen[:, members]])
        rayleigh = median / 1.1774  # scale of a Rayleigh distribution from its median
        limits[k - 1] = _HUBER * max(rayleigh, 1e-9)
    return limits


def _weight_markers(problem: ChainProblem, state: ChainState, off: FloatArray) -> FloatArray:
    """Return the weight of each marker that is not pinned: its inverse variance, scaled to a mean of 1."""
    own = ~problem.pinned
    seen = (problem.weights > 0)[:, own]
    off = np.where(seen, off[:, own], 0)
    square = np.minimum(off, _HUBER * np.sqrt(np.mean(off**2, axis=0))) ** 2
    variance = square.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    variance = share_variance(variance, problem.weights[:, own].mean(axis=0), problem.segment[own], state.local[own])
    weight = 1 / np.maximum(variance, _EXACT**2)
    return np.asarray(weight / weight.mean())


def _collect(
    points: ComplexArray, segment: IntArray, used: IntArray, problem: ChainProblem, state: ChainState
) -> ChainFit:
    """Return the fit with residuals, arcs and covariance."""
    moving, still = np.flatnonzero(segment > 0), np.flatnonzero(segment == 0)
    base = still_body(points, still)
    local = np.zeros(len(segment), dtype=np.complex128)
    local[still], local[moving] = base.template, state.local[~problem.pinned]
    residual = np.zeros(len(segment))
    residual[still] = _rms(points[:, still] - base.template)
    seen = problem.weights > 0
    off = np.where(seen, residuals(problem, state), np.nan)
    residual[moving] = _rms(off[:, ~problem.pinned])
    angles = np.full((len(points), problem.joints), np.nan)
    angles[used] = state.angles
    angles = unwrap_angles(angles)
    full = centre_covariance(problem, state, eliminate_angles(problem, state))
    full += _placement_covariance(problem, state, len(full))
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


def _placement_covariance(problem: ChainProblem, state: ChainState, size: int) -> FloatArray:
    """Return the covariance (size, size) of the centres, m^2, from unknown distances of pinned markers to joints."""
    total = np.zeros((size, size))
    at_rest = eliminate_angles(problem, state).step()[0] if problem.pinned.any() else np.zeros(size)
    for column in np.flatnonzero(problem.pinned):
        for offset in (_OFF_JOINT, 1j * _OFF_JOINT):
            points = problem.points.copy()
            points[:, column] += offset
            shift = (eliminate_angles(replace(problem, points=points), state).step()[0] - at_rest)[:size]
            total += np.outer(shift, shift)
    return total


def _rms(off: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0)))
