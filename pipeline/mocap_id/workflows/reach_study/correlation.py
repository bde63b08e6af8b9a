"""Spearman's correlation of a few people: exact p-value, and an interval that is valid for small numbers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from math import factorial, nan

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.workflows.study.statistics import Estimate

FEWEST = 4
"""Smallest number of people for which a correlation is computed."""
_EXACT = 7  # largest number of people for which all orders are compared
_DRAWS, _STEPS = 2000, 81
_SEED = 20


@dataclass(frozen=True)
class Correlation:
    """Spearman's correlation of two variables."""

    estimate: Estimate  # correlation and 95 % interval; NaN for fewer than FEWEST people, or if a variable is constant
    p: float  # two-sided p-value of the hypothesis that there is no correlation; NaN as for the estimate
    people: int  # number of people for whom both variables are known


def correlate_ranks(x: FloatArray, y: FloatArray) -> Correlation:
    """Return Spearman's correlation of two variables (N,); pairs with a NaN are left out.

    The p-value compares all orders of ``y``, or 20,000 random orders for more than seven people. The interval
    contains the correlations of a normal copula for which the observed value is not in the upper or lower 2.5 % of
    samples with the ties of ``x``. A bootstrap fails, because each resample of perfectly ordered people is ordered too.

    Parameters
    ----------
    x : (N,) array
        The variable that may have ties, such as a clinical score.
    y : (N,) array

    Examples
    --------
    >>> result = correlate_ranks(np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.358, 0.270, 0.178, 0.0015]))
    >>> result.estimate.value, round(result.p, 3)
    (-1.0, 0.083)
    """
    known = np.isfinite(x) & np.isfinite(y)
    first, second = _rank(x[known]), _rank(y[known])
    n = int(known.sum())
    if n < FEWEST or np.ptp(first) == 0 or np.ptp(second) == 0:
        return Correlation(Estimate(), nan, n)
    value = float(_correlate(first, second[None])[0])
    return Correlation(Estimate(value, *_find_interval(first, value)), _find_p(first, second, value), n)


def _rank(values: FloatArray) -> FloatArray:
    """Return the ranks (N,) from 1; tied values share the mean of their ranks.

    Examples
    --------
    >>> _rank(np.array([3.0, 1.0, 3.0]))
    array([2.5, 1. , 2.5])
    """
    below = (values[None] < values[:, None]).sum(axis=1)
    same = (values[None] == values[:, None]).sum(axis=1)
    return np.asarray(below + (same + 1) / 2)


def _correlate(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the correlations (K,) of x (N,) with each row of y (K, N)."""
    x, y = x - x.mean(), y - y.mean(axis=1, keepdims=True)
    return np.asarray(np.clip(y @ x / np.sqrt((x @ x) * (y**2).sum(axis=1)), -1, 1).round(12))


def _find_p(x: FloatArray, y: FloatArray, value: float) -> float:
    n = len(x)
    if n <= _EXACT:
        orders = np.array(list(permutations(y)))
        return float((np.abs(_correlate(x, orders)) >= abs(value)).sum() / factorial(n))
    orders = np.random.default_rng(_SEED).permuted(np.tile(y, (10 * _DRAWS, 1)), axis=1)
    return float((1 + (np.abs(_correlate(x, orders)) >= abs(value)).sum()) / (1 + len(orders)))


def _find_interval(x: FloatArray, value: float) -> tuple[float, float]:
    """Return the lowest and highest correlation in the population for which ``value`` is plausible at the ranks x."""
    rng = np.random.default_rng(_SEED)
    hidden = np.sort(rng.standard_normal((_DRAWS, len(x))), axis=1)[:, np.argsort(np.argsort(x, kind="stable"))]
    noise = rng.standard_normal((_DRAWS, len(x)))
    levels = np.linspace(-1, 1, _STEPS)  # Spearman's correlation in the population
    above, below = [], []
    for pearson in 2 * np.sin(np.pi / 6 * levels):
        sample = pearson * hidden + np.sqrt(max(1 - pearson**2, 0.0)) * noise
        drawn = _correlate(x, sample.argsort(axis=1).argsort(axis=1).astype(np.float64))
        above.append(np.mean(drawn >= value))
        below.append(np.mean(drawn <= value))
    possible = levels[(np.array(above) > 0.025) & (np.array(below) > 0.025)]
    return float(possible.min()), float(possible.max())
