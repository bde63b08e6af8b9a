"""Least squares over point masses that are not negative (eq. 4.26), and its answer checked.

With B = M P the cost is ‖R [B ρ; c] - d‖², ρ ≥ 0: non-negative least squares, an active-set method that is exact. OSQP
is there for the problem that defeats it, and for tests to compare. OSQP gets the problem in split form, with ρ and
y = R B ρ as variables, so that nothing is squared. Its tolerances are relative to the whole wrench, while the cost is
what little of it is left: it says "solved" where the cost is several per cent off (docs/solvers.md). So it is asked for
corrections: after each answer for the step from there, in the residual's own scale, until the optimality conditions
hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.optimality import Answer, check
from mocap_id.dynamics.solve import Compressed
from mocap_id.errors import NumericalError

_ACCURACIES = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)  # of each round, relative to the residual that it starts from
_ITERATIONS = 20_000  # of one round
_ENOUGH = 1e-9  # of the cost: with less to gain there is no further round
_EQUAL, _EVEN = 1e5, 1e-3


@dataclass(frozen=True)
class GridBodies:
    """Masses at given points: the numbers of :class:`~mocap_id.dynamics.optimality.Bodies` are the masses.

    Parameters
    ----------
    mapping : (b, p) array
        B.
    """

    mapping: FloatArray

    def outside(self, body: FloatArray) -> float:
        """The most negative mass, of the largest."""
        return abs(float(body.min(initial=0.0))) / max(float(np.abs(body).max(initial=0.0)), 1e-300)

    def mass(self, body: FloatArray) -> float:
        """Total mass, kg."""
        return float(np.abs(body).sum())

    def cheapest(self, prices: FloatArray) -> FloatArray:
        """Every point."""
        return np.eye(len(prices))


def solve_osqp(problem: Compressed, moments: FloatArray) -> Answer:
    """Point masses by OSQP in split form.

    Parameters
    ----------
    problem : Compressed
        b columns; parameters that are free are taken out before (:meth:`Compressed.over`).
    moments : (b, p) array
        B = M P of eq. 4.25.
    """
    mapped = problem.factor @ moments
    masses, status, iterations = np.zeros(moments.shape[1]), "not run", 0
    for accuracy in _ACCURACIES:
        target = problem.target - mapped @ masses
        step, status, used = osqp_split(mapped, target, -masses, accuracy=accuracy)
        iterations += used
        moved = np.maximum(masses + step, 0.0)
        if problem.cost(moments @ moved) < problem.cost(moments @ masses):
            masses = moved
        if check(problem, GridBodies(moments), masses).excess <= _ENOUGH:
            break
    return _answer("osqp", problem, moments, masses, status=status, iterations=iterations)


def solve_nnls(problem: Compressed, moments: FloatArray) -> Answer:
    """Point masses by non-negative least squares, an active-set method; arguments as for :func:`solve_osqp`."""
    points = moments.shape[1]
    status = "solved"
    try:
        masses = np.asarray(nnls(problem.factor @ moments, problem.target, maxiter=50 * points)[0], dtype=np.float64)
    except RuntimeError as error:
        masses, status = np.full(points, np.nan), str(error)
    return _answer("nnls", problem, moments, masses, status=status)


def osqp_split(
    mapped: FloatArray,
    target: FloatArray,
    least: FloatArray,
    *,
    accuracy: float,
    iterations: int = _ITERATIONS,
) -> tuple[FloatArray, str, int]:
    """One round of OSQP: min ‖y - target‖² over ρ ≥ least and y = mapped · ρ, both in units of order one.

    Parameters
    ----------
    mapped : (b, p) array
        R B.
    target : (b,) array
    least : (p,) array
        kg.
    accuracy : float
        OSQP's tolerances, relative to the target.
    iterations : int
        At most.

    Returns
    -------
    (p,) array
        ρ, within OSQP's tolerance of its bounds; zero where OSQP has no answer.
    str
        OSQP's own word.
    int
        Iterations.
    """
    import osqp  # noqa: PLC0415  hardly a run needs it

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
    """Of all point masses with the same base parameters, those closest to a target in the full parameters.

    The data fix B ρ alone. This decides the rest without touching what the data say, which a penalty inside the fit
    would: the equality is held by a weight 1e5 times that of the aim. Where there is no aim the masses are spread
    evenly.

    Parameters
    ----------
    moments : (b, p) array
        B.
    fitted : (p,) array
        Point masses that fit, ρ ≥ 0.
    full_moments : (f, p) array
        P.
    target : (f,) array
        Full parameters aimed at; NaN where there is no aim.
    scale : (f,) array
        Deviation that counts as one, of each full parameter.

    Returns
    -------
    (p,) array
        ρ ≥ 0.

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
            f"the {rows.shape[1]} point masses could not be spread: {error}; check the chain for two joints in one "
            "place or units that are off"
        ) from error


def _answer(
    solver: str, problem: Compressed, moments: FloatArray, masses: FloatArray, *, status: str, iterations: int = 0
) -> Answer:
    optimality = check(problem, GridBodies(moments), masses)
    return Answer(solver, masses, problem.cost(moments @ masses), optimality, status, iterations)
