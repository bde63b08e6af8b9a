"""Linear least squares, compressed by a QR decomposition, and the uncertainty if residuals are correlated in time.

Only the triangular factor R of the QR decomposition of the data is needed, because the cost of parameters x is
‖R x - d‖² plus a constant. Thousands of rows become a dozen, and the condition number is not squared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.base_parameters import triangularise


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
