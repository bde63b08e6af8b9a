"""Base parameters: the combinations of inertial parameters that a wrench determines (thesis 4.1.1.2).

The columns of the regressor are taken in their natural order: base to tip, and m, mx, my, Izz within a segment. Columns
of zeros are dropped. A column that depends linearly on the columns kept before it is regrouped into these columns. A
different order would give a different set; this order gives eq. 6.1.

The linear least squares for them need only the triangular factor R of the QR decomposition of the data, because the
cost of parameters x is ‖R x - d‖² plus a constant. Thousands of rows become a dozen, and the condition number is not
squared. The uncertainty holds for residuals that are correlated in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, planar_regressor

_UNITS = ("kg", "kg*m", "kg*m", "kg*m^2")
_OUTSIDE = 1e-6  # fraction of the largest entry: larger distances from the span are not due to rounding
_ENOUGH = 1000  # number of rows that are tested; in nearly every posture, the answer is the same


@dataclass(frozen=True)
class BaseSet:
    """The identifiable combinations of the full parameters."""

    kept: IntArray  # (b,) linearly independent columns of the full regressor
    # (b, p) matrix M of eq. 4.24: base parameters = M · full parameters, and Y[:, kept] · M = Y.
    regrouping: FloatArray

    def columns(self, regressor: FloatArray) -> FloatArray:
        """Return the kept columns (..., b) of a regressor (..., p), without a copy if all are kept."""
        return regressor if len(self.kept) == regressor.shape[-1] else regressor[..., self.kept]

    def expand(self, base: FloatArray) -> FloatArray:
        """Return the full parameters (p,) with these base parameters (b,) that are zero in all columns not kept."""
        full = np.zeros(self.regrouping.shape[1])
        full[self.kept] = base
        return full


def triangularise(rows: FloatArray) -> FloatArray:
    """Return R (min(r, p), p) of the QR decomposition of rows (r, p), which is all that least squares needs."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def regroup_columns(regressor: FloatArray) -> BaseSet:
    """Find the independent columns of a stacked regressor (r, p) and regroup the other columns (eq. 4.8, 4.9, 4.24).

    An unpivoted QR compresses the rows. The columns of its R are then orthogonalised in turn, and dependent columns are
    left out. The diagonal of R alone is not sufficient, because a dependent column leaves an arbitrary direction in Q,
    which can make a later column look dependent.
    """
    factor = triangularise(regressor)
    directions: list[FloatArray] = []
    remainders = np.zeros(factor.shape[1])
    kept: list[int] = []
    # norm below which the independent part of a column counts as zero (eq. 4.8)
    largest_diagonal = float(np.max(np.abs(np.diagonal(factor)), initial=0.0))
    zero = len(regressor) * float(np.finfo(np.float64).eps) * largest_diagonal
    for column in np.flatnonzero(np.any(factor != 0.0, axis=0)):
        rest = factor[:, column]
        for _ in range(2):  # two passes give orthogonality up to rounding errors
            rest = rest - sum((np.dot(d, rest) * d for d in directions), start=np.zeros_like(rest))
        remainders[column] = float(np.linalg.norm(rest))
        if remainders[column] >= zero:
            directions.append(rest / remainders[column])
            kept.append(int(column))
    index = np.array(kept, dtype=np.int64)
    regrouping = np.asarray(np.linalg.lstsq(factor[:, index], factor, rcond=None)[0], dtype=np.float64)
    regrouping[:, index] = np.eye(len(index))
    largest = np.max(np.abs(regrouping), axis=0)
    regrouping[np.abs(regrouping) <= 1e-9 * np.maximum(largest, 1.0)] = 0.0
    return BaseSet(index, regrouping)


