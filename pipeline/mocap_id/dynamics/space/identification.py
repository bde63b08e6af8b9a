"""Identification in space: physically consistent base parameters with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.excitation import WEAK, Excitation, judge
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.space.calibration import ErrorMode, SpatialCalibration, covariance_of, error_modes
from mocap_id.dynamics.space.consistency import SemidefiniteSolution, fit_semidefinite
from mocap_id.dynamics.space.trial import SpatialTrial
from mocap_id.dynamics.uncertainty import unit_covariance

_LEAST_LEVER = 0.05  # m: least size of the base's first moments, times the mass


@dataclass(frozen=True)
class SpatialIdentification:
    """The identified inertial parameters of a chain in space.

    Parameters
    ----------
    fit : Fit
    base, base_sd : (b,) arrays
        Base parameters in the simple frames (:class:`SpatialBase`) and their standard deviations, SI.
    covariance : (b, b) array
        From the residuals, the joint centres, the plate's zero and errors of the instruments.
    residual_covariance : (b, b) array
        The part from the residuals.
    modes : tuple of ErrorMode
        Errors that no residual shows.
    offset_sd : float
        Standard deviation of the clock offset, s.
    plate_bias : (3,) or (0,) array
        Constant errors of the plate's Fx and Fz, N, and tauy, N·m; empty if they were not estimated.
    solution : SemidefiniteSolution
    """

    fit: Fit
    base: FloatArray
    base_sd: FloatArray
    covariance: FloatArray
    residual_covariance: FloatArray
    modes: tuple[ErrorMode, ...]
    offset_sd: float
    plate_bias: FloatArray
    solution: SemidefiniteSolution

    @property
    def full(self) -> FloatArray:
        """Full parameters (10K,) in the segments' frames: one of many consistent solutions."""
        return self.solution.full

    @property
    def unit_covariance(self) -> FloatArray:
        """Covariance (b, b) of the base parameters for independent residuals of unit size, after weighting."""
        rows = self.fit.design.reshape(-1, self.fit.design.shape[-1])
        own = slice(len(self.base))
        return unit_covariance(rows)[own, own]


def identify(trial: SpatialTrial, gate: BoolArray, calibration: SpatialCalibration) -> SpatialIdentification:
    """Identify the parameters on the gated samples (eq. 4.24-4.26).

    Parameters
    ----------
    trial : SpatialTrial
    gate : (T,) bool array
        Samples in which only the plate carries the body.
    calibration : SpatialCalibration

    Raises
    ------
    NumericalError
        The constrained least squares did not converge.
    """
    found = fit(trial, gate)
    solution = fit_semidefinite(found.problem, trial.structure.mapping)
    base = solution.parameters[: found.base]
    modes = error_modes(trial, found, base, calibration)
    covariance = found.covariance + covariance_of(modes, len(found.covariance))
    own = slice(found.base)
    sd = np.sqrt(np.diag(covariance))
    return SpatialIdentification(
        fit=found,
        base=base,
        base_sd=sd[own],
        covariance=covariance[own, own],
        residual_covariance=found.covariance[own, own],
        modes=modes,
        offset_sd=float(sd[-1]),
        plate_bias=solution.parameters[found.base :],
        solution=solution,
    )


def excitation_in_space(trial: SpatialTrial, found: SpatialIdentification, weak: float = WEAK) -> Excitation:
    """Classify every base parameter by the rule of :mod:`mocap_id.dynamics.excitation`."""
    return judge(trial.structure.names, found.fit, found.base_sd, parameter_sizes(trial, found), weak)


def parameter_sizes(trial: SpatialTrial, found: SpatialIdentification) -> FloatArray:
    """Return the size of each base parameter (b,), SI, that its standard deviation is compared with.

    A single component of the first or second moments may be zero, so its size is the norm of the segment's first or
    second moments. The size of the base's first moments is at least the mass times 5 cm.
    """
    segment, column = trial.base.kept // 10, trial.base.kept % 10
    order = np.where(column == 0, 0, np.where(column < 4, 1, 2))
    size = np.zeros(len(column))
    for i in range(len(size)):
        size[i] = np.linalg.norm(found.base[(segment == segment[i]) & (order == order[i])])
        if segment[i] == 0 and order[i] == 1:
            size[i] = max(size[i], _LEAST_LEVER * abs(found.base[0]))
    return size
