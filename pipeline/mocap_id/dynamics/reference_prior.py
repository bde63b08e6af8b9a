"""Prior from a reference body (4.11, 4.13), with a standard deviation for each parameter.

The thesis weights kg, kg·m and kg·m² with one λ. Here every full parameter of the reference has a standard deviation;
for tables of people it is 10 to 20 % of the parameter's size. By default the reference determines only what the data
leave open, and the base parameters depend on the data alone. Optionally it is a prior of the base parameters too. The
data are then weighted by the covariance of the base parameters, and not by the number of rows, because the rows are
correlated and do not show errors that repeat with the movement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.least_squares import CompressedProblem

FOOT_MOMENT = 1
"""Column of the foot's mx among the full parameters."""
_LEAST = 1e-6  # SI: least standard deviation, also of parameters that are zero
_APART = 3.0  # standard deviations
_OPEN = 10.0  # relative standard deviation of parameters that are left to the data


def reference_deviations(reference: FloatArray, relative: float) -> FloatArray:
    """Return the standard deviations (4(n + 1),) of a reference: a fraction of each segment's m, |(mx, my)| and Izz.

    Parameters
    ----------
    reference : (4(n + 1),) array
        m, mx, my, Izz of every segment; NaN stays NaN.
    relative : float
        The fraction.
    """
    blocks = np.abs(reference.reshape(-1, 4))
    first = np.hypot(blocks[:, 1], blocks[:, 2])
    scale = relative * np.column_stack([blocks[:, 0], first, first, blocks[:, 3]])
    return np.maximum(scale, _LEAST).reshape(-1)


def foot_deviations(reference: FloatArray, first_moment: float, relative: float) -> FloatArray:
    """Return the standard deviations (4(n + 1),) of a reference that is known for the foot alone.

    The foot's first moment differs little between people: its mass is small. The torque of the ankle then follows from
    the centre of pressure and the place of the joint, and no longer from the masses above.

    Parameters
    ----------
    reference : (4(n + 1),) array
        m, mx, my, Izz of every segment; the foot is the first.
    first_moment : float
        Standard deviation of the foot's mx, kg·m.
    relative : float
        That of its mass, as a fraction.
    """
    deviations = reference_deviations(reference, _OPEN)
    deviations[:2] = relative * reference[0], first_moment
    return np.maximum(deviations, _LEAST)


@dataclass(frozen=True)
class ReferencePrior:
    """A reference body as a normal distribution of the full parameters.

    Parameters
    ----------
    mean, sd : (4(n + 1),) arrays
    """

    mean: FloatArray
    sd: FloatArray

    def added_to(
        self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, rest: float
    ) -> CompressedProblem:
        """Return the least-squares problem of data and prior in the full parameters.

        Parameters
        ----------
        base : (b,) array
            Base parameters of the fit without constraint or prior.
        covariance : (b, b) array
            Their covariance, positive definite.
        regrouping : (b, f) array
            Matrix M.
        rest : float
            The part of the cost that no parameters can remove.

        Returns
        -------
        CompressedProblem
            Its cost is (M φ - base)ᵀ covariance⁻¹ (M φ - base) + ‖(φ - mean) / sd‖² + rest.
        """
        root = np.linalg.cholesky(covariance)
        rows = np.vstack([solve_triangular(root, regrouping, lower=True), np.diag(1 / self.sd)])
        target = np.concatenate([solve_triangular(root, base, lower=True), self.mean / self.sd])
        return CompressedProblem.of(rows, target, rest)

    def gain(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the weight (b, b) of data with this covariance in the base parameters; the rest is the prior's."""
        spread = self._spread(regrouping)
        return np.asarray(np.linalg.solve(spread + covariance, spread).T)

    def contradicts(self, base: FloatArray, covariance: FloatArray, regrouping: FloatArray, parameter: int) -> bool:
        """Return whether the prior would change a base parameter by more than three standard deviations of the change.

        Parameters
        ----------
        base, covariance, regrouping
            As for :meth:`added_to`.
        parameter : int
            Index of the base parameter.
        """
        rest = np.eye(len(base)) - self.gain(covariance, regrouping)
        moved, variance = rest @ (base - regrouping @ self.mean), np.diag(rest @ covariance)
        return bool(moved[parameter] ** 2 > _APART**2 * variance[parameter])

    def covariance(self, gain: FloatArray, regrouping: FloatArray, of_data: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of base parameters that combine data of this covariance with the prior."""
        rest = np.eye(len(gain)) - gain
        return np.asarray(gain @ of_data @ gain.T + rest @ self._spread(regrouping) @ rest.T)

    def completed(self, covariance: FloatArray, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (f, f) of the full parameters, given that of the base parameters (b, b).

        What the base parameters leave open has the prior's covariance. It matters for another trial that has its joints
        at other places.
        """
        spread = np.diag(self.sd**2)
        follow = np.linalg.solve(self._spread(regrouping), regrouping @ spread).T
        return np.asarray(follow @ covariance @ follow.T + spread - follow @ regrouping @ spread)

    def _spread(self, regrouping: FloatArray) -> FloatArray:
        """Return the covariance (b, b) of the prior's base parameters."""
        return np.asarray(regrouping @ np.diag(self.sd**2) @ regrouping.T)