def determines_rows(rows: FloatArray, base: BaseSet) -> bool:
    """Return whether base parameters determine what rows (r, p) of a full regressor predict; NaN is missing."""
    known = rows[np.isfinite(rows).all(axis=1)]
    known = known[:: max(1, len(known) // _ENOUGH)]
    # a row outside the span of the rows that gave the base set depends on other parameters too
    off = known[:, base.kept] @ base.regrouping - known
    return float(np.max(np.abs(off), initial=0.0)) <= _OUTSIDE * float(np.max(np.abs(known), initial=0.0))


def structural_base(centres: FloatArray, components: tuple[int, ...] = (0, 1, 2)) -> BaseSet:
    """Return the base set of a planar chain in which every joint moves; no trial can determine more parameters."""
    states = np.random.default_rng(0).normal(size=(3, 50, len(centres)))
    regressor = planar_regressor(centres, *states)[:, list(components), :]
    return regroup_columns(regressor.reshape(-1, regressor.shape[-1]))


def name_parameters(segments: int) -> tuple[str, ...]:
    """Return the names of the full parameters, numbered from 1 for the base as in the thesis: m1, mx1, my1, I1, m2 …"""
    return tuple(f"{symbol}{k}" for k in range(1, segments + 1) for symbol in ("m", "mx", "my", "I"))


def list_base_units(base: BaseSet) -> tuple[str, ...]:
    """Return the SI unit of each base parameter."""
    return tuple(_UNITS[column % len(PLANAR_PARAMETERS)] for column in base.kept)


def base_names(base: BaseSet, centres: FloatArray) -> tuple[str, ...]:
    """Return the names of the base parameters as symbols, as in eq. 6.1.

    Let a mass m_j be regrouped into a parameter of segment k, and let p_{k+1} be the joint at the end of segment k. The
    coefficient is written as 1, p_{k+1,x}, p_{k+1,y} or |p_{k+1}|² if it has this value, otherwise as a number.
    """
    symbols, names = name_parameters(len(centres) + 1), []
    for row, column in zip(base.regrouping, base.kept.tolist(), strict=True):
        segment, kind = divmod(column, len(PLANAR_PARAMETERS))
        terms: dict[str, list[str]] = {}  # regrouped parameters by their common coefficient
        for other in np.setdiff1d(np.arange(len(row)), base.kept).tolist():
            beyond, other_kind = divmod(other, len(PLANAR_PARAMETERS))
            structural = other_kind == 0 and beyond > segment and segment < len(centres)
            value, symbol = 0.0, ""
            if structural:  # value and symbol of the factor of the mass in this kind of parameter
                (x, y), joint = centres[segment].tolist(), segment + 2
                value = (1.0, x, y, x * x + y * y)[kind]
                symbol = ("", f"p{joint}x*", f"p{joint}y*", f"(p{joint}x^2+p{joint}y^2)*")[kind]
            if structural and np.isclose(row[other], value, rtol=1e-6, atol=1e-9):
                terms.setdefault(symbol, []).append(symbols[other])
            elif row[other] != 0.0:
                terms.setdefault(f"{row[other]:.4g}*", []).append(symbols[other])
        name = symbols[column]
        for symbol, masses in terms.items():
            total = "+".join(masses)
            name += f"+{symbol}({total})" if symbol and len(masses) > 1 else f"+{symbol}{total}"
        names.append(name)
    return tuple(names)


@dataclass(frozen=True)
class CompressedProblem:
    """A least-squares problem after a QR decomposition, with the cost ‖R x - d‖² + rest of parameters x."""

    factor: FloatArray  # (b, b) triangular factor R
    target: FloatArray  # (b,) right-hand side d, which is Qᵀ times the original right-hand side
    rest: float  # part of the squared residual that no parameters can remove

    @classmethod
    def of(cls, rows: FloatArray, target: FloatArray, rest: float = 0.0) -> CompressedProblem:
        """Compress any number of rows (r, b) and their right-hand side (r,); ``rest`` is added to the cost."""
        columns = rows.shape[1]
        filled = np.zeros((max(len(rows), columns + 1), columns + 1))
        filled[: len(rows), :columns], filled[: len(rows), -1] = rows, target
        factor = triangularise(filled)
        return cls(factor[:columns, :columns], factor[:columns, -1], float(factor[columns, -1] ** 2) + rest)

    def free_solution(self) -> FloatArray:
        """Return the unconstrained solution (b,); if there are several, the shortest."""
        return np.asarray(np.linalg.lstsq(self.factor, self.target, rcond=None)[0], dtype=np.float64)

    def cost(self, parameters: FloatArray) -> float:
        return float(np.sum((self.factor @ parameters - self.target) ** 2)) + self.rest

    def floor(self, cost: float) -> float:
        """Return the cost, but at least the size of rounding errors, so that it can be a divisor."""
        return max(cost, 1e-9 * float(self.target @ self.target), 1e-300)

    def eliminate_others(self, kept: int) -> CompressedProblem:
        """Return the problem in the first ``kept`` parameters, with the others eliminated at their optimal values."""
        others = self.factor[:, kept:]
        if others.shape[1] == 0:
            return self
        basis, size, _ = np.linalg.svd(others, full_matrices=False)
        basis = basis[:, size > len(others) * np.finfo(np.float64).eps * max(float(size.max()), 1e-300)]
        rows = self.factor[:, :kept] - basis @ (basis.T @ self.factor[:, :kept])
        return CompressedProblem.of(rows, self.target - basis @ (basis.T @ self.target), self.rest)

    def complete(self, parameters: FloatArray) -> FloatArray:
        """Return all parameters (b,): the given first ones, then the optimal values of the remaining ones."""
        rest = self.target - self.factor[:, : len(parameters)] @ parameters
        others = np.linalg.lstsq(self.factor[:, len(parameters) :], rest, rcond=None)[0]
        return np.concatenate([parameters, others])


def number_blocks(time: FloatArray, length: float) -> IntArray:
    """Return the number (R,), from 0, of the block, ``length`` s long, of each time (R,), s; empty blocks get none."""
    _, block = np.unique(np.floor((time - time[0]) / length), return_inverse=True)
    return block.astype(np.int64)


def estimate_covariance(
    design: FloatArray,
    residual: FloatArray,
    block: IntArray,
    prior: FloatArray | None = None,
    spread: FloatArray | float = 1.0,
) -> FloatArray:
    """Return the covariance (b, b) of least-squares parameters from residuals that are correlated within blocks.

    ``design`` (R, c, b) and ``residual`` (R, c) are weighted; ``block`` (R,) is the block of each sample, 0 … G - 1.

    The covariance is the sandwich (XᵀX)⁻¹ (Σ_g X_gᵀ r_g r_gᵀ X_g) (XᵀX)⁻¹ over blocks g, to which a block bootstrap
    converges. Residuals may be correlated and heteroscedastic within a block. Blocks count as independent, so they must
    be longer than the correlation time of the residuals. The factor G/(G - 1) · (r - 1)/(r - b) corrects for few
    blocks, where r = R c.

    If a prior with the rows P (p, b), in standard deviations, is part of the fit, the covariance is (XᵀX + PᵀP)⁻¹ (Σ_g
    X_gᵀ r_g r_gᵀ X_g + PᵀS²P) (XᵀX + PᵀP)⁻¹. The diagonal ``spread`` of S contains the standard deviations of the
    prior's errors, divided by those in P; below 1 for a prior that is wider than its errors.
    """
    columns = design.shape[-1]
    rows = design.reshape(-1, columns)
    factor = triangularise(rows if prior is None else np.concatenate([rows, prior]))
    scores = np.einsum("rcb,rc->rb", design, residual)
    count = int(block.max()) + 1
    sums = np.zeros((count, columns))
    np.add.at(sums, block, scores)
    half = solve_triangular(factor, solve_triangular(factor, sums.T, trans="T"))  # (XᵀX)⁻¹ per block, (b, G)
    correction = count / max(count - 1, 1) * (residual.size - 1) / max(residual.size - columns, 1)
    covariance: FloatArray = correction * (half @ half.T)
    if prior is None:
        return covariance
    rest = solve_triangular(factor, solve_triangular(factor, prior.T * spread, trans="T"))
    return np.asarray(covariance + rest @ rest.T)


def unit_covariance(rows: FloatArray) -> FloatArray:
    """Return (XᵀX)⁻¹ (p, p) of rows X (r, p). The columns are scaled internally, so that the result is accurate."""
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    _, size, right = np.linalg.svd(triangularise(rows / length))
    half = right / (np.maximum(size, 1e-12 * size[0])[:, None] * length)
    return np.asarray(half.T @ half)


def variance(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance (...) of the products of rows (..., b) and parameters with the given covariance (b, b)."""
    return np.asarray(np.maximum(np.einsum("...b,...b->...", rows @ covariance, rows), 0.0))
