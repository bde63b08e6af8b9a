"""Cross-validation within a trial: fit some repetitions and predict the others.

The error on the samples of a fit shows how well the model can follow them, and not how well it predicts others. Here
every repetition is predicted by parameters, clock offset and plate bias that were fitted without its forces. Joints,
joint angles and contact are those of the whole trial.

Nothing is filtered or searched again. A QR decomposition compresses the filtered, weighted rows of the whole fit once
for each set of samples that belongs to the same folds; a fold stacks the triangular factors of its sets. The rows
include the column along which a clock offset shifts the wrench. Samples within the filter's reach of the left-out
repetition contain a part of it and are not used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import triangular_factor
from mocap_id.dynamics.fit import DEPENDENT, Fit
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.left_out_samples import LEAST_SECONDS, samples_without_part
from mocap_id.dynamics.preparation import PreparedTrial


@dataclass(frozen=True)
class LeftOutPrediction:
    """Predictions of repetitions by models that were fitted without their forces.

    Parameters
    ----------
    samples : (T,) bool array
        Samples of the fit that were predicted: those of all folds with a determined model.
    part : (T,) int array
        Part of each sample.
    wrench, measured : (T, 3) arrays
        Predicted wrench of the ground, and the measured one with the clock offset and the plate bias of the fold, N and
        N·m; NaN elsewhere.
    filtered, filtered_measured : (T, 3) arrays
        The same after the low-pass of the fit.
    base : (K, b) array
        Base parameters of each fold.
    offset : (K,) array
        Clock offset of each fold, s.
    """

    samples: BoolArray
    part: IntArray
    wrench: FloatArray
    measured: FloatArray
    filtered: FloatArray
    filtered_measured: FloatArray
    base: FloatArray
    offset: FloatArray


def predict_left_out(
    prepared: PreparedTrial,
    gate: BoolArray,
    found: Fit,
    part: IntArray,
    solve: Callable[[CompressedProblem], FloatArray],
) -> LeftOutPrediction | None:
    """Predict every part by a model that was fitted to the others.

    Parameters
    ----------
    prepared : PreparedTrial
    gate : (T,) bool array
        Gate of the whole fit.
    found : Fit
        The whole fit, whose weights are used.
    part : (T,) int array
        Part of each sample, from :func:`mocap_id.dynamics.left_out_samples.number_parts`.
    solve : callable
        From a compressed problem of b + k columns to its consistent parameters (b + k,).

    Returns
    -------
    LeftOutPrediction or None
        None if no part can be left out: there is only one, or the others do not determine the parameters.
    """
    used = np.stack([samples_without_part(prepared, gate, part, k) for k in range(int(part.max()) + 1)])  # (K, T)
    stacks = _stacks(found, used[:, found.samples])
    samples, series = np.zeros(len(part), dtype=bool), np.full((4, len(part), 3), np.nan)
    base, offset = [], []
    for k, stack in enumerate(stacks):
        if not _determined(stack, found, int(used[k].sum()), prepared.recorded.rate):
            continue
        problem, shift = _at_own_clock(stack, found)
        parameters, out = solve(problem), found.in_fit & (part == k)
        base.append(parameters[: found.base])
        offset.append(found.offset + shift)
        samples |= out
        bias = parameters[found.base :].sum() * np.array([1.0, 0.0, 0.0])
        for row, (rows, wrench) in enumerate(_sides(prepared, out, offset[-1])):
            series[2 * row, out], series[2 * row + 1, out] = rows @ base[-1], wrench - bias
        elsewhere = prepared.elsewhere(offset[-1])[out]
        series[:2, out] -= elsewhere
    if not samples.any():
        return None
    wrench, measured, filtered, filtered_measured = series
    return LeftOutPrediction(
        samples, part, wrench, measured, filtered, filtered_measured, np.array(base), np.array(offset)
    )


def _sides(prepared: PreparedTrial, out: BoolArray, offset: float) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return the regressor (R, 3, b) and total wrench (R, 3) at some samples (T,), unfiltered and filtered."""
    filtered = prepared.filtered_measured(np.flatnonzero(out), prepared.recorded.time[out] - offset)
    return (prepared.rows[out], prepared.measured(offset)[out]), (prepared.filtered[out], filtered)


def _stacks(found: Fit, used: BoolArray) -> list[FloatArray]:
    """Return the triangular factor of each fold's rows; ``used`` (K, R) are the samples of each fold.

    The columns are those of the design, then the target. Samples of the same folds are compressed together.
    """
    rows = np.concatenate([found.design, found.target[..., None]], axis=-1)  # (R, c, b + k + 2)
    prior = np.zeros((0, rows.shape[-1]))
    if found.prior is not None:  # it counts in every fold as in the whole fit
        prior = np.column_stack([np.pad(found.prior[0], ((0, 0), (0, 1))), found.prior[1]])
    patterns, pattern = np.unique(used, axis=1, return_inverse=True)
    factors = [triangular_factor(rows[pattern == p].reshape(-1, rows.shape[-1])) for p in range(patterns.shape[1])]
    return [
        triangular_factor(np.concatenate([prior, *(f for f, has in zip(factors, fold, strict=True) if has)]))
        for fold in patterns
    ]


def _determined(stack: FloatArray, found: Fit, samples: int, rate: float) -> bool:
    """Return whether a fold determines the base parameters, by the rule of :func:`mocap_id.dynamics.fit.determined`."""
    if samples < LEAST_SECONDS * rate or len(stack) < stack.shape[1]:
        return False
    columns = stack[:, : found.base]
    size = np.linalg.norm(columns, axis=0)
    return bool(np.all(size > 0.0) and np.linalg.cond(columns / np.where(size > 0.0, size, 1.0)) < DEPENDENT)


def _at_own_clock(stack: FloatArray, found: Fit) -> tuple[CompressedProblem, float]:
    """Return a fold's problem at its own clock offset, and the difference of this from the whole fit's offset, s.

    One Gauss-Newton step from the offset of the whole fit is sufficient, since the offsets differ by a few milliseconds
    at most. If the whole fit applies no offset, the folds apply none either.
    """
    rate, target = stack[:, -2], stack[:, -1]
    free = np.linalg.lstsq(stack[:, :-1], target, rcond=None)[0]
    shift = float(free[-1]) if found.applied else 0.0
    return CompressedProblem.of(stack[:, :-2], target - shift * rate), shift
