"""Identification: physically consistent parameters with their standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.consistency import Consistency, ConsistentSolution, fit_consistent, fit_quickly
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.instrument_errors import CalibrationEffect, ScaleCheck, propagate_calibration
from mocap_id.dynamics.kinematic_error import KinematicError, propagate_to_parameters
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.reference_prior import FOOT_MOMENT, ReferencePrior, compute_foot_sd, compute_reference_sd


@dataclass(frozen=True)
class Identification:
    """The identified inertial parameters of an individual."""

    fit: Fit  # unconstrained fit
    # base, base_sd: (b,) base parameters (eq. 6.1) and their standard deviations, SI
    base: FloatArray
    base_sd: FloatArray
    # (b, b) covariance of the base parameters from residuals, geometry, plate zero and errors of scale
    # (`calibration`)
    covariance: FloatArray
    # (b, b) part of the covariance from the residuals, for predictions of the wrench with the same geometry
    residual_covariance: FloatArray
    error: KinematicError  # uncertainty of the geometry
    response: FloatArray  # (b, S) change of the base parameters with each mode of that error
    offset_sd: float  # standard deviation of the clock offset, s
    # plate_bias, plate_bias_sd: constant error of the plate's Fx and its standard deviation, N; None if it was not
    # estimated
    plate_bias: float | None
    plate_bias_sd: float | None
    solution: ConsistentSolution  # physically possible parameters, and the solver's report
    uses_reference: bool  # whether the reference is a prior of the base parameters
    # function from a compressed problem in the columns of `fit.problem` (b + k) to parameters (b + k,). It repeats
    # the estimate with other data; a prior has the same weight as in the whole trial.
    refit: Callable[[CompressedProblem], FloatArray]
    # (b, b) weight of the ground's data in the base parameters, if there is also a prior or a built-in sensor; None if
    # the ground's data alone determine them
    gain: FloatArray | None = None
    # effect of the instruments' errors of scale, which `covariance` contains; None if it does not
    calibration: CalibrationEffect | None = None
    # result of the check for a wrong scale (`scale_check`); None if this check was not possible
    scales: ScaleCheck | None = None
    # identification with a prior of the foot, used only for the torques; None without this prior
    with_foot: Identification | None = None

    @property
    def full(self) -> FloatArray:
        """Full parameters (4(n + 1),): one of many consistent solutions."""
        return self.solution.full

    def add_calibration(self, effect: CalibrationEffect, scales: ScaleCheck | None) -> Identification:
        """Return a copy whose covariance includes the effect of errors of scale, with the result of the scale check."""
        if self.gain is not None:
            effect = replace(effect, parameters=self.gain @ effect.parameters)
        covariance = self.covariance + effect.covariance
        return replace(
            self,
            covariance=covariance,
            base_sd=np.sqrt(np.diag(covariance)),
            calibration=effect,
            scales=scales,
            with_foot=None if self.with_foot is None else self.with_foot.add_calibration(effect, scales),
        )


def identify(
    prepared: PreparedTrial,
    gate: BoolArray,
    grid: PointGrid,
    reference: FloatArray,
    error: KinematicError,
    *,
    consistency: Consistency = "grid",
    reference_sd: float = 0.15,
    reference_pulls: bool = False,
    foot_sd: float | None = None,
    plate_sd: float | None = None,
) -> Identification:
    """Identify the parameters on the gated samples (eq. 4.24-4.26).

    Parameters
    ----------
    reference : (4(n + 1),) array
        Full parameters to approach, as far as the wrench does not determine them; NaN for none.
    consistency : {"grid", "cone", "bounded-cone"}
        The set of possible bodies (:mod:`mocap_id.dynamics.consistency`).
    reference_sd : float
        Relative standard deviation of the reference's parameters.
    reference_pulls : bool
        Whether the reference is also a prior of the base parameters (eq. 4.13).
    foot_sd : float, optional
        Standard deviation of the foot's first moment divided by the body's mass, m. If it is given, the reference is a
        prior of the foot alone.
    plate_sd : float, optional
        Standard deviation of the plate's position along the motion, m, which makes data and prior of the foot differ.
        If it is given, the prior of the foot is used only for the torques, and only if data and prior differ by less
        than three standard deviations.

    Raises
    ------
    NumericalError
        The constrained least squares did not converge.
    """
    result = fit(prepared, gate)
    solve = partial(fit_consistent, grid=grid, reference=reference, consistency=consistency, relative_sd=reference_sd)
    refit = partial(fit_quickly, regrouping=prepared.base.regrouping, grid=grid, consistency=consistency)
    alone = _identify_from_data(prepared, result, solve(result.problem, prepared.base.regrouping), error, refit)
    if not np.isfinite(reference).all() or (foot_sd is None and not reference_pulls):
        return alone
    if foot_sd is not None and not reference_pulls:
        deviations = compute_foot_sd(reference, foot_sd * float(reference[::4].sum()), reference_sd)
        return _identify_with_foot(prepared, alone, ReferencePrior(reference, deviations), solve, plate_sd)
    whole = ReferencePrior(reference, compute_reference_sd(reference, reference_sd))
    return _identify_with_reference(alone, prepared.base.regrouping, whole, solve)


def _identify_with_foot(
    prepared: PreparedTrial,
    alone: Identification,
    foot: ReferencePrior,
    solve: Callable[[CompressedProblem, FloatArray], ConsistentSolution],
    plate_sd: float | None,
) -> Identification:
    """Identify the parameters with a prior of the foot; if ``plate_sd``, m, is given, only in ``with_foot``."""
    regrouping = prepared.base.regrouping
    if plate_sd is None:
        return _identify_with_reference(alone, regrouping, foot, solve)
    of_plate = propagate_calibration(prepared, alone.fit, alone.base, {"position": plate_sd}).covariance
    own = np.flatnonzero(prepared.base.kept == FOOT_MOMENT)
    if any(foot.contradicts(alone.base, alone.covariance + of_plate, regrouping, int(one)) for one in own):
        return alone
    return replace(alone, with_foot=_identify_with_reference(alone, regrouping, foot, solve, of_plate))


def _identify_from_data(
    prepared: PreparedTrial,
    result: Fit,
    solution: ConsistentSolution,
    error: KinematicError,
    refit: Callable[[CompressedProblem], FloatArray],
) -> Identification:
    """Identify the parameters from the data alone."""
    base, own = solution.parameters[: result.base], slice(result.base)
    response = propagate_to_parameters(prepared, result, base, error)
    kinematic = response @ response.T
    covariance = result.covariance + kinematic + _propagate_plate_zero(prepared, result)
    sd = np.sqrt(np.diag(covariance))
    biased = len(solution.parameters) > result.base
    return Identification(
        fit=result,
        base=base,
        base_sd=sd[own],
        covariance=covariance[own, own],
        residual_covariance=result.covariance[own, own],
        error=error,
        response=response[own],
        offset_sd=float(np.hypot(result.offset_sd, np.sqrt(kinematic[-1, -1]))),
        plate_bias=float(solution.parameters[-1]) if biased else None,
        plate_bias_sd=float(sd[result.base]) if biased else None,
        solution=solution,
        uses_reference=False,
        refit=refit,
    )


def _identify_with_reference(
    alone: Identification,
    regrouping: FloatArray,
    prior: ReferencePrior,
    solve: Callable[[CompressedProblem, FloatArray], ConsistentSolution],
    of_plate: FloatArray | float = 0.0,
) -> Identification:
    """Identify the parameters from the data and a prior of the full parameters.

    ``of_plate`` (b, b) is the covariance of the parameters due to errors of the plate. It only reduces the weight of
    the data relative to the prior. The covariance of the result does not contain it: it is added there later.
    """
    problem = alone.fit.problem.eliminate_others(alone.fit.base)
    independent = np.linalg.inv(problem.factor.T @ problem.factor)
    # the first covariance may be singular: there can be fewer blocks than parameters
    known = alone.covariance + independent + of_plate

    def solve_with_prior(data: CompressedProblem) -> ConsistentSolution:
        small = data.eliminate_others(alone.fit.base)
        return solve(prior.add_to(small.free_solution(), known, regrouping, small.rest), np.eye(len(prior.mean)))

    solution = solve_with_prior(alone.fit.problem)
    base, gain = regrouping @ solution.parameters, prior.gain(known, regrouping)
    covariance = prior.covariance(gain, regrouping, alone.covariance)
    biased = alone.plate_bias is not None
    return replace(
        alone,
        base=base,
        base_sd=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        residual_covariance=prior.covariance(gain, regrouping, alone.residual_covariance),
        response=gain @ alone.response,
        plate_bias=float(alone.fit.problem.complete(base)[-1]) if biased else None,
        solution=solution,
        uses_reference=True,
        gain=gain,
        refit=lambda data: data.complete(regrouping @ solve_with_prior(data).parameters),
    )


def _propagate_plate_zero(prepared: PreparedTrial, result: Fit) -> FloatArray:
    """Return the covariance (b + k + 1, b + k + 1) of the fitted values due to constant errors of Fy and tauz.

    Under gravity, m1 causes a constant Fy and mx1 a constant tauz. A constant error of the plate therefore changes only
    these parameters. With a prior, the fit distributes it over the bodies.
    """
    size, gravity = result.design.shape[-1], prepared.settings.gravity
    if result.prior is not None:
        components = prepared.settings.components
        sd = np.array([prepared.settings.plate_zero[c - 1] if c else 0.0 for c in components])
        constant = np.broadcast_to(np.diag(sd * result.weights), (len(result.design), len(sd), len(sd)))
        moved = result.response(constant)
        return np.asarray(moved @ moved.T)
    variance = np.zeros(size)
    for column, sd_of in enumerate(prepared.settings.plate_zero):
        variance[: len(prepared.base.kept)][prepared.base.kept == column] = (sd_of / gravity) ** 2
    return np.diag(variance)
