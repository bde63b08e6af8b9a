"""Identification in space: physically consistent base parameters with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.excitation import WEAK, Excitation, classify_parameters
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.space.consistency import SemidefiniteSolution, fit_semidefinite
from mocap_id.dynamics.space.instrument_errors import ErrorMode, SpatialCalibration, propagate_errors, sum_modes
from mocap_id.dynamics.space.preparation import SpatialTrial
from mocap_id.dynamics.uncertainty import unit_covariance

_LEAST_LEVER = 0.05  # m: least size of the base's first moments, divided by the mass


@dataclass(frozen=True)
class SpatialIdentification:
    """The identified inertial parameters of a chain in space."""

    fit: Fit  # unconstrained fit
    # base, base_sd: (b,) base parameters in the simple frames (`SpatialBase`) and their standard deviations, SI
    base: FloatArray
    base_sd: FloatArray
    covariance: FloatArray  # (b, b) covariance from residuals, joint centres, plate zero and errors of the instruments
    residual_covariance: FloatArray  # (b, b) part of the covariance from the residuals
    modes: tuple[ErrorMode, ...]  # errors that the residuals do not contain
    offset_sd: float  # standard deviation of the clock offset, s
    # constant errors of the plate's Fx and Fz, N, and tauy, N·m; empty if they were not estimated
    plate_bias: FloatArray
    solution: SemidefiniteSolution  # physically possible parameters, and the solver's report

    @property
    def full(self) -> FloatArray:
        """Full parameters (10K,) in the segments' frames: one of many consistent solutions."""
        return self.solution.full

    @property
    def unit_covariance(self) -> FloatArray:
        """Covariance (b, b) of the base parameters for independent weighted residuals of unit variance."""
        rows = self.fit.design.reshape(-1, self.fit.design.shape[-1])
        own = slice(len(self.base))
        return unit_covariance(rows)[own, own]


def identify(trial: SpatialTrial, gate: BoolArray, calibration: SpatialCalibration) -> SpatialIdentification:
    """Identify the parameters on the gated samples (eq. 4.24-4.26).

    Parameters
    ----------
    gate : (T,) bool array
        True for samples in which only the plate carries the body.
    calibration : SpatialCalibration
        Standard deviations of the instruments' errors.

    Raises
    ------
    NumericalError
        The constrained least squares did not converge.
    """
    result = fit(trial, gate)
    solution = fit_semidefinite(result.problem, trial.structure.mapping)
    base = solution.parameters[: result.base]
    modes = propagate_errors(trial, result, base, calibration)
    covariance = result.covariance + sum_modes(modes, len(result.covariance))
    own = slice(result.base)
    sd = np.sqrt(np.diag(covariance))
    return SpatialIdentification(
        fit=result,
        base=base,
        base_sd=sd[own],
        covariance=covariance[own, own],
        residual_covariance=result.covariance[own, own],
        modes=modes,
        offset_sd=float(sd[-1]),
        plate_bias=solution.parameters[result.base :],
        solution=solution,
    )


def measure_excitation_in_space(trial: SpatialTrial, result: SpatialIdentification, weak: float = WEAK) -> Excitation:
    """Measure the excitation of every base parameter; a relative standard deviation above ``weak`` makes it weak.

    The method is that of :func:`mocap_id.dynamics.excitation.classify_parameters`.
    """
    return classify_parameters(trial.structure.names, result.fit, result.base_sd, measure_sizes(trial, result), weak)


def measure_sizes(trial: SpatialTrial, result: SpatialIdentification) -> FloatArray:
    """Return the size of each base parameter (b,), SI, with which its standard deviation is compared.

    The size of a first or second moment is the norm of all first or second moments of its segment, because a single
    component may be zero. The size of the base's first moments is at least the mass times 5 cm.
    """
    segment, column = trial.base.kept // 10, trial.base.kept % 10
    order = np.where(column == 0, 0, np.where(column < 4, 1, 2))
    size = np.zeros(len(column))
    for i in range(len(size)):
        size[i] = np.linalg.norm(result.base[(segment == segment[i]) & (order == order[i])])
        if segment[i] == 0 and order[i] == 1:
            size[i] = max(size[i], _LEAST_LEVER * abs(result.base[0]))
    return size
