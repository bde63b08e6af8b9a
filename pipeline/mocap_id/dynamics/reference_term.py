"""Closeness to a reference body (4.11, 4.13), each parameter in units of its own likely deviation.

The thesis weighs kg, kg·m and kg·m² with one λ. Here every full parameter of the reference comes with a standard
deviation, 10 to 20 % of its size for tables of people. By default the reference decides only what the data leave open:
the base parameters stay a statement of the data. Asked to, it pulls these too. Then it is a prior, and what the data
say has to be weighed by what it is worth: not by the number of rows, which are correlated and hide errors that repeat
with the movement, but by the covariance of the base parameters, which holds all this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.solve import Compressed

_LEAST = 1e-6  # SI: parameters of the reference that are zero are not known exactly


def deviations(reference: FloatArray, relative: float) -> FloatArray:
    """Standard deviations (4(n + 1),) of a reference: this share of each segment's m, |(mx, my)| and Izz.

    Parameters
    ----------
    reference : (4(n + 1),) array
        m, mx, my, Izz of every segment; NaN stays NaN.
    relative : float
    """
    blocks = np.abs(reference.reshape(-1, 4))
    first = np.hypot(blocks[:, 1], blocks[:, 2])
    scale = relative * np.column_stack([blocks[:, 0], first, first, blocks[:, 3]])
    return np.maximum(scale, _LEAST).reshape(-1)


@dataclass(frozen=True)
class Prior:
    """A reference body as a normal distribution of the full parameters.

    Parameters
    ----------
    mean, sd : (4(n + 1),) arrays
    """

    mean: FloatArray
    sd: FloatArray

    def added_to(self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, rest: float) -> Compressed:
        """The sum of squares of data and prior over the full parameters.

        Parameters
        ----------
        base : (b,) array
            Base parameters that fit best, without constraint or prior.
        covariance : (b, b) array
            Of these, positive definite.
        regrouping : (b, f) array
            M.
        rest : float
            The part of the cost that no parameters can remove.

        Returns
        -------
        Compressed
            Its cost is (M φ - base)ᵀ covariance⁻¹ (M φ - base) + ‖(φ - mean) / sd‖² + rest.
        """
        root = np.linalg.cholesky(covariance)
        rows = np.vstack([solve_triangular(root, regrouping, lower=True), np.diag(1 / self.sd)])
        target = np.concatenate([solve_triangular(root, base, lower=True), self.mean / self.sd])
        return Compressed.of(rows, target, rest)

    def gain(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """By how much (b, b) the base parameters follow data with this covariance, the rest being the prior's."""
        spread = self._spread(regrouping)
        return np.asarray(np.linalg.solve(spread + covariance, spread).T)

    def covariance(self, gain: FloatArray, regrouping: FloatArray, of_data: FloatArray) -> FloatArray:
        """Covariance (b, b) of base parameters that follow data with this covariance by ``gain``, the prior else."""
        rest = np.eye(len(gain)) - gain
        return np.asarray(gain @ of_data @ gain.T + rest @ self._spread(regrouping) @ rest.T)

    def completed(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Covariance (f, f) of full parameters with base parameters of this covariance (b, b), else the closest ones.

        What the base parameters leave open has the prior's own spread: another trial, with its joints in other places,
        may feel it.
        """
        spread = np.diag(self.sd**2)
        follow = np.linalg.solve(self._spread(regrouping), regrouping @ spread).T
        return np.asarray(follow @ covariance @ follow.T + spread - follow @ regrouping @ spread)

    def _spread(self, regrouping: FloatArray) -> FloatArray:
        """Covariance (b, b) of the prior's base parameters."""
        return np.asarray(regrouping @ np.diag(self.sd**2) @ regrouping.T)
