"""Least squares over the cone of physically possible parameters by Clarabel's interior-point method."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.consistency_cone import LENGTH, ConeBodies
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.optimality import SolverAnswer, check_optimality

if TYPE_CHECKING:
    from mocap_id.dynamics.space.consistency import SemidefiniteBodies

ConicBodies: TypeAlias = "ConeBodies | SemidefiniteBodies"
"""Possible bodies in the plane or in space, given by v numbers each."""
_ACCURACY, _ITERATIONS = 1e-12, 200
_ROUNDS = 3
_REGULARIZATION = 1e-6  # Clarabel's default is 1e-8
_ENOUGH = 1e-9  # possible relative decrease of the cost below which the rounds end
_NO_MASS = 1e-9  # fraction of the total mass below which a link has no mass
_TINY = 1e-200
_DEPENDENT = 1e-10  # fraction of the largest singular value
_ROUNDING = 1e-7  # relative violation of the cone that counts as rounding


def solve_links(problem: CompressedProblem, bodies: ConicBodies) -> SolverAnswer:
    """Minimise ‖R · mapping · body - d‖² over possible links; return the full parameters of one of many solutions.

    Clarabel's accuracy is relative to the whole wrench, whereas the cost is the small remaining residual. As long as
    the optimality conditions do not hold, Clarabel is run again for a correction on the scale of the residual. If the
    least cost is only approached by larger and larger links, the conditions may still not hold. Clarabel then starts
    again with more regularization. The caller eliminates free parameters (:meth:`CompressedProblem.eliminate_others`).
    """
    first = _solve_with_corrections(problem, bodies, None)
    if first.optimality.proven:
        return first
    second = _solve_with_corrections(problem, bodies, _REGULARIZATION)
    return second if second.optimality.excess < first.optimality.excess else first


def _solve_with_corrections(
    problem: CompressedProblem, bodies: ConicBodies, regularization: float | None
) -> SolverAnswer:
    """Return Clarabel's solution after several corrections; corrections that do not decrease the cost are discarded."""
    mapped, body = problem.factor @ bodies.mapping, np.zeros(bodies.mapping.shape[1])
    answer, iterations = None, 0
    for _ in range(_ROUNDS):
        target = problem.target - mapped @ body
        step, status, used = find_step(mapped, target, bodies, body, regularization=regularization)
        iterations += used
        body = bodies.settle(body + step)
        cost, optimality = problem.cost(bodies.mapping @ body), check_optimality(problem, bodies, body)
        worse = answer is not None and answer.optimality.proven and not optimality.proven
        if answer is not None and (worse or not cost < answer.cost):
            break
        answer = SolverAnswer("clarabel", body, cost, optimality, status, iterations)
        if optimality.excess <= _ENOUGH:
            break
    assert answer is not None
    return answer


def find_step(
    mapped: FloatArray,
    target: FloatArray,
    bodies: ConicBodies,
    body: FloatArray,
    *,
    regularization: float | None = None,
) -> tuple[FloatArray, str, int]:
    """Return the step (v,) that minimises ‖mapped · step - target‖² with body + step in the cone.

    Also return Clarabel's status text and the number of iterations. The step is NaN if Clarabel fails.

    Parameters
    ----------
    mapped : (b, v) array
        Matrix from a step to the change of the fitted values.
    target : (b,) array
        Residual before the step.
    bodies : ConicBodies
        The cone.
    body : (v,) array
        Body before the step, in the cone.
    regularization : float, optional
        As for :func:`solve_cones`.
    """
    units = bodies.units
    size, length = float(np.linalg.norm(mapped * units, axis=0).max()), float(np.linalg.norm(target))
    if min(size, length) < _TINY:
        return np.zeros_like(body), "nothing to fit", 0
    sides, cones = bodies.sides()
    rows, base = mapped * units / size, len(target)
    solution, status, iterations = solve_cones(
        quadratic=sparse.csc_matrix(np.diag(np.repeat([0.0, 1.0], [len(body), base]))),
        linear=np.concatenate([np.zeros(len(body)), -target / length]),
        matrix=np.block([[rows, -np.eye(base)], [-sides * units, np.zeros((len(sides), base))]]),
        bound=np.concatenate([np.zeros(base), sides @ body * (size / length)]),
        cones=(("zero", base), *cones),
        regularization=regularization,
    )
    return solution[: len(body)] * units * (length / size), status, iterations


