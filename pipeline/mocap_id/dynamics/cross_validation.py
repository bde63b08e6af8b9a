"""Cross-validation within a trial: fit some repetitions and predict the others.

The residual of a fit shows how well the model can follow the fitted samples, but not how well it predicts other
samples. Here every repetition is predicted with parameters, clock offset and plate bias that were fitted without the
forces of this repetition. Joints, joint angles and contact are those of the whole trial.

Nothing is filtered or searched again. The samples are grouped by the folds that use them. A QR decomposition compresses
the weighted rows of each group once; a fold combines the triangular factors of its groups. The rows include the time
derivative of the wrench, with which a clock offset is fitted. Filtered samples close to the left-out repetition (within
`LowPass.reach`) contain a part of it and are not used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import triangularise
from mocap_id.dynamics.fit import DEPENDENT, Fit
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.sample_choice import LEAST_SECONDS, select_samples


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

    A part is not predicted if the other parts do not determine the parameters. The result is None if no part is
    predicted, for example because there is only one.

    Parameters
    ----------
    prepared, gate, result
        The trial, the gate of the whole fit, and the whole fit, whose weights are used.
    part : (T,) int array
        Part of each sample, from :func:`mocap_id.dynamics.sample_choice.number_parts`.
    solve : callable
        Function from a compressed problem of b + k columns to its consistent parameters (b + k,).
    """
    used = np.stack([select_samples(prepared, gate & (part != k)) for k in range(int(part.max()) + 1)])  # (K, T)
    stacks = _compress_folds(result, used[:, result.samples])
    samples, series = np.zeros(len(part), dtype=bool), np.full((4, len(part), 3), np.nan)
    base, offset = [], []
    for k, stack in enumerate(stacks):
        if not _determines_parameters(stack, result, int(used[k].sum()), prepared.recorded.rate):
            continue
        problem, shift = _correct_clock(stack, result)
        parameters, out = solve(problem), result.in_fit & (part == k)
        base.append(parameters[: result.base])
        offset.append(result.offset + shift)
        samples |= out
        bias = parameters[result.base :].sum() * np.array([1.0, 0.0, 0.0])
        for row, (rows, wrench) in enumerate(_select_rows(prepared, out, offset[-1])):
            series[2 * row, out], series[2 * row + 1, out] = rows @ base[-1], wrench - bias
        series[:2, out] -= prepared.elsewhere(offset[-1])[out]
    if not samples.any():
        return None
    wrench, measured, filtered, filtered_measured = series
    total = np.array(offset) + prepared.recorded.clock.offset
    return LeftOutPrediction(samples, part, wrench, measured, filtered, filtered_measured, np.array(base), total)


def _select_rows(prepared: PreparedTrial, out: BoolArray, offset: float) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return two pairs, unfiltered and filtered: regressor (R, 3, b) and total wrench (R, 3) of marked samples."""
    filtered = prepared.filtered_measured(np.flatnonzero(out), prepared.recorded.time[out] - offset)
    return (prepared.rows[out], prepared.measured(offset)[out]), (prepared.filtered[out], filtered)


def _compress_folds(result: Fit, used: BoolArray) -> list[FloatArray]:
    """Return the triangular factor of each fold's rows; ``used`` (K, R) marks the samples of each fold.

    The columns are those of the design, then the target. Samples of the same folds are compressed together.
    """
    rows = np.concatenate([result.design, result.target[..., None]], axis=-1)  # (R, c, b + k + 2)
    prior = np.zeros((0, rows.shape[-1]))
    if result.prior is not None:  # the prior has the same weight in every fold
        prior = np.column_stack([np.pad(result.prior[0], ((0, 0), (0, 1))), result.prior[1]])
    patterns, pattern = np.unique(used, axis=1, return_inverse=True)
    factors = [triangularise(rows[pattern == p].reshape(-1, rows.shape[-1])) for p in range(patterns.shape[1])]
    return [
        triangularise(np.concatenate([prior, *(f for f, has in zip(factors, fold, strict=True) if has)]))
        for fold in patterns
    ]


def _determines_parameters(stack: FloatArray, result: Fit, samples: int, rate: float) -> bool:
    """Return whether a fold determines the base parameters (:func:`mocap_id.dynamics.fit.determines_parameters`)."""
    if samples < LEAST_SECONDS * rate or len(stack) < stack.shape[1]:
        return False
    columns = stack[:, : result.base]
    size = np.linalg.norm(columns, axis=0)
    return bool(np.all(size > 0.0) and np.linalg.cond(columns / np.where(size > 0.0, size, 1.0)) < DEPENDENT)


def _correct_clock(stack: FloatArray, result: Fit) -> tuple[CompressedProblem, float]:
    """Return a fold's problem at the fold's own clock offset, and its difference from the whole fit's offset, s.

    One Gauss-Newton step from the offset of the whole fit is sufficient, because the offsets differ by a few
    milliseconds at most. If the whole fit applies no offset, the folds apply none either.
    """
    rate, target = stack[:, -2], stack[:, -1]
    free = np.linalg.lstsq(stack[:, :-1], target, rcond=None)[0]
    shift = float(free[-1]) if result.applied else 0.0
    return CompressedProblem.of(stack[:, :-2], target - shift * rate), shift
