"""From fit to answer: physically consistent parameters with their standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.consistent import Consistency, Solution, fit_consistent, fit_quickly
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.kinematic_error import KinematicError, kinematic_response
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.reference_term import Prior, deviations
from mocap_id.dynamics.solve import Compressed


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
    error : KinematicError
        What is uncertain of the geometry.
    response : (b, S) array
        By how much each of its modes moves the base parameters.
    offset_sd : float
        Standard deviation of the clock offset, s.
    plate_bias, plate_bias_sd : float or None
        Constant error of the plate's Fx, N; None where it was not estimated.
    solution : Solution
        Which bodies counted as possible, and how the solvers fared.
    masses : (p,) array
        Point masses, kg: those with these base parameters that are closest to the reference, or spread most evenly;
        NaN where the exact cone took the grid's place.
    full : (4(n + 1),) array
        Full parameters: one consistent solution of many.
    pulled : bool
        The reference took part in the base parameters.
    refit : callable
        The same estimate from other data: from a compressed problem over the columns of ``fit.problem`` (b + k) to its
        parameters (b + k,). A prior counts as much beside them as beside the whole trial.
    """

    fit: Fit
    base: FloatArray
    base_sd: FloatArray
    covariance: FloatArray
    residual_covariance: FloatArray
    error: KinematicError
    response: FloatArray
    offset_sd: float
    plate_bias: float | None
    plate_bias_sd: float | None
    solution: Solution
    masses: FloatArray
    full: FloatArray
    pulled: bool
    refit: Callable[[Compressed], FloatArray]


def identify(
    prepared: Prepared,
    gate: BoolArray,
    grid: PointGrid,
    reference: FloatArray,
    error: KinematicError,
    *,
    consistency: Consistency = "grid",
    reference_sd: float = 0.15,
    reference_pulls: bool = False,
) -> Identification:
    """Identify on the samples that the gate lets through (eq. 4.24-4.26).

    Parameters
    ----------
    prepared : Prepared
    gate : (T,) bool array
        Samples where the ground is all that the body touches.
    grid : PointGrid
    reference : (4(n + 1),) array
        Full parameters to be close to in what the wrench does not tell; NaN for none.
    error : KinematicError
        What is uncertain of the geometry.
    consistency : {"grid", "cone", "bounded-cone"}
        Which bodies are possible (:mod:`mocap_id.dynamics.consistent`).
    reference_sd : float
        Standard deviation of the reference's parameters, of their size.
    reference_pulls : bool
        The reference is a prior of the base parameters too (4.13).

    Returns
    -------
    Identification

    Raises
    ------
    NumericalError
        The constrained least squares did not converge.
    """
    found = fit(prepared, gate)
    solve = partial(fit_consistent, grid=grid, reference=reference, consistency=consistency, relative_sd=reference_sd)
    refit = partial(fit_quickly, regrouping=prepared.base.regrouping, grid=grid, consistency=consistency)
    alone = _alone(prepared, found, solve(found.problem, prepared.base.regrouping), error, refit)
    if reference_pulls and np.isfinite(reference).all():
        return _pulled(alone, prepared.base.regrouping, Prior(reference, deviations(reference, reference_sd)), solve)
    return alone


def _alone(
    prepared: Prepared,
    found: Fit,
    solution: Solution,
    error: KinematicError,
    refit: Callable[[Compressed], FloatArray],
) -> Identification:
    """What the data say by themselves."""
    base, own = solution.parameters[: found.base], slice(found.base)
    response = kinematic_response(prepared, found, base, error)
    kinematic = response @ response.T
    covariance = found.covariance + kinematic + _plate_covariance(prepared, found)
    sd = np.sqrt(np.diag(covariance))
    biased = len(solution.parameters) > found.base
    return Identification(
        fit=found,
        base=base,
        base_sd=sd[own],
        covariance=covariance[own, own],
        residual_covariance=found.covariance[own, own],
        error=error,
        response=response[own],
        offset_sd=float(np.hypot(found.offset_sd, np.sqrt(kinematic[-1, -1]))),
        plate_bias=float(solution.parameters[-1]) if biased else None,
        plate_bias_sd=float(sd[found.base]) if biased else None,
        solution=solution,
        masses=solution.masses,
        full=solution.full,
        pulled=False,
        refit=refit,
    )


def _pulled(
    alone: Identification, regrouping: FloatArray, prior: Prior, solve: Callable[[Compressed, FloatArray], Solution]
) -> Identification:
    """The same with a prior of the full parameters."""
    problem = alone.fit.problem.over(alone.fit.base)
    independent = np.linalg.inv(problem.factor.T @ problem.factor)
    known = alone.covariance + independent  # by itself it may be singular: blocks can be fewer than parameters

    def solution_of(data: Compressed) -> Solution:
        small = data.over(alone.fit.base)
        return solve(prior.added_to(small.free_solution(), known, regrouping, small.rest), np.eye(len(prior.mean)))

    solution = solution_of(alone.fit.problem)
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
        plate_bias=float(alone.fit.problem.completed(base)[-1]) if biased else None,
        solution=solution,
        masses=solution.masses,
        full=solution.full,
        pulled=True,
        refit=lambda data: data.completed(regrouping @ solution_of(data).parameters),
    )


def _plate_covariance(prepared: Prepared, found: Fit) -> FloatArray:
    """Covariance of base parameters, nuisance and offset that constant errors of Fy and tauz cause.

    Gravity turns the mass into a constant Fy and the base's first moment into a constant tauz: a constant error of
    the plate is a wrong m1 or mx1, and nothing else. With a prior it is shared between the bodies as the fit does.
    """
    size, gravity = found.design.shape[-1], prepared.settings.gravity
    if found.prior is not None:
        components = prepared.settings.components
        sd = np.array([prepared.settings.plate_zero[c - 1] if c else 0.0 for c in components])
        constant = np.broadcast_to(np.diag(sd * found.weights), (len(found.design), len(sd), len(sd)))
        moved = found.answer(constant)
        return np.asarray(moved @ moved.T)
    variance = np.zeros(size)
    for column, sd_of in enumerate(prepared.settings.plate_zero):
        variance[: len(prepared.base.kept)][prepared.base.kept == column] = (sd_of / gravity) ** 2
    return np.diag(variance)
