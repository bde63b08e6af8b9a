"""Least squares over non-negative point masses (eq. 4.26), with a proof of optimality.

The cost of point masses ρ (p,) ≥ 0 is ‖R [B ρ; c] - d‖², where B = M P maps masses to base parameters (eq. 4.25) and c
are free parameters. Non-negative least squares, an exact active-set method, minimises it. OSQP is used for problems in
which this fails, and for comparison in tests. For OSQP, the problem has the variables ρ and y = R B ρ, so that the
condition number is not squared. OSQP's tolerances are relative to the whole wrench, whereas the cost is the small
remaining residual. OSQP can report "solved" when the cost is several per cent too high (docs/measured/dynamics.md). It
is therefore run repeatedly for corrections on the scale of the residual, until the optimality conditions hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.optimality import SolverAnswer, check_optimality
from mocap_id.errors import NumericalError

_ACCURACIES = (
    1e-6,
    1e-7,
    1e-8,
    1e-9,
    1e-10,
    1e-11,
)  # OSQP's tolerance in each round, relative to the residual at its start
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
        """Return the total of the point masses ``body`` (p,), kg."""
        return float(np.abs(body).sum())

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return bodies (p, p) with 1 kg at one point each, whatever the prices are."""
        return np.eye(len(prices))


def solve_osqp(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit the point masses with OSQP, with the variables ρ and y = R B ρ.

    ``moments`` (b, p) is B = M P of eq. 4.25. The problem must have no free parameters.
    """
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
    return _build_answer("osqp", problem, moments, masses, status=status, iterations=iterations)


def solve_nnls(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit the point masses by non-negative least squares; the arguments are those of :func:`solve_osqp`."""
    points = moments.shape[1]
    status = "solved"
    try:
        masses = np.asarray(nnls(problem.factor @ moments, problem.target, maxiter=50 * points)[0], dtype=np.float64)
    except RuntimeError as error:
        masses, status = np.full(points, np.nan), str(error)
    return _build_answer("nnls", problem, moments, masses, status=status)


def run_osqp(
    mapped: FloatArray,
    target: FloatArray,
    least: FloatArray,
    *,
    accuracy: float,
    iterations: int = _ITERATIONS,
) -> tuple[FloatArray, str, int]:
    """Minimise ‖y - target‖² over ρ ≥ least and y = mapped · ρ with one run of OSQP, scaled to order one.

    Return ρ (p,), OSQP's status text and the number of iterations. ρ meets its bounds within OSQP's tolerance, and is
    zero if OSQP finds no solution.

    Parameters
    ----------
    mapped : (b, p) array
        Matrix R B from masses to the right-hand side.
    target : (b,) array
        Right-hand side.
    least : (p,) array
        Lower bounds of the masses, kg.
    accuracy : float
        OSQP's tolerances, relative to the target.
    iterations : int
        Largest number of iterations.
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

    The data determine only B ρ. A penalty within the fit would change B ρ. Here B ρ is constant, because its weight is
    1e5 times that of the target. Without a target, the masses are spread evenly.

    Parameters
    ----------
    moments : (b, p) array
        Matrix B.
    fitted : (p,) array
        Point masses of the fit, ρ ≥ 0.
    full_moments : (f, p) array
        Matrix P.
    target : (f,) array
        Target for the full parameters; NaN for none.
    scale : (f,) array
        Standard deviation of each full parameter of the target.

    Raises
    ------
    NumericalError
        The active-set method did not converge.
    """
    aimed, base = np.isfinite(target), moments @ fitted
    total = float(fitted.sum()) or 1.0
    size = np.maximum(np.abs(moments).max(axis=1), 1e-12)
    rows = np.vstack(
        [
            _EQUAL * moments / size[:, None],
            full_moments[aimed] / scale[aimed, None],
            _EVEN * np.eye(moments.shape[1]) / total,
        ]
    )
    aims = np.concatenate([_EQUAL * base / size, target[aimed] / scale[aimed], np.zeros(moments.shape[1])])
    try:
        return np.asarray(nnls(rows, aims, maxiter=50 * rows.shape[1])[0], dtype=np.float64)
    except RuntimeError as error:
        raise NumericalError(
            f"the {rows.shape[1]} point masses could not be distributed: {error}; check the chain for two joints at "
            "the same position, or for wrong units"
        ) from error


def _build_answer(
    solver: str,
    problem: CompressedProblem,
    moments: FloatArray,
    masses: FloatArray,
    *,
    status: str,
    iterations: int = 0,
) -> SolverAnswer:
    """Return the masses with their cost and the check of optimality."""
    optimality = check_optimality(problem, GridBodies(moments), masses)
    return SolverAnswer(solver, masses, problem.cost(moments @ masses), optimality, status, iterations)
