"""Physically consistent parameters: fits over possible bodies, which are point masses on a grid or the exact cone.

Non-negative least squares solves the fit on the grid (eq. 4.12, 4.25), and Clarabel that in the cone. Every solution is
checked for optimality (:mod:`mocap_id.dynamics.cone_solver`), which needs no second solver. OSQP is run only if the
solution on the grid does not pass the check.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.base_parameters import CompressedProblem
from mocap_id.dynamics.cone_solver import (
    BodyCone,
    ConeBodies,
    Solution,
    SolverAnswer,
    check_optimality,
    find_closest_links,
    solve_links,
)
from mocap_id.dynamics.priors import compute_reference_sd
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.errors import NumericalError

_FLESH, _LEAST_FLESH = 0.1, 0.04  # margin: fraction of the box's longer side; least value, m


@dataclass(frozen=True)
class PointGrid:
    """Grid points of all segments."""

    segment: IntArray  # (p,) segment of each point, base first
    position: FloatArray  # (p, 2) position of each point in the frame of its segment, m
    segments: int  # number of segments, base included

    def moments(self) -> FloatArray:
        """Return the matrix P (4(n + 1), p) of eq. 4.12: full parameters = P · masses."""
        x, y = self.position.T
        values = np.stack([np.ones_like(x), x, y, x * x + y * y])  # (4, p)
        matrix = np.zeros((self.segments, len(PLANAR_PARAMETERS), len(x)))
        for segment in range(self.segments):
            own = self.segment == segment
            matrix[segment][:, own] = values[:, own]
        return matrix.reshape(-1, len(x))

    def boxes(self) -> FloatArray:
        """Return the lowest and the highest corner of each segment's points, (n + 1, 2, 2), m."""
        own = [self.position[self.segment == segment] for segment in range(self.segments)]
        return np.stack([[points.min(axis=0), points.max(axis=0)] for points in own])


def build_grid(
    centres: FloatArray, marker_segment: IntArray, marker_local: FloatArray, points: tuple[int, int] = (5, 9)
) -> PointGrid:
    """Return the grid over the box of each segment's joints and markers (M, 2), m, with a margin for flesh."""
    segments = len(centres) + 1
    boxes = []
    for segment in range(segments):
        markers = marker_local[marker_segment == segment].reshape(-1, 2)
        known = np.concatenate([np.zeros((1, 2)), markers, centres[segment : segment + 1]])
        low, high = known.min(axis=0), known.max(axis=0)
        flesh = max(_LEAST_FLESH, _FLESH * float(np.max(high - low)))
        low, high = low - flesh, high + flesh
        # `points` are the numbers of points along the short and the long side
        counts = points if high[1] - low[1] >= high[0] - low[0] else points[::-1]
        x, y = (np.linspace(low[i], high[i], counts[i]) for i in (0, 1))
        boxes.append(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    return PointGrid(np.repeat(np.arange(segments), [len(box) for box in boxes]), np.concatenate(boxes), segments)


_ACCURACIES = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)  # OSQP's tolerance in each round, relative to the residual
_ITERATIONS = 20_000  # largest number of iterations in a round
_ENOUGH = 1e-9  # possible relative decrease of the cost below which the rounds end
_EQUAL, _EVEN = 1e5, 1e-3  # weights of the base parameters and of evenly spread masses, relative to the target


@dataclass(frozen=True)
class GridBodies:
    """Bodies of point masses at given points; the numbers that describe a body are its p masses, kg."""

    mapping: FloatArray  # (b, p) matrix B from masses to base parameters

    def measure_violation(self, body: FloatArray) -> float:
        """Return the magnitude of the most negative mass, relative to the largest."""
        return abs(float(body.min(initial=0.0))) / max(float(np.abs(body).max(initial=0.0)), 1e-300)

    def mass(self, body: FloatArray) -> float:
        return float(np.abs(body).sum())

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return bodies (p, p) with 1 kg at one point each, whatever the prices are."""
        return np.eye(len(prices))


def solve_osqp(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit point masses with OSQP, given B = M P (b, p) of eq. 4.25; the problem must have no free parameters."""
    mapped = problem.factor @ moments
    masses, status, iterations = np.zeros(moments.shape[1]), "not run", 0
    for accuracy in _ACCURACIES:
        target = problem.target - mapped @ masses
        step, status, used = run_osqp(mapped, target, -masses, accuracy=accuracy)
        iterations += used
        moved = np.maximum(masses + step, 0.0)
        if problem.cost(moments @ moved) < problem.cost(moments @ masses):
            masses = moved
        if check_optimality(problem, GridBodies(moments), masses).excess <= _ENOUGH:
            break
    optimality = check_optimality(problem, GridBodies(moments), masses)
    return SolverAnswer("osqp", masses, problem.cost(moments @ masses), optimality, status, iterations)


