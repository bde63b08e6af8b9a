"""Least squares over point masses that are not negative (eq. 4.26), solved twice and checked.

The data enter only through the triangular factor R of their QR decomposition. With B = M P the cost is ‖R B ρ - d‖²,
ρ ≥ 0. OSQP gets it in split form, with ρ and y = R B ρ as variables: on the product (R B)ᵀ R B it stops several per
cent off and says "solved". Whatever it says, the optimality conditions are checked here, and non-negative least
squares on the same problem is the second opinion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import osqp
from scipy import sparse
from scipy.optimize import nnls

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base import triangular_factor
from mocap_id.errors import NumericalError

_ACCURACY = 1e-10  # at 1e-8 the cost is left 1e-4 too high where no mass is zero and polishing has nothing to hold
_ITERATIONS = 40_000
_EQUAL, _EVEN = 1e5, 1e-3
_AGREEMENT = 1e-5  # of the least cost: how far above a proven one OSQP's may be
_OPTIMAL = 1e-3  # of the least cost: how far above it a solution may be at most


@dataclass(frozen=True)
class Compressed:
    """A least-squares problem after QR: cost = ‖R x - d‖² + constant.

    Parameters
    ----------
    factor : (b, b) array
        R.
    target : (b,) array
        d = Qᵀ (right-hand side).
    rest : float
        The part of the squared residual that no parameters can remove.
    """

    factor: FloatArray
    target: FloatArray
    rest: float

    @classmethod
    def of(cls, rows: FloatArray, target: FloatArray) -> Compressed:
        """Compress rows (r, b) and their right-hand side (r,); r ≥ b + 1."""
        factor = triangular_factor(np.column_stack([rows, target]))
        columns = rows.shape[1]
        return cls(factor[:columns, :columns], factor[:columns, -1], float(factor[columns, -1] ** 2))

    def free_solution(self) -> FloatArray:
        """Parameters (b,) without any constraint."""
        return np.asarray(np.linalg.lstsq(self.factor, self.target, rcond=None)[0], dtype=np.float64)

    def cost(self, parameters: FloatArray) -> float:
        """Squared residual at these parameters."""
        return float(np.sum((self.factor @ parameters - self.target) ** 2)) + self.rest


@dataclass(frozen=True)
class MassSolution:
    """Point masses and what they say.

    Parameters
    ----------
    masses : (p,) array
        ρ, kg.
    parameters : (b + k,) array
        Base parameters B ρ, then the k nuisance parameters.
    solver : {"osqp", "nnls"}
        Which of the two answered; ``nnls`` means that OSQP's cost is above what is proven to be the least.
    status : str
        OSQP's own word.
    kkt : float
        Upper bound on how far the better cost is above the least one, relative to it, from the optimality conditions.
    disagreement : float
        Relative difference of OSQP's cost from the other's.
    price : float
        Relative increase of the cost over that of parameters without any constraint.
    iterations : int
        Of OSQP.
    """

    masses: FloatArray
    parameters: FloatArray
    solver: Literal["osqp", "nnls"]
    status: str
    kkt: float
    disagreement: float
    price: float
    iterations: int


def fit_masses(problem: Compressed, moments: FloatArray) -> MassSolution:
    """Minimise ‖R [B ρ; c] - d‖² over ρ ≥ 0 and free nuisance parameters c.

    Parameters
    ----------
    problem : Compressed
        b + k columns: base parameters, then nuisance parameters.
    moments : (b, p) array
        B = M P of eq. 4.25.

    Returns
    -------
    MassSolution

    Raises
    ------
    NumericalError
        Neither solver's answer satisfies the optimality conditions.
    """
    small = _without_nuisance(problem, len(moments))
    masses, status, iterations = _osqp_split(small, moments)
    second = _non_negative(small.factor @ moments, small.target)
    gaps = kkt_gap(small, moments, masses), kkt_gap(small, moments, second)
    if not min(gaps) <= _OPTIMAL:
        raise NumericalError(
            f"the point masses did not converge: OSQP says {status!r} and may be {gaps[0]:.1e} above the least cost, "
            f"non-negative least squares {gaps[1]:.1e}, where {_OPTIMAL:.0e} is expected; check the chain for two "
            "joints in one place or units that are off"
        )
    least = small.cost(moments @ second)
    disagreement = (small.cost(moments @ masses) - least) / _floor(small, least)
    solver: Literal["osqp", "nnls"] = "osqp"
    if gaps[1] <= _OPTIMAL and disagreement > _AGREEMENT:
        solver, masses = "nnls", second
    free = small.cost(small.free_solution())
    return MassSolution(
        masses=masses,
        parameters=_with_nuisance(problem, moments @ masses),
        solver=solver,
        status=status,
        kkt=min(gaps),
        disagreement=disagreement,
        price=max(small.cost(moments @ masses) - free, 0.0) / _floor(small, free),
        iterations=iterations,
    )


def kkt_gap(problem: Compressed, moments: FloatArray, masses: FloatArray) -> float:
    """How far the cost may be above the least one over ρ ≥ 0, relative to it.

    At the solution the gradient is zero where a mass is positive and not negative elsewhere. By convexity the excess
    of the cost is at most gradientᵀ(ρ - ρ*): what the masses still pay in all, and what the steepest descent
    could bring to as much mass as there is.

    Parameters
    ----------
    problem : Compressed
        Without nuisance columns.
    moments : (b, p) array
        B.
    masses : (p,) array
        ρ ≥ 0.
    """
    mapped = problem.factor @ moments
    rest = mapped @ masses - problem.target
    gradient = 2 * mapped.T @ rest
    excess = abs(float(gradient @ masses)) + max(-float(gradient.min(initial=0.0)), 0.0) * float(masses.sum())
    return excess / _floor(problem, problem.cost(moments @ masses))


def _floor(problem: Compressed, cost: float) -> float:
    """A cost to compare with, kept off zero where the data fit to rounding."""
    return max(cost, 1e-12 * float(problem.target @ problem.target), 1e-300)


def spread_masses(
    moments: FloatArray, base: FloatArray, full_moments: FloatArray, target: FloatArray, scale: FloatArray
) -> FloatArray:
    """Of all point masses with these base parameters, those closest to a target in the full parameters.

    The data fix B ρ alone. This decides the rest without touching what the data say, which a penalty inside the fit
    would: the equality is held by a weight 1e5 times that of the aim. Where there is no aim the masses are spread
    evenly.

    Parameters
    ----------
    moments : (b, p) array
        B.
    base : (b,) array
        Attainable base parameters, B ρ of some ρ ≥ 0.
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
    """
    aimed = np.isfinite(target)
    total = max(float(base[0]), 1e-9)
    size = np.maximum(np.abs(moments).max(axis=1), 1e-12)
    rows = np.vstack(
        [
            _EQUAL * moments / size[:, None],
            full_moments[aimed] / scale[aimed, None],
            _EVEN * np.eye(moments.shape[1]) / total,
        ]
    )
    aims = np.concatenate([_EQUAL * base / size, target[aimed] / scale[aimed], np.zeros(moments.shape[1])])
    return _non_negative(rows, aims)


def _without_nuisance(problem: Compressed, base: int) -> Compressed:
    """Project the nuisance columns out of the problem."""
    nuisance = problem.factor[:, base:]
    if nuisance.shape[1] == 0:
        return problem
    basis, _ = np.linalg.qr(nuisance)
    rows = problem.factor[:, :base] - basis @ (basis.T @ problem.factor[:, :base])
    target = problem.target - basis @ (basis.T @ problem.target)
    padded = Compressed.of(np.vstack([rows, np.zeros((1, base))]), np.append(target, 0.0))
    return Compressed(padded.factor, padded.target, padded.rest + problem.rest)


def _with_nuisance(problem: Compressed, base: FloatArray) -> FloatArray:
    """Append the nuisance parameters that fit best beside these base parameters."""
    rows = problem.factor[:, len(base) :]
    rest = problem.target - problem.factor[:, : len(base)] @ base
    return np.concatenate([base, np.linalg.lstsq(rows, rest, rcond=None)[0]])


def _osqp_split(problem: Compressed, moments: FloatArray) -> tuple[FloatArray, str, int]:
    """OSQP over ρ and y = R B ρ, both in units of order one; masses clipped at zero, its status, iterations."""
    base, points = moments.shape
    map_ = problem.factor @ moments
    length = max(float(np.linalg.norm(problem.target)), 1e-300)
    size = max(float(np.linalg.norm(map_, axis=0).max()), 1e-300)
    link = sparse.hstack([sparse.csc_matrix(-map_ / size), sparse.identity(base)])
    bounds = sparse.hstack([sparse.identity(points), sparse.csc_matrix((points, base))])
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.block_diag([sparse.csc_matrix((points, points)), sparse.identity(base)], format="csc"),
        q=np.concatenate([np.zeros(points), -problem.target / length]),
        A=sparse.vstack([link, bounds], format="csc"),
        l=np.zeros(base + points),
        u=np.concatenate([np.zeros(base), np.full(points, np.inf)]),
        eps_abs=_ACCURACY,
        eps_rel=_ACCURACY,
        max_iter=_ITERATIONS,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    masses = np.asarray(result.x[:points], dtype=np.float64) * length / size
    return np.where(masses > 0.0, masses, 0.0), str(result.info.status), int(result.info.iter)


def _non_negative(rows: FloatArray, target: FloatArray) -> FloatArray:
    """Non-negative least squares by an active set."""
    try:
        return np.asarray(nnls(rows, target, maxiter=50 * rows.shape[1])[0], dtype=np.float64)
    except RuntimeError as error:
        raise NumericalError(
            f"non-negative least squares did not converge on {rows.shape[1]} point masses: {error}"
        ) from error
