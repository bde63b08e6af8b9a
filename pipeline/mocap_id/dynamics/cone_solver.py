"""Least squares over the consistency cone by Clarabel's interior-point method."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.consistency_cone import LENGTH, UNITS, ConeBodies
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.optimality import SolverAnswer, check_optimality

_ACCURACY, _ITERATIONS = 1e-12, 200
_ROUNDS = 3
_ENOUGH = 1e-9  # possible relative decrease of the cost that ends the rounds
_NO_MASS = 1e-9  # of the total
_TINY = 1e-200
_DEPENDENT = 1e-10  # of the largest singular value
_ROUNDING = 1e-7  # relative violation of the cone that counts as rounding


def solve_links(problem: CompressedProblem, bodies: ConeBodies) -> SolverAnswer:
    """Minimise ‖R · mapping · body - d‖² over possible links.

    Clarabel's accuracy is relative to the whole wrench, whereas the cost is the small remaining residual. As long as
    the optimality conditions do not hold, Clarabel is run for a correction in the scale of the residual.

    Parameters
    ----------
    problem : CompressedProblem
        b columns; free parameters are eliminated before (:meth:`CompressedProblem.over`).
    bodies : ConeBodies

    Returns
    -------
    SolverAnswer
        Full parameters: one of many solutions with the same base parameters.
    """
    mapped, body = problem.factor @ bodies.mapping, np.zeros(bodies.mapping.shape[1])
    answer, iterations = None, 0
    for _ in range(_ROUNDS):
        step, status, used = conic_step(mapped, problem.target - mapped @ body, bodies, body)
        iterations += used
        body = bodies.settled(body + step)
        cost, optimality = problem.cost(bodies.mapping @ body), check_optimality(problem, bodies, body)
        if answer is not None and not cost < answer.cost:
            break
        answer = SolverAnswer("clarabel", body, cost, optimality, status, iterations)
        if optimality.excess <= _ENOUGH:
            break
    assert answer is not None
    return answer


def conic_step(
    mapped: FloatArray, target: FloatArray, bodies: ConeBodies, body: FloatArray
) -> tuple[FloatArray, str, int]:
    """Find the step that minimises ‖mapped · step - target‖² with body + step in the cone.

    Parameters
    ----------
    mapped : (b, v) array
    target : (b,) array
    bodies : ConeBodies
    body : (v,) array
        Start, in the cone.

    Returns
    -------
    (v,) array
        The step; NaN if Clarabel finds none.
    str
        Clarabel's status text.
    int
        Number of iterations.
    """
    units = np.tile(UNITS, bodies.links)
    size, length = float(np.linalg.norm(mapped * units, axis=0).max()), float(np.linalg.norm(target))
    if min(size, length) < _TINY:
        return np.zeros_like(body), "nothing to fit", 0
    sides, groups = _sides(bodies)
    rows, base = mapped * units / size, len(target)
    solution, status, iterations = _solve(
        quadratic=sparse.csc_matrix(np.diag(np.repeat([0.0, 1.0], [len(body), base]))),
        linear=np.concatenate([np.zeros(len(body)), -target / length]),
        matrix=np.block([[rows, -np.eye(base)], [-sides * units, np.zeros((len(sides), base))]]),
        bound=np.concatenate([np.zeros(base), sides @ body * (size / length)]),
        groups=(base, *groups),
    )
    return solution[: len(body)] * units * (length / size), status, iterations


def closest_links(bodies: ConeBodies, body: FloatArray, aim: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the links with given base parameters whose full parameters are closest to a target.

    Parameters
    ----------
    bodies : ConeBodies
    body : (4(n + 1),) array
        Links of the fit.
    aim, scale : (4(n + 1),) arrays
        Target for the full parameters, and its standard deviations.

    Returns
    -------
    (4(n + 1),) array
        NaN for the Izz of a link with first moments and no mass: these base parameters are attained only in a limit of
        possible links with ever larger Izz.
    """
    hollow = [link for link in range(bodies.links) if _hollow(bodies, body, link)]
    limits = bodies if hollow else ConeBodies(np.eye(len(body)), bodies.boxes)  # also limits an unobservable Izz
    found = limits.settled(body)
    directions = null_space(bodies.mapping, rcond=_DEPENDENT)
    if directions.shape[1]:
        moved = found + directions @ _closest_step(limits, found, directions, (aim - found) / scale, scale)
        found = limits.settled(moved) if limits.outside(moved) <= _ROUNDING else found
    found[[4 * link + 3 for link in hollow]] = np.nan
    return found


def _hollow(bodies: ConeBodies, body: FloatArray, link: int) -> bool:
    """Return whether a link with an unobservable Izz has first moments and no mass."""
    mass, *first = np.abs(body[4 * link : 4 * link + 3])
    least = _NO_MASS * bodies.mass(body)
    return not bodies.limited(link) and bool(mass <= least < max(first) / LENGTH)


def _closest_step(
    limits: ConeBodies, start: FloatArray, directions: FloatArray, distance: FloatArray, scale: FloatArray
) -> FloatArray:
    """Return the steps along directions (v, d) from ``start`` that end closest to the target; NaN if none is found."""
    sides, groups = _sides(limits)
    rows = directions / scale[:, None]
    step, _, _ = _solve(
        quadratic=sparse.csc_matrix(rows.T @ rows),
        linear=-rows.T @ distance,
        matrix=-sides @ directions,
        bound=sides @ start,
        groups=(0, *groups),
    )
    return step


def _sides(bodies: ConeBodies) -> tuple[FloatArray, tuple[int, int]]:
    """Return the rows of all conditions of the cone, second-order cones first, and the number of each kind."""
    round_, flat = bodies.round_sides(), bodies.flat_sides()
    return np.vstack([*round_, flat]), (len(round_), len(flat))


def _solve(
    quadratic: sparse.csc_matrix,
    linear: FloatArray,
    matrix: FloatArray,
    bound: FloatArray,
    groups: tuple[int, int, int],
) -> tuple[FloatArray, str, int]:
    """Run Clarabel on min ½ xᵀ quadratic x + linear·x with bound - matrix·x in the cones: x, status, iterations.

    ``groups`` counts the rows that are zero, the second-order cones of four rows, and the rows that are not negative.
    """
    import clarabel  # noqa: PLC0415  not needed for a grid

    zero, round_, flat = groups
    cones = [clarabel.ZeroConeT(zero), *[clarabel.SecondOrderConeT(4)] * round_, clarabel.NonnegativeConeT(flat)]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, _ITERATIONS
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    upper = sparse.csc_matrix(sparse.triu(quadratic))
    solution = clarabel.DefaultSolver(upper, linear, sparse.csc_matrix(matrix), bound, cones, settings).solve()
    return np.asarray(solution.x, dtype=np.float64), str(solution.status), int(solution.iterations)
