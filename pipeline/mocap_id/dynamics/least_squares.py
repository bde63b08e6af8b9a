"""Linear least squares, compressed by a QR decomposition to as many rows as parameters.

Only the triangular factor R of the QR decomposition of the data is needed, because the cost of parameters x is
‖R x - d‖² plus a constant. Thousands of rows become a dozen, and the condition number is not squared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
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
        """Return the cost of these parameters (b,): the sum of squared residuals."""
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
