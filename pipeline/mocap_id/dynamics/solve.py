"""Linear least squares behind a QR decomposition: all that the data say, in as many rows as there are parameters.

The data enter everything after the fit only through the triangular factor R of their QR decomposition: the cost of
parameters x is ‖R x - d‖² and a constant. Thousands of rows become a dozen, and the condition number is not squared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base import triangular_factor


@dataclass(frozen=True)
class Compressed:
    """A least-squares problem after QR: cost = ‖R x - d‖² + rest.

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
    def of(cls, rows: FloatArray, target: FloatArray, rest: float = 0.0) -> Compressed:
        """Compress rows (r, b) and their right-hand side (r,), of any number, on top of an irremovable ``rest``."""
        columns = rows.shape[1]
        missing = max(columns + 1 - len(rows), 0)
        filled = np.pad(np.column_stack([rows, target]), ((0, missing), (0, 0)))
        factor = triangular_factor(filled)
        return cls(factor[:columns, :columns], factor[:columns, -1], float(factor[columns, -1] ** 2) + rest)

    def free_solution(self) -> FloatArray:
        """Parameters (b,) without any constraint; of several the shortest."""
        return np.asarray(np.linalg.lstsq(self.factor, self.target, rcond=None)[0], dtype=np.float64)

    def cost(self, parameters: FloatArray) -> float:
        """Squared residual at these parameters."""
        return float(np.sum((self.factor @ parameters - self.target) ** 2)) + self.rest

    def floor(self, cost: float) -> float:
        """A cost to compare others with, kept off zero: of less than this a millionth is rounding."""
        return max(cost, 1e-9 * float(self.target @ self.target), 1e-300)

    def over(self, kept: int) -> Compressed:
        """The problem over the first ``kept`` parameters, with those behind them at their best for each choice."""
        others = self.factor[:, kept:]
        if others.shape[1] == 0:
            return self
        basis, size, _ = np.linalg.svd(others, full_matrices=False)
        basis = basis[:, size > len(others) * np.finfo(np.float64).eps * max(float(size.max()), 1e-300)]
        rows = self.factor[:, :kept] - basis @ (basis.T @ self.factor[:, :kept])
        return Compressed.of(rows, self.target - basis @ (basis.T @ self.target), self.rest)

    def completed(self, parameters: FloatArray) -> FloatArray:
        """Put the best values of the parameters that follow behind the given first ones."""
        rest = self.target - self.factor[:, : len(parameters)] @ parameters
        others = np.linalg.lstsq(self.factor[:, len(parameters) :], rest, rcond=None)[0]
        return np.concatenate([parameters, others])
