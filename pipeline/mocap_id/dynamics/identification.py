"""Identification: physically consistent parameters with standard deviations, cross-validation, choice of cut-offs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.consistency import Consistency, PointGrid, Solution, fit_consistent, fit_quickly
from mocap_id.dynamics.fit import DEPENDENT, LEAST_SECONDS, Fit, fit, select_samples
from mocap_id.dynamics.instrument_errors import (
    CalibrationEffect,
    KinematicError,
    ScaleCheck,
    propagate_calibration,
    propagate_to_parameters,
)
from mocap_id.dynamics.measured_motion import CUTOFFS, USUAL
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.priors import FOOT_MOMENT, ReferencePrior, compute_foot_sd, compute_reference_sd
from mocap_id.dynamics.regressor import CompressedProblem, triangularise


@dataclass(frozen=True)
class Identified:
    """Identified inertial parameters, in the plane or in space."""

    fit: Fit  # unconstrained fit
    # base, base_sd: (b,) base parameters (eq. 6.1) and their standard deviations, SI
    base: FloatArray
    base_sd: FloatArray
    covariance: FloatArray  # (b, b) covariance from residuals, geometry, plate zero and errors of the instruments
    # (b, b) part of the covariance from the residuals, for predictions of the wrench with the same geometry
    residual_covariance: FloatArray
    offset_sd: float  # standard deviation of the clock offset, s
    solution: Solution  # physically possible parameters, and the solver's report

    @property
    def full(self) -> FloatArray:
        """Full parameters in the segments' frames, 4(n + 1) or in space 10K: one of many consistent solutions."""
        return self.solution.full


