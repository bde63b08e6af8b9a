"""How many of a fit's samples are independent: errors of poses last, and return in every repetition."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

_LAGS = 1.0  # s; errors of poses last a tenth of that
_PHASES = 101


def memory(time: FloatArray, residual: FloatArray, spans: FloatArray) -> FloatArray:
    """Time of the recording that counts as one independent sample, by component.

    It is the integrated autocorrelation time of the residuals, τ = Δt (1 + 2 Σ ρ(k)) up to the first ρ(k) that is not
    positive, times the design effect 1 + (r - 1) ρ_r of r repetitions, with ρ_r the correlation of the residuals of two
    repetitions at the same phase.

    Parameters
    ----------
    time : (R,) array
        s, even steps but for what is left out.
    residual : (R, c) array
        At these times.
    spans : (r, 2) array
        First and last time of every repetition, s.

    Returns
    -------
    (c,) array
        s.
    """
    step = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / step).astype(np.int64)
    even = np.full((place[-1] + 1, residual.shape[1]), np.nan)
    even[place] = residual
    lasting = np.array([step * _sum_of_positive(_autocorrelation(one, round(_LAGS / step))) for one in even.T])
    returning = np.array([_returning(time[0] + step * np.arange(len(even)), one, spans) for one in even.T])
    return np.asarray(lasting * (1.0 + max(len(spans) - 1, 0) * returning))


def _autocorrelation(series: FloatArray, lags: int) -> FloatArray:
    """At lags 0 … of a series (T,) about zero; NaN is missing."""
    seen = np.isfinite(series)
    known = np.where(seen, series, 0.0)
    covariance = [
        float(known[k:] @ known[: len(known) - k]) / max(int(np.sum(seen[k:] & seen[: len(seen) - k])), 1)
        for k in range(min(lags, len(series) - 1) + 1)
    ]
    return np.array(covariance) / max(covariance[0], float(np.finfo(np.float64).tiny))


def _sum_of_positive(correlation: FloatArray) -> float:
    """1 + 2 Σ ρ(k) up to the first that is not positive."""
    ends = np.flatnonzero(correlation <= 0.0)
    return max(float(2.0 * np.sum(correlation[: ends[0] if len(ends) else None]) - 1.0), 1.0)


def _returning(time: FloatArray, series: FloatArray, spans: FloatArray) -> float:
    """Correlation of a series (T,) between two repetitions at the same phase, 0 … 1."""
    if len(spans) < 2:
        return 0.0
    phase = np.linspace(0.0, 1.0, _PHASES)
    each = np.array([np.interp(start + (end - start) * phase, time, series) for start, end in spans])
    first, second = (each[index] for index in np.triu_indices(len(each), 1))
    both = np.isfinite(first * second)
    product, size = (np.sum(values[both]) for values in (first * second, first**2 + second**2))
    return float(np.clip(2.0 * product / size, 0.0, 1.0)) if size > 0.0 else 0.0
