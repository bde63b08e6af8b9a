"""Prior from a reference body (eq. 4.11, 4.13), with a standard deviation for each parameter.

The thesis weights kg, kg·m and kg·m² with one λ. Here every full parameter of the reference has a standard deviation;
for tables of people it is 10 to 20 % of the parameter's size. By default the reference determines only what the data do
not determine, and the base parameters depend on the data alone. Optionally, the reference is also a prior of the base
parameters. The weight of the data then follows from the covariance of the base parameters, not from the number of rows,
because the rows are correlated and do not reveal errors that recur with the movement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.least_squares import CompressedProblem

FOOT_MOMENT = 1
"""Column of the foot's mx among the full parameters."""
_LEAST = 1e-6  # SI: least standard deviation, for parameters that are zero
_APART = 3.0  # difference above which data and prior contradict each other, in standard deviations
_OPEN = 10.0  # relative standard deviation of parameters that are left to the data


def compute_reference_sd(reference: FloatArray, relative: float) -> FloatArray:
    """Return the standard deviations (4(n + 1),) of a reference: a fraction of each segment's m, |(mx, my)| and Izz.

    ``reference`` (4(n + 1),) contains m, mx, my, Izz of every segment; NaN stays NaN.
    """
    blocks = np.abs(reference.reshape(-1, 4))
    first = np.hypot(blocks[:, 1], blocks[:, 2])
    scale = relative * np.column_stack([blocks[:, 0], first, first, blocks[:, 3]])
    return np.maximum(scale, _LEAST).reshape(-1)


def compute_foot_sd(reference: FloatArray, first_moment: float, relative: float) -> FloatArray:
    """Return the standard deviations (4(n + 1),) of a reference that is used only for the foot, the first segment.

    The mass of the foot is small, so its first moment differs little between people. Given this moment, the torque of
    the ankle follows from the centre of pressure and the position of the joint, and not from the masses above.
    ``first_moment`` is the standard deviation of the foot's mx, kg·m, and ``relative`` that of its mass, as a fraction.
    """
    deviations = compute_reference_sd(reference, _OPEN)
    deviations[:2] = relative * reference[0], first_moment
    return np.maximum(deviations, _LEAST)


@dataclass(frozen=True)
class ReferencePrior:
    """A reference body as a normal distribution of the full parameters.

    In the methods, ``covariance`` (b, b) is the covariance of base parameters that were fitted to data, and
    ``regrouping`` (b, f) is the matrix M of eq. 4.24 from f = 4(n + 1) full parameters to b base parameters.
    """

    # mean, sd: (4(n + 1),) full parameters and their standard deviations
    mean: FloatArray
    sd: FloatArray

    def add_to(
        self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, rest: float
    ) -> CompressedProblem:
        """Return the least-squares problem of data and prior in the full parameters.

        The cost of full parameters φ is (M φ - base)ᵀ covariance⁻¹ (M φ - base) + ‖(φ - mean) / sd‖² + rest, where
        ``base`` (b,) are the base parameters of the fit without constraint or prior.
        """
        root = np.linalg.cholesky(covariance)
        rows = np.vstack([solve_triangular(root, regrouping, lower=True), np.diag(1 / self.sd)])
        target = np.concatenate([solve_triangular(root, base, lower=True), self.mean / self.sd])
        return CompressedProblem.of(rows, target, rest)

    def gain(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the weight (b, b) of the data in the base parameters; the prior has the remaining weight."""
        spread = self._spread(regrouping)
        return np.asarray(np.linalg.solve(spread + covariance, spread).T)

    def contradicts(self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, parameter: int) -> bool:
        """Return whether the prior would change a base parameter by more than 3 standard deviations of the change."""
        rest = np.eye(len(base)) - self.gain(covariance, regrouping)
        moved, variance = rest @ (base - regrouping @ self.mean), np.diag(rest @ covariance)
        return bool(moved[parameter] ** 2 > _APART**2 * variance[parameter])

    def covariance(self, gain: FloatArray, regrouping: FloatArray, of_data: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of base parameters from the prior and from data with covariance ``of_data``."""
        rest = np.eye(len(gain)) - gain
        return np.asarray(gain @ of_data @ gain.T + rest @ self._spread(regrouping) @ rest.T)

    def complete(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (f, f) of the full parameters, given the covariance of the base parameters.

        The part that the base parameters do not determine has the prior's covariance. This part has an effect in
        another trial with different joint positions.
        """
        spread = np.diag(self.sd**2)
        follow = np.linalg.solve(self._spread(regrouping), regrouping @ spread).T
        return np.asarray(follow @ covariance @ follow.T + spread - follow @ regrouping @ spread)

    def _spread(self, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of the prior's base parameters."""
        return np.asarray(regrouping @ np.diag(self.sd**2) @ regrouping.T)
