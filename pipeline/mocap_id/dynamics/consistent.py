"""Parameters of bodies that can exist: on a grid of point masses or in the exact cone, from solvers that are checked.

The grid (4.12, 4.25) is solved by non-negative least squares, the cone by Clarabel. Every answer has to pass the
optimality check (:mod:`mocap_id.dynamics.optimality`), which proves it without a second solver; OSQP is asked where the
grid's does not pass. Whose answer was taken and how it fared stay with the solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cone import ConeBodies
from mocap_id.dynamics.conic import closest_links, solve_links
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.optimality import Answer, Bodies, check
from mocap_id.dynamics.point_masses import GridBodies, solve_nnls, solve_osqp, spread_masses
from mocap_id.dynamics.reference_term import deviations
from mocap_id.dynamics.solve import Compressed
from mocap_id.errors import NumericalError

Consistency = Literal["grid", "cone", "bounded-cone"]
"""Which bodies count as possible: masses on the grid; anywhere; anywhere within the grid's outlines."""
_TOLERABLE = 1e-3  # of the cost: what may be farther above the least one is no solution


@dataclass(frozen=True)
class Solution:
    """Consistent parameters and how the solver fared.

    Parameters
    ----------
    asked, consistency : {"grid", "cone", "bounded-cone"}
        What was asked for and what was used: ``grid`` where the cone's solution could not be proven.
    parameters : (b + k,) array
        Of the problem: those that the bodies map to, then the free ones.
    full : (4(n + 1),) array
        Full parameters of one body with these: closest to the reference, else of the most even point masses. NaN for
        an Izz that only a limit of bodies would have.
    masses : (p,) array
        Point masses with these full parameters; NaN with the cone, whose bodies need not be on the grid.
    answer : Answer
        The one that was taken, checked on the whole problem.
    price : float
        Relative increase of the cost over that of parameters without any constraint.
    """

    asked: Consistency
    consistency: Consistency
    parameters: FloatArray
    full: FloatArray
    masses: FloatArray
    answer: Answer
    price: float


def fit_consistent(
    problem: Compressed,
    regrouping: FloatArray,
    grid: PointGrid,
    reference: FloatArray,
    *,
    consistency: Consistency = "grid",
    relative_sd: float = 0.15,
) -> Solution:
    """Minimise ‖R [M φ; c] - d‖² over bodies φ that can exist and free parameters c.

    Parameters
    ----------
    problem : Compressed
        b + k columns.
    regrouping : (b, 4(n + 1)) array
        M of eq. 4.24, from full parameters to the problem's first b.
    grid : PointGrid
    reference : (4(n + 1),) array
        Full parameters to be close to in what the problem does not tell; NaN for none.
    consistency : {"grid", "cone", "bounded-cone"}
    relative_sd : float
        The deviation from the reference that counts as one, of each parameter's size.

    Returns
    -------
    Solution

    Raises
    ------
    NumericalError
        No solver's answer is near enough to the least cost.
    """
    small, full_moments = problem.over(len(regrouping)), grid.moments()
    moments = regrouping @ full_moments
    bodies = _bodies(regrouping, grid, consistency)

    def spread(answer: Answer) -> FloatArray:
        return spread_masses(moments, answer.body, full_moments, reference, deviations(reference, relative_sd))

    if isinstance(bodies, ConeBodies):
        links = solve_links(small, bodies)
        if links.optimality.proven:
            aim = reference
            if not np.isfinite(aim).all():
                aim = np.where(np.isfinite(aim), aim, full_moments @ spread(_point_masses(small, moments)))
            full = closest_links(bodies, links.body, aim, deviations(aim, relative_sd))
            nowhere = np.full(full_moments.shape[1], np.nan)
            return _solution(problem, bodies, (consistency, consistency), (full, nowhere), links)
    answer = _point_masses(small, moments)
    found = spread(answer)
    return _solution(problem, GridBodies(moments), (consistency, "grid"), (full_moments @ found, found), answer)


def fit_quickly(problem: Compressed, regrouping: FloatArray, grid: PointGrid, consistency: Consistency) -> FloatArray:
    """Parameters (b + k,) of :func:`fit_consistent` without the full body, at a fraction of the time.

    The answer is checked as ever; where it is not proven, the long way is taken.

    Parameters
    ----------
    problem, regrouping, grid, consistency
        As for :func:`fit_consistent`.

    Raises
    ------
    NumericalError
        As for :func:`fit_consistent`.
    """
    small, bodies = problem.over(len(regrouping)), _bodies(regrouping, grid, consistency)
    answer = solve_nnls(small, bodies.mapping) if isinstance(bodies, GridBodies) else solve_links(small, bodies)
    if answer.optimality.proven:
        return problem.completed(bodies.mapping @ answer.body)
    nowhere = np.full(regrouping.shape[1], np.nan)
    return fit_consistent(problem, regrouping, grid, nowhere, consistency=consistency).parameters


def _bodies(regrouping: FloatArray, grid: PointGrid, consistency: Consistency) -> GridBodies | ConeBodies:
    if consistency == "grid":
        return GridBodies(regrouping @ grid.moments())
    return ConeBodies(regrouping, grid.boxes() if consistency == "bounded-cone" else None)


def _point_masses(problem: Compressed, moments: FloatArray) -> Answer:
    """The answer of non-negative least squares; where it is not proven, the better one of it and OSQP's.

    Raises
    ------
    NumericalError
        Both may be too far from the least cost.
    """
    first = solve_nnls(problem, moments)
    if first.optimality.proven:
        return first
    second = solve_osqp(problem, moments)
    excess = [answer.optimality.excess if np.isfinite(answer.cost) else np.inf for answer in (first, second)]
    if not min(excess) <= _TOLERABLE:
        raise NumericalError(
            f"the point masses did not converge: {first.solver} says {first.status!r} and may be {excess[0]:.1e} above "
            f"the least cost, {second.solver} says {second.status!r} and may be {excess[1]:.1e} above it, where "
            f"{_TOLERABLE:.0e} is the limit; check the chain for two joints in one place or units that are off"
        )
    return first if excess[0] <= excess[1] else second


def _solution(
    problem: Compressed,
    bodies: Bodies,
    consistency: tuple[Consistency, Consistency],
    found: tuple[FloatArray, FloatArray],
    answer: Answer,
) -> Solution:
    parameters = problem.completed(bodies.mapping @ answer.body)
    optimality = check(problem, bodies, answer.body, parameters[len(bodies.mapping) :])
    free = problem.cost(problem.free_solution())
    return Solution(
        asked=consistency[0],
        consistency=consistency[1],
        parameters=parameters,
        full=found[0],
        masses=found[1],
        answer=Answer(answer.solver, answer.body, answer.cost, optimality, answer.status, answer.iterations),
        price=max(answer.cost - free, 0.0) / problem.floor(free),
    )
