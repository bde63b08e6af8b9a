"""Least squares over cones of links, by Clarabel's interior-point method."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cone import LENGTH, UNITS, ConeBodies
from mocap_id.dynamics.optimality import Answer, check
from mocap_id.dynamics.solve import Compressed

_ACCURACY, _ITERATIONS = 1e-12, 200
_ROUNDS = 3
_ENOUGH = 1e-9  # of the cost: with less to gain there is no further round
_NO_MASS = 1e-9  # of the total
_TINY = 1e-200
_DEPENDENT = 1e-10  # of the largest singular value
_ROUNDING = 1e-7  # of a body: its violation of the cone that is rounding


def solve_links(problem: Compressed, bodies: ConeBodies) -> Answer:
    """Minimise ‖R · mapping · body - d‖² over links that can exist.

    Clarabel's accuracy is relative to the whole wrench, while the cost is what little of it is left: where the
    optimality conditions do not hold yet, it is asked for a correction in the residual's own scale.

    Parameters
    ----------
    problem : Compressed
        b columns; parameters that are free are taken out before (:meth:`Compressed.over`).
    bodies : ConeBodies

    Returns
    -------
    Answer
        Full parameters: of the many with the same base parameters some.
    """
    mapped, body = problem.factor @ bodies.mapping, np.zeros(bodies.mapping.shape[1])
    answer, iterations = None, 0
    for _ in range(_ROUNDS):
        step, status, used = conic_step(mapped, problem.target - mapped @ body, bodies, body)
        iterations += used
        body = bodies.settled(body + step)
        cost, optimality = problem.cost(bodies.mapping @ body), check(problem, bodies, body)
        if answer is not None and not cost < answer.cost:
            break
        answer = Answer("clarabel", body, cost, optimality, status, iterations)
        if optimality.excess <= _ENOUGH:
            break
    assert answer is not None
    return answer


def conic_step(
    mapped: FloatArray, target: FloatArray, bodies: ConeBodies, body: FloatArray
) -> tuple[FloatArray, str, int]:
    """The step with body + step in the cone that minimises ‖mapped · step - target‖².

    Parameters
    ----------
    mapped : (b, v) array
    target : (b,) array
    bodies : ConeBodies
    body : (v,) array
        Where to start from, in the cone.

    Returns
    -------
    (v,) array
        The step; NaN where Clarabel has no answer.
    str
        Clarabel's own word.
    int
        Iterations.
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
    """Of all links with the same base parameters, those closest to an aim in the full parameters.

    Parameters
    ----------
    bodies : ConeBodies
    body : (4(n + 1),) array
        Links that fit.
    aim, scale : (4(n + 1),) arrays
        Full parameters aimed at, and the deviation of each that counts as one.

    Returns
    -------
    (4(n + 1),) array
        NaN for the Izz of a link that has first moments and no mass: only a limit of links that exist, with Izz ever
        larger, has these base parameters.
    """
    hollow = [link for link in range(bodies.links) if _hollow(bodies, body, link)]
    limits = bodies if hollow else ConeBodies(np.eye(len(body)), bodies.boxes)  # with the Izz that nothing sees
    found = limits.settled(body)
    directions = null_space(bodies.mapping, rcond=_DEPENDENT)
    if directions.shape[1]:
        moved = found + directions @ _closest_step(limits, found, directions, (aim - found) / scale, scale)
        found = limits.settled(moved) if limits.outside(moved) <= _ROUNDING else found
    found[[4 * link + 3 for link in hollow]] = np.nan
    return found


def _hollow(bodies: ConeBodies, body: FloatArray, link: int) -> bool:
    """Whether a link whose Izz nothing sees has first moments and no mass."""
    mass, *first = np.abs(body[4 * link : 4 * link + 3])
    least = _NO_MASS * bodies.mass(body)
    return not bodies.limited(link) and bool(mass <= least < max(first) / LENGTH)


def _closest_step(
    limits: ConeBodies, start: FloatArray, directions: FloatArray, distance: FloatArray, scale: FloatArray
) -> FloatArray:
    """Steps along directions (v, d) that bring links from ``start`` as near as the cone allows; NaN without answer."""
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
    """All sides of the cone, one below the other: the second-order cones' and the flat ones, and how many of either."""
    round_, flat = bodies.round_sides(), bodies.flat_sides()
    return np.vstack([*round_, flat]), (len(round_), len(flat))


def _solve(
    quadratic: sparse.csc_matrix,
    linear: FloatArray,
    matrix: FloatArray,
    bound: FloatArray,
    groups: tuple[int, int, int],
) -> tuple[FloatArray, str, int]:
    """Clarabel on min ½ xᵀ quadratic x + linear·x with bound - matrix·x in the cones: x, its word, iterations.

    Groups of rows, in order: equal to zero; second-order cones of four rows each; not negative.
    """
    import clarabel  # noqa: PLC0415  a grid does without it

    zero, round_, flat = groups
    cones = [clarabel.ZeroConeT(zero), *[clarabel.SecondOrderConeT(4)] * round_, clarabel.NonnegativeConeT(flat)]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, _ITERATIONS
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    upper = sparse.csc_matrix(sparse.triu(quadratic))
    solution = clarabel.DefaultSolver(upper, linear, sparse.csc_matrix(matrix), bound, cones, settings).solve()
    return np.asarray(solution.x, dtype=np.float64), str(solution.status), int(solution.iterations)
