"""Weight of the data relative to the prior, from the length of recording that counts as one independent sample.

Errors of poses are correlated over time and recur in every repetition. The residuals contain only the part that the
parameters have not absorbed, so they do not give the number of independent samples. The one-standard-error rule
(Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 7.10) selects the strongest prior that predicts
left-out repetitions well.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.preparation import AnyTrial
from mocap_id.dynamics.sample_choice import LEAST_SECONDS, number_parts, select_samples

MEMORIES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
"""Candidates for the length of recording that counts as one independent sample, s."""
REFERENCE = 0.4
"""Length of recording that counts as one independent sample, s, while the weights of the components are estimated, and
if too few repetitions can be left out.
"""
_LEAST_FOLDS = 3  # fewer give no useful standard error


def estimate_memory(
    prepared: AnyTrial,
    gate: BoolArray,
    samples: IntArray,
    *,
    rows: FloatArray,
    target: FloatArray,
    prior: tuple[FloatArray, FloatArray],
) -> float:
    """Return the length of recording that counts as one independent sample, s.

    It is :data:`REFERENCE` if fewer than three parts can be left out.

    Parameters
    ----------
    prepared : AnyTrial
        Trial with a prior, whose repetitions are left out in turn.
    samples : (R,) int array
        Indices of the samples used in the fit.
    rows, target : (R, c, b) and (R, c) arrays
        Rows of the fit and the wrench, each component divided by the spread of its residual.
    prior : ((p, b) array, (p,) array)
        Rows and right-hand side of the prior, in standard deviations.
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
    """Return the longest of :data:`MEMORIES` whose error is within one standard error of the least error.

    ``errors`` (K, M) is the mean squared error of each left-out part for each of these times.
    """
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    allowed = mean[best] + errors[:, best].std(ddof=1) / np.sqrt(len(errors))
    return MEMORIES[int(np.flatnonzero(mean <= allowed)[-1])]


def score_memories(
    rows: FloatArray,
    target: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    *,
    apart: float,
    fitted: BoolArray,
    predicted: BoolArray,
) -> FloatArray:
    """Return the mean squared error (M,) of a fit in left-out samples, for each of :data:`MEMORIES`.

    ``fitted`` and ``predicted`` (R,) mark the samples to fit and to predict, and ``apart`` is the time from one sample
    to the next, s. The other arguments are those of :func:`estimate_memory`.
    """
    data = np.concatenate([rows[fitted], target[fitted, :, None]], axis=-1).reshape(-1, rows.shape[-1] + 1)
    known = np.column_stack(prior)
    share = np.minimum(1.0, apart / np.array(MEMORIES))[:, None, None]
    normal = share * (data.T @ data) + known.T @ known  # (M, b + 1, b + 1)
    parameters = np.linalg.solve(normal[:, :-1, :-1], normal[:, :-1, -1:])[..., 0]
    off = rows[predicted] @ parameters.T - target[predicted, :, None]
    return np.asarray(np.mean(off**2, axis=(0, 1)))
