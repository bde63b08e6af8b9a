"""How much of the recording counts as one sample against the prior, so that left-out repetitions are predicted well.

Errors of poses last, and return in every repetition. Residuals show only what the parameters have not taken up of
them, and so do not tell how many samples are independent. How well left-out repetitions are predicted hardly depends on
the prior's weight over a wide range. The one-standard-error rule (Hastie, Tibshirani and Friedman, The Elements of
Statistical Learning, 7.10) takes the strongest prior that they do not speak against.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.folds import LEAST_SECONDS, parts, without
from mocap_id.dynamics.prepare import Prepared

MEMORIES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
"""Time of the recording that may count as one sample, s."""
REFERENCE = 0.4
"""What counts as one sample where the spreads of the residuals are found, and where too little can be left out, s."""
_LEAST_FOLDS = 3  # two give no standard error to speak of


def left_out_memory(
    prepared: Prepared,
    gate: BoolArray,
    samples: IntArray,
    *,
    rows: FloatArray,
    target: FloatArray,
    prior: tuple[FloatArray, FloatArray],
) -> float:
    """Time of the recording that counts as one sample, s.

    :data:`REFERENCE` where fewer than three parts can be left out.

    Parameters
    ----------
    prepared : Prepared
        With a prior, whose repetitions are left out in turn.
    gate : (T,) bool array
        Samples where the ground is all that the body touches.
    samples : (R,) int array
        Those of the fit.
    rows, target : (R, c, b) and (R, c) arrays
        The fit's rows there and the wrench, every component over the spread of its residual.
    prior : ((p, b) array, (p,) array)
        Rows and right-hand side, one standard deviation each.
    """
    if prepared.prior is None or len(prepared.prior.spans) < _LEAST_FOLDS:
        return REFERENCE
    apart = prepared.step / prepared.recorded.rate
    part = parts(prepared.recorded.time, prepared.prior.spans)
    errors = []
    for k in np.unique(part[samples]).tolist():
        fitted = without(prepared, gate, part, k)[samples]
        if apart * fitted.sum() >= LEAST_SECONDS:
            errors.append(left_out_error(rows, target, prior, apart=apart, fitted=fitted, predicted=part[samples] == k))
    return choose_memory(np.array(errors)) if len(errors) >= _LEAST_FOLDS else REFERENCE


def choose_memory(errors: FloatArray) -> float:
    """The longest memory whose error is within one standard error of the least one.

    Parameters
    ----------
    errors : (K, M) array
        Mean squared error on each left-out repetition with each of :data:`MEMORIES`.
    """
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    allowed = mean[best] + errors[:, best].std(ddof=1) / np.sqrt(len(errors))
    return MEMORIES[int(np.flatnonzero(mean <= allowed)[-1])]


def left_out_error(
    rows: FloatArray,
    target: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    *,
    apart: float,
    fitted: BoolArray,
    predicted: BoolArray,
) -> FloatArray:
    """Mean squared error (M,) of a fit on the samples that it did not see, with each of :data:`MEMORIES`.

    Parameters
    ----------
    rows, target, prior
        As in :func:`left_out_memory`.
    apart : float
        Time from one row to the next, s.
    fitted, predicted : (R,) bool arrays
        Rows to fit to and rows to predict.
    """
    seen = np.concatenate([rows[fitted], target[fitted, :, None]], axis=-1).reshape(-1, rows.shape[-1] + 1)
    known = np.column_stack(prior)
    share = np.minimum(1.0, apart / np.array(MEMORIES))[:, None, None]
    normal = share * (seen.T @ seen) + known.T @ known  # (M, b + 1, b + 1)
    found = np.linalg.solve(normal[:, :-1, :-1], normal[:, :-1, -1:])[..., 0]
    off = rows[predicted] @ found.T - target[predicted, :, None]
    return np.asarray(np.mean(off**2, axis=(0, 1)))
