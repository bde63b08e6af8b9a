"""Physically consistent parameters: fits over possible bodies, which are point masses on a grid or the exact cone.

Non-negative least squares solves the fit on the grid (eq. 4.12, 4.25), and Clarabel that in the cone. Every solution is
checked for optimality (:mod:`mocap_id.dynamics.optimality`), which needs no second solver. OSQP is run only if the
solution on the grid does not pass the check.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cone_solver import find_closest_links, solve_links
from mocap_id.dynamics.consistency_cone import ConeBodies
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.optimality import BodyCone, SolverAnswer, check_optimality
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.point_masses import GridBodies, solve_nnls, solve_osqp, spread_masses
from mocap_id.dynamics.reference_prior import compute_reference_sd
from mocap_id.errors import NumericalError

Consistency = Literal["grid", "cone", "bounded-cone"]
"""Set of possible bodies: masses on the grid, masses anywhere, or masses anywhere within the outlines of the grid."""
_TOLERABLE = 1e-3  # largest relative distance to the least cost with which a solution is accepted


@dataclass(frozen=True)
class ConsistentSolution:
    """Consistent parameters and the solver's report."""

    # requested, consistency: the requested set of bodies, and the set used: `grid` if the solution in the cone was
    # not proven to be optimal
    requested: Consistency
    consistency: Consistency
    parameters: FloatArray  # (b + k,) parameters of the problem: first those of the bodies, then the free ones
    # (4(n + 1),) full parameters of one body with these parameters: the body closest to the reference, or a body of
    # evenly spread point masses. NaN for an Izz that possible bodies only approach.
    full: FloatArray
    # (p,) point masses with these full parameters, kg; NaN for the cone, whose bodies need not be on the grid
    masses: FloatArray
    answer: SolverAnswer  # the solution used, checked on the whole problem
    price: float  # relative increase of the cost over that of unconstrained parameters


def fit_consistent(
    problem: CompressedProblem,
    regrouping: FloatArray,
    grid: PointGrid,
    reference: FloatArray,
    *,
    consistency: Consistency = "grid",
    relative_sd: float = 0.15,
) -> ConsistentSolution:
    """Minimise ‖R [M φ; c] - d‖² over possible bodies φ and free parameters c.

    Parameters
    ----------
    problem : CompressedProblem
        Problem of b + k columns.
    regrouping : (b, 4(n + 1)) array
        Matrix M of eq. 4.24, from full parameters to the first b parameters of the problem.
    reference : (4(n + 1),) array
        Full parameters to approach, as far as the problem does not determine them; NaN for none.
    consistency : {"grid", "cone", "bounded-cone"}
        The set of possible bodies.
    relative_sd : float
        Standard deviation of the reference, relative to each parameter's size.

    Raises
    ------
    NumericalError
        No solver's solution is close enough to the least cost.
    """
    small, full_moments = problem.eliminate_others(len(regrouping)), grid.moments()
    moments = regrouping @ full_moments
    bodies = _choose_bodies(regrouping, grid, consistency)

    def spread(answer: SolverAnswer) -> FloatArray:
        return spread_masses(
            moments, answer.body, full_moments, reference, compute_reference_sd(reference, relative_sd)
        )

    if isinstance(bodies, ConeBodies):
        links = solve_links(small, bodies)
        if links.optimality.proven:
            aim = reference
            if not np.isfinite(aim).all():
                aim = np.where(np.isfinite(aim), aim, full_moments @ spread(_fit_point_masses(small, moments)))
            full = find_closest_links(bodies, links.body, aim, compute_reference_sd(aim, relative_sd))
            nowhere = np.full(full_moments.shape[1], np.nan)
            return _complete_solution(problem, bodies, (consistency, consistency), (full, nowhere), links)
    answer = _fit_point_masses(small, moments)
    masses = spread(answer)
    return _complete_solution(
        problem, GridBodies(moments), (consistency, "grid"), (full_moments @ masses, masses), answer
    )


def fit_quickly(
    problem: CompressedProblem, regrouping: FloatArray, grid: PointGrid, consistency: Consistency
) -> FloatArray:
    """Return only the parameters (b + k,) of :func:`fit_consistent`, in a fraction of the time.

    The arguments and errors are those of :func:`fit_consistent`, which is called if the solution is not proven to be
    optimal.
    """
    small, bodies = problem.eliminate_others(len(regrouping)), _choose_bodies(regrouping, grid, consistency)
    answer = solve_nnls(small, bodies.mapping) if isinstance(bodies, GridBodies) else solve_links(small, bodies)
    if answer.optimality.proven:
        return problem.complete(bodies.mapping @ answer.body)
    nowhere = np.full(regrouping.shape[1], np.nan)
    return fit_consistent(problem, regrouping, grid, nowhere, consistency=consistency).parameters


def _choose_bodies(regrouping: FloatArray, grid: PointGrid, consistency: Consistency) -> GridBodies | ConeBodies:
    """Return the set of possible bodies."""
    if consistency == "grid":
        return GridBodies(regrouping @ grid.moments())
    return ConeBodies(regrouping, grid.boxes() if consistency == "bounded-cone" else None)


def _fit_point_masses(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Return the solution of non-negative least squares if it is proven; otherwise, the better of this and OSQP's."""
    first = solve_nnls(problem, moments)
    if first.optimality.proven:
        return first
    second = solve_osqp(problem, moments)
    excess = [answer.optimality.excess if np.isfinite(answer.cost) else np.inf for answer in (first, second)]
    if not min(excess) <= _TOLERABLE:
        raise NumericalError(
            f"the fit of point masses did not converge: the cost of {first.solver} ({first.status!r}) may be "
            f"{excess[0]:.1e} above the least cost, and that of {second.solver} ({second.status!r}) {excess[1]:.1e}; "
            f"the limit is {_TOLERABLE:.0e}. Check the chain for two joints at the same position, or for wrong units"
        )
    return first if excess[0] <= excess[1] else second


def _complete_solution(
    problem: CompressedProblem,
    bodies: BodyCone,
    consistency: tuple[Consistency, Consistency],
    full_and_masses: tuple[FloatArray, FloatArray],
    answer: SolverAnswer,
) -> ConsistentSolution:
    """Return the solution, checked on the whole problem, with the increase of the cost due to consistency."""
    parameters = problem.complete(bodies.mapping @ answer.body)
    optimality = check_optimality(problem, bodies, answer.body, parameters[len(bodies.mapping) :])
    free = problem.cost(problem.free_solution())
    return ConsistentSolution(
        requested=consistency[0],
        consistency=consistency[1],
        parameters=parameters,
        full=full_and_masses[0],
        masses=full_and_masses[1],
        answer=replace(answer, optimality=optimality),
        price=max(answer.cost - free, 0.0) / problem.floor(free),
    )