def solve_nnls(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit the point masses by non-negative least squares; the arguments are those of :func:`solve_osqp`."""
    points = moments.shape[1]
    status = "solved"
    try:
        masses = np.asarray(nnls(problem.factor @ moments, problem.target, maxiter=50 * points)[0], dtype=np.float64)
    except RuntimeError as error:
        masses, status = np.full(points, np.nan), str(error)
    optimality = check_optimality(problem, GridBodies(moments), masses)
    return SolverAnswer("nnls", masses, problem.cost(moments @ masses), optimality, status)


def run_osqp(
    mapped: FloatArray,
    target: FloatArray,
    least: FloatArray,
    *,
    accuracy: float,
    iterations: int = _ITERATIONS,
) -> tuple[FloatArray, str, int]:
    """Minimise ‖y - target‖² over ρ ≥ least and y = mapped · ρ with one run of OSQP, scaled to order one.

    ``mapped`` (b, p) is R B from masses to the right-hand side ``target`` (b,), and ``least`` (p,) are the lower bounds
    of the masses, kg. OSQP's tolerances are ``accuracy``, relative to the target. Return ρ (p,), OSQP's status text and
    the number of iterations. ρ meets its bounds within OSQP's tolerance, and is zero if OSQP finds no solution.
    """
    import osqp  # noqa: PLC0415  rarely needed

    base, points = mapped.shape
    length = max(float(np.linalg.norm(target)), 1e-300)
    size = max(float(np.linalg.norm(mapped, axis=0).max(initial=0.0)), 1e-300)
    link = sparse.hstack([sparse.csc_matrix(-mapped / size), sparse.identity(base)])
    bounds = sparse.hstack([sparse.identity(points), sparse.csc_matrix((points, base))])
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.block_diag([sparse.csc_matrix((points, points)), sparse.identity(base)], format="csc"),
        q=np.concatenate([np.zeros(points), -target / length]),
        A=sparse.vstack([link, bounds], format="csc"),
        l=np.concatenate([np.zeros(base), np.maximum(least * (size / length), -1e20)]),
        u=np.concatenate([np.zeros(base), np.full(points, np.inf)]),
        eps_abs=accuracy,
        eps_rel=accuracy,
        max_iter=iterations,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    masses = np.asarray(result.x[:points], dtype=np.float64) * (length / size)
    return np.where(np.isfinite(masses), masses, 0.0), str(result.info.status), int(result.info.iter)


def spread_masses(
    moments: FloatArray, fitted: FloatArray, full_moments: FloatArray, target: FloatArray, scale: FloatArray
) -> FloatArray:
    """Return the point masses (p,) with given base parameters whose full parameters are closest to a target.

    The data determine only B ρ, with B = ``moments`` (b, p) and the fitted ρ ≥ 0 (p,). A penalty within the fit would
    change B ρ. Here B ρ is constant, because its weight is 1e5 times that of the ``target`` (f,) of the full parameters
    P ρ, with P = ``full_moments`` (f, p) and the standard deviations ``scale`` (f,). Without a target (NaN), the masses
    are spread evenly. NumericalError is raised if the active-set method does not converge.
    """
    aimed, base = np.isfinite(target), moments @ fitted
    total = float(fitted.sum()) or 1.0
    size = np.maximum(np.abs(moments).max(axis=1), 1e-12)
    even = _EVEN * np.eye(moments.shape[1]) / total
    rows = np.vstack([_EQUAL * moments / size[:, None], full_moments[aimed] / scale[aimed, None], even])
    aims = np.concatenate([_EQUAL * base / size, target[aimed] / scale[aimed], np.zeros(moments.shape[1])])
    try:
        return np.asarray(nnls(rows, aims, maxiter=50 * rows.shape[1])[0], dtype=np.float64)
    except RuntimeError as error:
        raise NumericalError(
            f"the {rows.shape[1]} point masses could not be distributed: {error}; check the chain for two joints at "
            "the same position, or for wrong units"
        ) from error


Consistency = Literal["grid", "cone", "bounded-cone"]
"""Set of possible bodies: masses on the grid, masses anywhere, or masses anywhere within the outlines of the grid."""
_TOLERABLE = 1e-3  # largest relative distance to the least cost with which a solution is accepted


@dataclass(frozen=True)
class ConsistentSolution(Solution):
    """Consistent parameters in the plane.

    ``full`` are those of the body closest to the reference, or of a body of evenly spread point masses. An Izz that
    possible bodies only approach is NaN. ``answer`` is checked on the whole problem.
    """

    # requested, consistency: the requested set of bodies, and the set used: `grid` if the solution in the cone was
    # not proven to be optimal
    requested: Consistency
    consistency: Consistency
    # (p,) point masses with the full parameters, kg; NaN for the cone, whose bodies need not be on the grid
    masses: FloatArray


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

    The problem has b + k columns, and M is ``regrouping`` (b, 4(n + 1)) of eq. 4.24. ``reference`` (4(n + 1),) are full
    parameters to approach, as far as the problem does not determine them, NaN for none; ``relative_sd`` is their
    standard deviation, relative to each parameter's size. NumericalError is raised if no solver's solution is close
    enough to the least cost.
    """
    small, full_moments = problem.eliminate_others(len(regrouping)), grid.moments()
    moments = regrouping @ full_moments
    bodies: BodyCone = _choose_bodies(regrouping, grid, consistency)
    used: Consistency = "grid"

    def spread(answer: SolverAnswer) -> FloatArray:
        scale = compute_reference_sd(reference, relative_sd)
        return spread_masses(moments, answer.body, full_moments, reference, scale)

    # the best body in the cone, if its optimality is proven
    answer, masses = None, np.full(full_moments.shape[1], np.nan)
    if isinstance(bodies, ConeBodies):
        links = solve_links(small, bodies)
        if links.optimality.proven:
            answer, used, aim = links, consistency, reference
            if not np.isfinite(aim).all():
                aim = np.where(np.isfinite(aim), aim, full_moments @ spread(_fit_point_masses(small, moments)))
            full = find_closest_links(bodies, links.body, aim, compute_reference_sd(aim, relative_sd))
    # otherwise, the best point masses on the grid
    if answer is None:
        bodies, answer = GridBodies(moments), _fit_point_masses(small, moments)
        masses = spread(answer)
        full = full_moments @ masses
    # the solution is checked on the whole problem
    parameters = problem.complete(bodies.mapping @ answer.body)
    optimality = check_optimality(problem, bodies, answer.body, parameters[len(bodies.mapping) :])
    free = problem.cost(problem.free_solution())
    return ConsistentSolution(
        requested=consistency,
        consistency=used,
        parameters=parameters,
        full=full,
        masses=masses,
        answer=replace(answer, optimality=optimality),
        price=max(answer.cost - free, 0.0) / problem.floor(free),
    )


def fit_quickly(
    problem: CompressedProblem, regrouping: FloatArray, grid: PointGrid, consistency: Consistency
) -> FloatArray:
    """Return only the parameters (b + k,) of :func:`fit_consistent`, faster if the solution is proven to be optimal."""
    small, bodies = problem.eliminate_others(len(regrouping)), _choose_bodies(regrouping, grid, consistency)
    answer = solve_nnls(small, bodies.mapping) if isinstance(bodies, GridBodies) else solve_links(small, bodies)
    if answer.optimality.proven:
        return problem.complete(bodies.mapping @ answer.body)
    nowhere = np.full(regrouping.shape[1], np.nan)
    return fit_consistent(problem, regrouping, grid, nowhere, consistency=consistency).parameters


def _choose_bodies(regrouping: FloatArray, grid: PointGrid, consistency: Consistency) -> GridBodies | ConeBodies:
    if consistency == "grid":
        return GridBodies(regrouping @ grid.moments())
    return ConeBodies(regrouping, grid.boxes() if consistency == "bounded-cone" else None)


def _fit_point_masses(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Return the proven solution of non-negative least squares, or else the better of this and OSQP's."""
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
