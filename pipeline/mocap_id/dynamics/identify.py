"""From fit to answer: physically consistent parameters with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.kinematic_error import KinematicError, kinematic_covariance
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.solve import MassSolution, fit_masses, spread_masses


@dataclass(frozen=True)
class Identification:
    """An individual's inertial parameters, as far as the wrench tells.

    Parameters
    ----------
    fit : Fit
        Samples, offset, condition.
    base, base_sd : (b,) arrays
        Base parameters (eq. 6.1) and their standard deviations, SI.
    covariance : (b, b) array
        Of the base parameters, behind ``base_sd``: from the residuals, the errors of the geometry and the plate's
        zero.
    residual_covariance : (b, b) array
        From the residuals alone: how well the model predicts the wrench with this very geometry.
    offset_sd : float
        Standard deviation of the clock offset, s.
    plate_bias, plate_bias_sd : float or None
        Constant error of the plate's Fx, N; None where it was not estimated.
    solution : MassSolution
        How the solvers fared.
    masses : (p,) array
        Point masses, kg: those with these base parameters that are closest to the reference, or spread most evenly.
    full : (4(n + 1),) array
        Full parameters of the point masses: one consistent solution of many.
    """

    fit: Fit
    base: FloatArray
    base_sd: FloatArray
    covariance: FloatArray
    residual_covariance: FloatArray
    offset_sd: float
    plate_bias: float | None
    plate_bias_sd: float | None
    solution: MassSolution
    masses: FloatArray
    full: FloatArray


def identify(
    prepared: Prepared, gate: BoolArray, grid: PointGrid, reference: FloatArray, error: KinematicError
) -> Identification:
    """Identify on the samples that the gate lets through (eq. 4.24-4.26).

    Parameters
    ----------
    prepared : Prepared
    gate : (T,) bool array
        Samples where the ground is all that the body touches.
    grid : PointGrid
    reference : (4(n + 1),) array
        Full parameters to be close to in what the wrench does not tell; NaN for none. They do not touch the base
        parameters.
    error : KinematicError
        What is uncertain of the geometry.

    Returns
    -------
    Identification

    Raises
    ------
    NumericalError
        The constrained least squares did not converge.
    """
    found = fit(prepared, gate)
    moments = grid.moments()
    base_moments = prepared.base.regrouping @ moments
    solution = fit_masses(found.problem, base_moments)
    base = solution.parameters[: found.base]
    masses = spread_masses(base_moments, base, moments, reference, _reference_scale(reference))
    kinematic = kinematic_covariance(prepared, found, base, error)
    covariance = found.covariance + kinematic + _plate_covariance(prepared, len(kinematic))
    sd = np.sqrt(np.diag(covariance))
    biased = len(solution.parameters) > found.base
    return Identification(
        fit=found,
        base=base,
        base_sd=sd[: found.base],
        covariance=covariance[: found.base, : found.base],
        residual_covariance=found.covariance[: found.base, : found.base],
        offset_sd=float(np.hypot(found.offset_sd, np.sqrt(kinematic[-1, -1]))),
        plate_bias=float(solution.parameters[-1]) if biased else None,
        plate_bias_sd=float(sd[found.base]) if biased else None,
        solution=solution,
        masses=masses,
        full=moments @ masses,
    )


def _plate_covariance(prepared: Prepared, size: int) -> FloatArray:
    """Covariance (size, size) that constant errors of Fy and tauz cause.

    Gravity turns the mass into a constant Fy and the base's first moment into a constant tauz: a constant error of
    the plate is a wrong m1 or mx1, and nothing else.
    """
    variance = np.zeros(size)
    gravity = prepared.settings.gravity
    for column, sd in enumerate(prepared.settings.plate_zero):
        variance[: len(prepared.base.kept)][prepared.base.kept == column] = (sd / gravity) ** 2
    return np.diag(variance)


def _reference_scale(reference: FloatArray, relative: float = 0.15) -> FloatArray:
    """Deviations that count as one: 15 % of each segment's m, |(mx, my)| and Izz."""
    blocks = np.abs(reference.reshape(-1, 4))
    first = np.hypot(blocks[:, 1], blocks[:, 2])
    scale = relative * np.column_stack([blocks[:, 0], first, first, blocks[:, 3]])
    return np.maximum(scale, 1e-6).reshape(-1)
