"""Samples, weights, and the least-squares fit of clock offset, weights and parameters, with their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.preparation import AnyTrial, erode, profile_offset
from mocap_id.dynamics.regressor import CompressedProblem, estimate_covariance, number_blocks, triangularise

LEAST_SECONDS = 1.0  # least duration of the samples of a fit
_FOLDS = 5  # largest number of folds; if there are more repetitions, neighbouring repetitions are left out together
_RESTING = 0.05  # fraction of a fast joint velocity below which a joint rests
_MOSTLY = 0.5  # fraction of rest above which all rest is left out
_LONG = 0.75  # fraction of rest above which rest is thinned


def select_samples(prepared: AnyTrial, gate: BoolArray) -> BoolArray:
    """Return a mask (T,) of the samples to fit: usable, and within the gate by at least the reach of the filter."""
    return prepared.usable & erode(gate, prepared.lowpass.reach_samples)


def number_parts(time: FloatArray, spans: FloatArray) -> IntArray:
    """Return the number (T,), from 0, of the part of the trial to which each sample belongs.

    A part is one repetition, or several neighbouring ones if there are more than five. ``spans`` (r, 2), s, are in
    order.
    """
    between = (spans[:-1, 1] + spans[1:, 0]) / 2
    repetition = np.searchsorted(between, time)
    folds = min(len(spans), _FOLDS)
    return np.asarray(repetition * folds // max(len(spans), 1), dtype=np.int64)


def skip_long_rests(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the moving samples if the person rests most of the time, otherwise of all samples.

    Of the joint velocities (T, n), rad/s, rests are the slow ones. The errors of a constant posture are the same in all
    its samples, and would outweigh the motion in every mean.
    """
    moving = _find_motion(velocity)
    return moving if len(moving) and moving.mean() < 1 - _MOSTLY else np.ones(len(moving), dtype=np.bool_)