def find_closest_links(bodies: ConeBodies, body: FloatArray, aim: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the links (4(n + 1),) with the base parameters of ``body`` whose full parameters are closest to a target.

    The target ``aim`` and its standard deviations ``scale`` are full parameters (4(n + 1),). If a link has first
    moments but no mass, possible links with larger and larger Izz only approach its base parameters, and its Izz is
    NaN.
    """
    hollow = [link for link in range(bodies.links) if _is_hollow(bodies, body, link)]
    limits = bodies if hollow else ConeBodies(np.eye(len(body)), bodies.boxes)  # also limits an unobservable Izz
    links = limits.settle(body)
    directions = null_space(bodies.mapping, rcond=_DEPENDENT)
    if directions.shape[1]:
        moved = links + directions @ find_closest_step(limits, links, directions, (aim - links) / scale, scale)
        links = limits.settle(moved) if limits.measure_violation(moved) <= _ROUNDING else links
    links[[4 * link + 3 for link in hollow]] = np.nan
    return links


def _is_hollow(bodies: ConeBodies, body: FloatArray, link: int) -> bool:
    """Return whether a link with an unobservable Izz has first moments but no mass."""
    mass, *first = np.abs(body[4 * link : 4 * link + 3])
    least = _NO_MASS * bodies.mass(body)
    return not bodies.is_limited(link) and bool(mass <= least < max(first) / LENGTH)


def find_closest_step(
    limits: ConicBodies, start: FloatArray, directions: FloatArray, distance: FloatArray, scale: FloatArray
) -> FloatArray:
    """Return the steps (d,) along directions (v, d) after which a body is closest to a target; NaN if Clarabel fails.

    ``start`` (v,) is the body before the steps, inside the cone. ``scale`` (v,) are the standard deviations of the
    target, and ``distance`` (v,) is target minus start, divided by ``scale``.
    """
    sides, cones = limits.sides()
    rows = directions / scale[:, None]
    step, _, _ = solve_cones(
        quadratic=sparse.csc_matrix(rows.T @ rows),
        linear=-rows.T @ distance,
        matrix=-sides @ directions,
        bound=sides @ start,
        cones=(("zero", 0), *cones),
    )
    return step


def solve_cones(
    quadratic: sparse.csc_matrix,
    linear: FloatArray,
    matrix: FloatArray,
    bound: FloatArray,
    cones: tuple[tuple[str, int], ...],
    *,
    accuracy: float = _ACCURACY,
    regularization: float | None = None,
) -> tuple[FloatArray, str, int]:
    """Minimise ½ xᵀ quadratic x + linear·x with bound - matrix·x in cones; return x, status and number of iterations.

    ``cones`` are the kind and the size of each cone. ``regularization`` is Clarabel's constant on the diagonal of its
    equations; None for the default. The solution is NaN if Clarabel stops because of an internal error.
    """
    import clarabel  # noqa: PLC0415  not needed for a grid

    kinds = {
        "zero": clarabel.ZeroConeT,
        "round": clarabel.SecondOrderConeT,
        "flat": clarabel.NonnegativeConeT,
        "semidefinite": clarabel.PSDTriangleConeT,
    }
    limits = [kinds[kind](size) for kind, size in cones]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, _ITERATIONS
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
    if regularization is not None:
        settings.static_regularization_constant = regularization
    upper = sparse.csc_matrix(sparse.triu(quadratic))
    try:
        solution = clarabel.DefaultSolver(upper, linear, sparse.csc_matrix(matrix), bound, limits, settings).solve()
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # from Clarabel's eigenvalue routine; not a subclass of Exception
            raise
        return np.full(len(linear), np.nan), "stopped by an internal error", 0
    return np.asarray(solution.x, dtype=np.float64), str(solution.status), int(solution.iterations)