@dataclass(frozen=True)
class Identification(Identified):
    """The identified inertial parameters of an individual."""

    error: KinematicError  # uncertainty of the geometry
    response: FloatArray  # (b, S) change of the base parameters with each mode of that error
    # plate_bias, plate_bias_sd: constant error of the plate's Fx and its standard deviation, N; None if it was not
    # estimated
    plate_bias: float | None
    plate_bias_sd: float | None
    uses_reference: bool  # whether the reference is a prior of the base parameters
    # function from a compressed problem in the columns of `fit.problem` (b + k) to parameters (b + k,). It repeats
    # the estimate with other data; a prior has the same weight as in the whole trial.
    refit: Callable[[CompressedProblem], FloatArray]
    # (b, b) weight of the ground's data in the base parameters, if there is also a prior or a built-in sensor; None if
    # the ground's data alone determine them
    gain: FloatArray | None = None
    # effect of the instruments' errors of scale, which `covariance` contains; None if it does not
    calibration: CalibrationEffect | None = None
    # result of the check for a wrong scale (`check_scales`); None if this check was not possible
    scales: ScaleCheck | None = None
    # identification with a prior of the foot, used only for the torques; None without this prior
    with_foot: Identification | None = None

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

    ``reference`` (4(n + 1),) are full parameters to approach, as far as the wrench does not determine them, NaN for
    none; ``reference_sd`` is their relative standard deviation. With ``reference_pulls``, they are also a prior of the
    base parameters (eq. 4.13). ``foot_sd``, m, is the standard deviation of the foot's first moment divided by the
    body's mass; if it is given, the reference is a prior of the foot alone. ``plate_sd``, m, is that of the plate's
    position along the motion, which makes data and prior of the foot differ; if it is given, the prior of the foot is
    used only for the torques, and only if data and prior differ by less than three standard deviations. ``consistency``
    is the set of possible bodies (:mod:`mocap_id.dynamics.consistency`). NumericalError is raised if the constrained
    least squares do not converge.
    """
    result = fit(prepared, gate)
    solve = partial(fit_consistent, grid=grid, reference=reference, consistency=consistency, relative_sd=reference_sd)
    refit = partial(fit_quickly, regrouping=prepared.base.regrouping, grid=grid, consistency=consistency)
    regrouping = prepared.base.regrouping

    # the parameters from the data alone, with errors of geometry and plate zero
    solution = solve(result.problem, regrouping)
    base, own = solution.parameters[: result.base], slice(result.base)
    response = propagate_to_parameters(prepared, result, base, error)
    kinematic = response @ response.T
    # Under gravity, m1 causes a constant Fy and mx1 a constant tauz, so a constant error of the plate changes only
    # these parameters. With a prior, the fit distributes it over the bodies.
    plate_zero = prepared.settings.plate_zero
    if result.prior is not None:
        zero_sd = np.array([plate_zero[c - 1] if c else 0.0 for c in prepared.settings.components])
        constant = np.diag(zero_sd * result.weights)
        moved = result.response(np.broadcast_to(constant, (len(result.design), *constant.shape)))
        of_zero = np.asarray(moved @ moved.T)
    else:
        variance = np.zeros(result.design.shape[-1])
        for column, sd_of in enumerate(plate_zero):
            variance[: len(prepared.base.kept)][prepared.base.kept == column] = (sd_of / prepared.settings.gravity) ** 2
        of_zero = np.diag(variance)
    covariance = result.covariance + kinematic + of_zero
    sd = np.sqrt(np.diag(covariance))
    biased = len(solution.parameters) > result.base
    alone = Identification(
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

    # a prior of the whole body, or of the foot alone, if they are wanted
    if not np.isfinite(reference).all() or (foot_sd is None and not reference_pulls):
        return alone
    if foot_sd is None or reference_pulls:
        whole = ReferencePrior(reference, compute_reference_sd(reference, reference_sd))
        return _identify_with_reference(alone, regrouping, whole, solve)
    deviations = compute_foot_sd(reference, foot_sd * float(reference[::4].sum()), reference_sd)
    foot = ReferencePrior(reference, deviations)
    if plate_sd is None:
        return _identify_with_reference(alone, regrouping, foot, solve)
    of_plate = propagate_calibration(prepared, alone.fit, alone.base, {"position": plate_sd}).covariance
    moments = np.flatnonzero(prepared.base.kept == FOOT_MOMENT)
    if any(foot.contradicts(alone.base, alone.covariance + of_plate, regrouping, int(one)) for one in moments):
        return alone
    return replace(alone, with_foot=_identify_with_reference(alone, regrouping, foot, solve, of_plate))


def _identify_with_reference(
    alone: Identification,
    regrouping: FloatArray,
    prior: ReferencePrior,
    solve: Callable[[CompressedProblem, FloatArray], Solution],
    of_plate: FloatArray | float = 0.0,
) -> Identification:
    """Identify the parameters from the data and a prior of the full parameters.

    ``of_plate`` (b, b) is the covariance due to errors of the plate. It only reduces the weight of the data relative to
    the prior: the covariance of the result does not contain it, because it is added there later.
    """
    problem = alone.fit.problem.eliminate_others(alone.fit.base)
    independent = np.linalg.inv(problem.factor.T @ problem.factor)
    # the first covariance may be singular: there can be fewer blocks than parameters
    known = alone.covariance + independent + of_plate

    def solve_with_prior(data: CompressedProblem) -> Solution:
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


@dataclass(frozen=True)
class LeftOutPrediction:
    """Predictions of repetitions by models that were fitted without their forces."""

    samples: BoolArray  # (T,) samples of the fit that were left out in a fold and could be predicted
    part: IntArray  # (T,) part (one or several repetitions) of each sample
    # wrench, measured: (T, 3) predicted wrench of the ground, and the measured wrench with the clock offset and the
    # plate bias of the fold, N and N·m; NaN elsewhere
    wrench: FloatArray
    measured: FloatArray
    # filtered, filtered_measured: (T, 3) the same after the low-pass of the fit
    filtered: FloatArray
    filtered_measured: FloatArray
    base: FloatArray  # (K, b) base parameters of each of K folds
    offset: FloatArray  # (K,) clock offset of each fold, with the coarse offset, s


def predict_left_out(
    prepared: PreparedTrial,
    gate: BoolArray,
    result: Fit,
    part: IntArray,
    solve: Callable[[CompressedProblem], FloatArray],
) -> LeftOutPrediction | None:
    """Predict every part of a trial with a model that was fitted to the other parts.

    ``part`` (T,) is from :func:`~mocap_id.dynamics.fit.number_parts`; the weights are those of the whole fit,
    ``result``. ``solve`` returns the consistent parameters (b + k,) of a compressed problem. A part is not predicted if
    the others do not determine the parameters. The result is None if no part is predicted, for example of only one.
    """
    used = np.stack([select_samples(prepared, gate & (part != k)) for k in range(int(part.max()) + 1)])  # (K, T)
    # rows of the fit: columns of the design, then the target; a prior has the same weight in every fold
    rows = np.concatenate([result.design, result.target[..., None]], axis=-1)  # (R, c, b + k + 2)
    prior = np.zeros((0, rows.shape[-1]))
    if result.prior is not None:
        prior = np.column_stack([np.pad(result.prior[0], ((0, 0), (0, 1))), result.prior[1]])
    # samples of the same folds are compressed together
    patterns, pattern = np.unique(used[:, result.samples], axis=1, return_inverse=True)
    factors = [triangularise(rows[pattern == p].reshape(-1, rows.shape[-1])) for p in range(patterns.shape[1])]

    samples, series = np.zeros(len(part), dtype=bool), np.full((4, len(part), 3), np.nan)
    base, offset = [], []
    for k, fold in enumerate(patterns):
        # the fold must determine the base parameters (:func:`mocap_id.dynamics.fit.determines_parameters`)
        stack = triangularise(np.concatenate([prior, *(f for f, has in zip(factors, fold, strict=True) if has)]))
        if used[k].sum() < LEAST_SECONDS * prepared.recorded.rate or len(stack) < stack.shape[1]:
            continue
        columns = stack[:, : result.base]
        size = np.linalg.norm(columns, axis=0)
        if not (np.all(size > 0.0) and np.linalg.cond(columns / size) < DEPENDENT):
            continue
        # The fold's own clock offset: one Gauss-Newton step from that of the whole fit is sufficient, because they
        # differ by a few milliseconds at most. If the whole fit applies no offset, the folds apply none either.
        rate, target = stack[:, -2], stack[:, -1]
        shift = float(np.linalg.lstsq(stack[:, :-1], target, rcond=None)[0][-1]) if result.applied else 0.0
        parameters = solve(CompressedProblem.of(stack[:, :-2], target - shift * rate))
        base.append(parameters[: result.base])
        offset.append(result.offset + shift)
        # the prediction and the measurement of the part that was left out, without and with the low-pass
        out = result.in_fit & (part == k)
        samples |= out
        bias = parameters[result.base :].sum() * np.array([1.0, 0.0, 0.0])
        series[0, out] = prepared.rows[out] @ base[-1]
        series[1, out] = prepared.measured(offset[-1])[out] - bias
        series[2, out] = prepared.filtered[out] @ base[-1]
        stamped = prepared.recorded.time[out] - offset[-1]
        series[3, out] = prepared.filtered_measured(np.flatnonzero(out), stamped) - bias
        series[:2, out] -= prepared.elsewhere(offset[-1])[out]
    if not samples.any():
        return None
    wrench, measured, filtered, filtered_measured = series
    total = np.array(offset) + prepared.recorded.clock.offset
    return LeftOutPrediction(samples, part, wrench, measured, filtered, filtered_measured, np.array(base), total)


Cutoffs = tuple[float, float, float]
_ROUNDS = 2
_LEAST_GAIN = 1e-3  # least decrease of the cost for which the cut-offs are changed


def choose_cutoffs(predict: Callable[[Cutoffs], LeftOutPrediction | None]) -> tuple[Cutoffs, str, float]:
    """Search among :data:`CUTOFFS` for the best cut-offs of x, y and angle, Hz.

    ``predict`` returns predictions of left-out repetitions. The reason for the choice and the cost of
    :func:`score_left_out` are also returned.
    """
    cost = {USUAL: score_left_out(predict(USUAL))}
    best = USUAL
    if not np.isfinite(cost[best]):
        return best, "the default: no repetition could be left out to compare other cut-offs", cost[best]
    for _ in range(_ROUNDS):
        before = best
        for axis, step in product(range(3), (-1, 1)):
            # change one cut-off in one direction as long as the cost decreases
            while 0 <= (k := CUTOFFS.index(best[axis]) + step) < len(CUTOFFS):
                values = list(best)
                values[axis] = CUTOFFS[k]
                tried: Cutoffs = (values[0], values[1], values[2])
                if tried not in cost:
                    cost[tried] = score_left_out(predict(tried))
                if not cost[tried] < cost[best] - _LEAST_GAIN:
                    break
                best = tried
        if best == before:
            break
    return best, "left-out repetitions are predicted best with these", cost[best]


def score_left_out(prediction: LeftOutPrediction | None) -> float:
    """Return the sum of the logarithms of the rms errors of the filtered Fx, Fy and tauz; infinite if None is given."""
    if prediction is None:
        return float("inf")
    off = (prediction.filtered - prediction.filtered_measured)[prediction.samples]
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sum(np.log(np.sqrt(np.mean(off**2, axis=0)) + 1e-9))) if len(off) else float("inf")