def shorten_rests(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the moving and about as many resting samples if rests are long, else of all samples."""
    moving = _find_motion(velocity)
    if not len(moving) or moving.mean() >= 1 - _LONG:
        return np.ones(len(moving), dtype=np.bool_)
    rest, used = np.flatnonzero(~moving), moving.copy()
    used[rest[:: len(rest) // max(int(moving.sum()), 1)]] = True
    return used


def _find_motion(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the samples in which at least one joint moves."""
    speed = np.abs(velocity).max(axis=1, initial=0.0)
    if not len(speed):
        return np.zeros(0, dtype=np.bool_)
    # if a person rests most of the time, the quantile is only sway
    fast = max(np.quantile(speed, 0.95), 0.5 * speed.max())
    return np.asarray(speed >= _RESTING * fast)


MEMORIES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
"""Candidates for the length of recording that counts as one independent sample, s."""
REFERENCE = 0.4
"""This length while the weights of the components are estimated, and if too few repetitions can be left out, s."""
Rows: TypeAlias = tuple[FloatArray, FloatArray]  # rows (r, b) and right-hand side (r,) of a least-squares problem
_LEAST_FOLDS = 3  # fewer give no useful standard error


def estimate_memory(
    prepared: AnyTrial,
    gate: BoolArray,
    samples: IntArray,
    *,
    rows: FloatArray,
    target: FloatArray,
    prior: Rows,
) -> float:
    """Return the length of recording that counts as one independent sample, s, from repetitions left out in turn.

    ``rows`` (R, c, b) and ``target`` (R, c) are divided by the spread of each component's residual. Without a prior,
    and if fewer than three parts can be left out, the result is :data:`REFERENCE`.
    """
    if prepared.prior is None or len(prepared.prior.spans) < _LEAST_FOLDS:
        return REFERENCE
    apart = prepared.lowpass.step / prepared.recorded.rate
    part = number_parts(prepared.recorded.time, prepared.prior.spans)
    errors = []
    for k in np.unique(part[samples]).tolist():
        fitted = select_samples(prepared, gate & (part != k))[samples]
        if apart * fitted.sum() >= LEAST_SECONDS:
            errors.append(score_memories(rows, target, prior, apart=apart, fitted=fitted, predicted=part[samples] == k))
    return choose_memory(np.array(errors)) if len(errors) >= _LEAST_FOLDS else REFERENCE


def choose_memory(errors: FloatArray) -> float:
    """Return the longest memory whose mean of ``errors`` (K, M) is within one standard error of the least mean."""
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    allowed = mean[best] + errors[:, best].std(ddof=1) / np.sqrt(len(errors))
    return MEMORIES[int(np.flatnonzero(mean <= allowed)[-1])]


def score_memories(
    rows: FloatArray,
    target: FloatArray,
    prior: Rows,
    *,
    apart: float,
    fitted: BoolArray,
    predicted: BoolArray,
) -> FloatArray:
    """Return the mean squared error (M,) in the ``predicted`` samples of fits to the ``fitted``, for each memory."""
    data = np.concatenate([rows[fitted], target[fitted, :, None]], axis=-1).reshape(-1, rows.shape[-1] + 1)
    known = np.column_stack(prior)
    share = np.minimum(1.0, apart / np.array(MEMORIES))[:, None, None]
    normal = share * (data.T @ data) + known.T @ known  # (M, b + 1, b + 1)
    parameters = np.linalg.solve(normal[:, :-1, :-1], normal[:, :-1, -1:])[..., 0]
    off = rows[predicted] @ parameters.T - target[predicted, :, None]
    return np.asarray(np.mean(off**2, axis=(0, 1)))


_ROUNDS = 2  # weights and offset depend on each other only weakly
DEPENDENT = 1e8  # condition number with unit columns above which the columns count as linearly dependent
_SHARP = 0.01  # s: an offset with a larger standard deviation is not applied
_LEAST_BLOCKS = 3  # smallest number of blocks for the drift of the clock
_LEAST_SPREAD = 1e-4  # fraction of a component's rms: smaller residuals are due to rounding


@dataclass(frozen=True)
class Fit:
    """Unconstrained least-squares fit on chosen samples."""

    in_fit: BoolArray  # (T,) usable samples within the gate, away from its edges (`select_samples`)
    samples: IntArray  # (R,) indices of the samples used in the fit: every `LowPass.step`-th of `in_fit`
    base: int  # number of base parameters b; the k nuisance parameters (constant errors of the plate) follow them
    # best_offset, offset_sd: clock offset with the least residual, from the coarse offset, and its standard deviation
    # from the residuals, s. At the limit of the search there is no minimum.
    best_offset: float
    offset_sd: float
    offset: float  # clock offset used in the fit, s: `best_offset`, or 0 if it is not applied or not known
    total_offset: float  # coarse clock offset plus `best_offset`: the offset between cameras and plates, s
    sharp: bool  # whether there is a minimum within the search's limit, with a standard deviation below 10 ms
    offset_known: bool  # whether there is such a minimum, and no doubt about the coarse offset
    applied: bool  # whether `best_offset` is used in the fit
    # (c,) inverse residual spread of each component. With a prior, it is multiplied by the square root of the fraction
    # of independent samples (`estimate_memory`).
    weights: FloatArray
    problem: CompressedProblem  # weighted rows of b + k columns, with the prior
    # (R, c, b + k + 1) weighted rows. The last column is the time derivative of the wrench, because a clock offset
    # shifts the wrench in time.
    design: FloatArray
    target: FloatArray  # (R, c) weighted, filtered wrench at `offset`
    # (b + k + 1, b + k + 1) covariance of base parameters, nuisance parameters and offset from the residuals, with the
    # prior
    covariance: FloatArray
    # condition, condition_scaled: condition number of the filtered rows of the base parameters, in SI units and with
    # unit columns
    condition: float
    condition_scaled: float
    # rows (p, b + k) and right-hand side (p,) of the prior; None without a prior
    prior: Rows | None = None

    def response(self, wrench: FloatArray) -> FloatArray:
        """Return the change (b + k + 1, s) of the solution due to s weighted errors (R, c, s) of the wrench."""
        rows = self.design.reshape(-1, self.design.shape[-1])
        factor = triangularise(np.concatenate([rows, self._prior_rows]))
        half = solve_triangular(factor, rows.T @ wrench.reshape(len(rows), -1), trans="T")
        return np.asarray(solve_triangular(factor, half))

    @property
    def prior_precision(self) -> FloatArray:
        """Precision matrix (b + k + 1, b + k + 1) of the prior; zeros without a prior."""
        return np.asarray(self._prior_rows.T @ self._prior_rows)

    @property
    def _prior_rows(self) -> FloatArray:
        return np.zeros((0, self.design.shape[-1])) if self.prior is None else np.pad(self.prior[0], ((0, 0), (0, 1)))


def estimate_drift(prepared: AnyTrial, result: Fit) -> tuple[float, float]:
    """Return how fast the clock offset changes during the trial, and its standard deviation, s/s, to first order.

    Both are NaN if the fit determines no offset, or if its samples are in fewer than three blocks.
    """
    time = prepared.recorded.time[result.samples]
    blocks = number_blocks(time, prepared.settings.block)
    if not result.sharp or int(blocks.max(initial=0)) < _LEAST_BLOCKS - 1:
        return float("nan"), float("nan")
    late = prepared.recorded.time[result.samples] - time.mean()
    rows = np.concatenate([result.design, result.design[..., -1:] * late[:, None, None]], axis=-1)
    prior = None if result.prior is None else (np.pad(result.prior[0], ((0, 0), (0, 2))), result.prior[1])
    solution = _compress(rows, result.target, prior).free_solution()
    spread = 1.0 if prepared.prior is None else prepared.prior.spread
    more = None if prior is None else prior[0]
    covariance = estimate_covariance(rows, result.target - rows @ solution, blocks, more, spread)
    return float(solution[-1]), float(np.sqrt(covariance[-1, -1]))


def determines_parameters(prepared: AnyTrial, gate: BoolArray) -> bool:
    """Return whether the gated samples last at least a second and determine the base parameters."""
    chosen = select_samples(prepared, gate)
    if chosen.sum() < LEAST_SECONDS * prepared.recorded.rate:
        return False
    if prepared.prior is not None:
        return True
    # the columns of the regressor must be independent, which they are not if a joint rests in all samples
    rows = prepared.filtered[np.flatnonzero(chosen)[:: prepared.lowpass.step]]
    return compute_conditions(rows[:, list(prepared.settings.components)])[1] < DEPENDENT


def fit(prepared: AnyTrial, gate: BoolArray, like: Fit | None = None) -> Fit:
    """Fit base parameters, plate bias and clock offset to the gated samples.

    If ``like`` is given, a fit of the same trial, its clock offset and weights are used instead of new ones.
    """
    settings, components = prepared.settings, list(prepared.settings.components)
    in_fit = select_samples(prepared, gate)
    samples = np.flatnonzero(in_fit)[:: prepared.lowpass.step]
    time = prepared.recorded.time[samples]

    # Rows (R, c, b + k): filtered base columns, then a column for each constant error of the plate. A constant error
    # of Fx can be estimated, because gravity causes no constant Fx. A constant error of Fy or tauz has the same column
    # as m1 or mx1. It cannot be separated from these parameters, so they contain it.
    design = prepared.filtered[samples][:, components, :]
    base = design.shape[-1]
    if prepared.constants:
        bias = np.zeros((*design.shape[:2], len(prepared.constants)))
        for column, component in enumerate(prepared.constants):
            bias[:, components.index(component), column] = 1.0
        design = np.concatenate([design, bias], axis=-1)
    prior = None if prepared.prior is None else prepared.prior.rows(design.shape[-1])

    def sample_wrench(stamped: FloatArray) -> FloatArray:
        """Return the fitted components of the filtered wrench at times on the plates' clock, s."""
        return prepared.filtered_measured(samples, stamped)[..., components]

    def estimate_weights(target: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the next ``spread`` (c,), 1 / (standard deviation of the residual), and the weights to fit with.

        Without a prior, both are the same. With a prior, they are multiplied by the square root of the fraction of the
        samples that are independent: the first for :data:`REFERENCE`, the second for :func:`estimate_memory`.
        """
        weighted, aim = design * spread[:, None], target * spread
        residual = (aim - weighted @ _compress(weighted, aim, prior).free_solution()) / spread
        floor = _LEAST_SPREAD * np.sqrt(np.mean(target**2, axis=0))
        inverse = np.asarray(1.0 / np.maximum(residual.std(axis=0), floor))
        if prior is None:
            return inverse, inverse
        apart = prepared.lowpass.step / prepared.recorded.rate
        usual = np.sqrt(min(1.0, apart / REFERENCE))
        first = inverse * usual
        inverse = first / usual
        rows, target = design * inverse[:, None], target * inverse
        seconds = estimate_memory(prepared, gate, samples, rows=rows, target=target, prior=prior)
        return first, np.asarray(inverse * np.sqrt(min(1.0, apart / seconds)))

    def estimate_covariance_of_all(target: FloatArray, offset: float) -> tuple[FloatArray, FloatArray]:
        """Return weighted rows with the column of the offset, and the covariance from the residuals of ``target``."""
        rate = prepared.filtered_wrench(time - offset, derivative=1)[:, components]
        weighted = design * weights[:, None]
        extended = np.concatenate([weighted, (rate * weights)[..., None]], axis=-1)
        residual = target - weighted @ _compress(weighted, target, prior).free_solution()
        blocks = number_blocks(time, settings.block)
        more = None if prior is None else np.pad(prior[0], ((0, 0), (0, 1)))
        wider = 1.0 if prepared.prior is None else prepared.prior.spread
        return extended, estimate_covariance(extended, residual, blocks, more, wider)

    # weights and clock offset in turns
    weights = spread = np.ones(len(components))
    best_offset, known = 0.0, False
    if like is not None:
        weights, best_offset, known = like.weights, like.best_offset, like.sharp
        spread = weights
    else:
        for _ in range(_ROUNDS):
            limit = settings.offset_limit
            best_offset, at_edge = profile_offset(design, sample_wrench, time, weights, limit, prior=prior)
            known = not at_edge
            spread, weights = estimate_weights(sample_wrench(time - best_offset), spread)

    # the covariance shows whether the movement determines the offset; otherwise, everything is fitted without it
    offset = best_offset
    target = sample_wrench(time - offset) * weights
    extended, covariance = estimate_covariance_of_all(target, offset)
    offset_sd = float(np.sqrt(covariance[-1, -1]))
    known = known and offset_sd < _SHARP
    applied = known and settings.apply_offset
    if not applied:
        offset, target = 0.0, sample_wrench(time)
        spread, weights = estimate_weights(target, spread)
        target = target * weights
        extended, covariance = estimate_covariance_of_all(target, offset)
    condition, condition_scaled = compute_conditions(design[..., :base])
    return Fit(
        in_fit=in_fit,
        samples=samples,
        base=base,
        best_offset=best_offset,
        offset_sd=offset_sd,
        offset=offset,
        total_offset=prepared.recorded.clock.offset + best_offset,
        sharp=known,
        offset_known=known and prepared.recorded.clock.doubt is None,
        applied=applied,
        weights=weights,
        problem=_compress(extended[..., :-1], target, prior),
        design=extended,
        target=target,
        covariance=covariance,
        condition=condition,
        condition_scaled=condition_scaled,
        prior=prior,
    )


def _compress(design: FloatArray, target: FloatArray, prior: Rows | None) -> CompressedProblem:
    """Return the compressed problem of weighted rows (R, c, b + k), their right-hand side (R, c) and the prior."""
    rows, aim = design.reshape(-1, design.shape[-1]), target.reshape(-1)
    if prior is not None:
        rows, aim = np.concatenate([rows, prior[0]]), np.concatenate([aim, prior[1]])
    return CompressedProblem.of(rows, aim)


def compute_conditions(rows: FloatArray) -> tuple[float, float]:
    """Return the 2-norm condition numbers of stacked rows (R, c, b), in SI units and with unit columns."""
    factor = triangularise(rows.reshape(-1, rows.shape[-1]))
    size = np.linalg.norm(factor, axis=0)
    return float(np.linalg.cond(factor)), float(np.linalg.cond(factor / np.where(size > 0.0, size, 1.0)))
