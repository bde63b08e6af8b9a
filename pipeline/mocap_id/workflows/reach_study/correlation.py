"""Spearman's correlation of a few people: exact p-value, and an interval that holds for small numbers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from math import factorial, nan

import numpy as np

from mocap_id.arrays import FloatArray

FEWEST = 4
"""Smallest number of people of whom a correlation is computed."""
_EXACT = 7  # largest number of people of whom all orders are compared
_DRAWS, _STEPS = 2000, 81
_SEED = 20


@dataclass(frozen=True)
class Correlation:
    """Spearman's correlation.

    Parameters
    ----------
    value : float
        NaN for fewer than :data:`FEWEST` people, or where all values are the same.
    interval : (low, high)
        95 % interval of the correlation in the population.
    p : float
        Two-sided p-value against no correlation.
    people : int
    """

    value: float
    interval: tuple[float, float]
    p: float
    people: int


def spearman(x: FloatArray, y: FloatArray) -> Correlation:
    """Return Spearman's correlation of two variables (N,), NaN left out.

    The p-value compares all orders of ``y``, or 20,000 random ones for more than seven people. The interval
    contains the correlations of a normal copula for which the observed value is not in the upper or lower 2.5 % of
    samples with the ties of ``x``. A bootstrap would fail: if a few people are in perfect order, so is every resample.

    Parameters
    ----------
    x : (N,) array
        May have ties, such as a clinical score.
    y : (N,) array

    Examples
    --------
    >>> found = spearman(np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.358, 0.270, 0.178, 0.0015]))
    >>> found.value, round(found.p, 3)
    (-1.0, 0.083)
    """
    known = np.isfinite(x) & np.isfinite(y)
    first, second = ranks(x[known]), ranks(y[known])
    n = int(known.sum())
    if n < FEWEST or np.ptp(first) == 0 or np.ptp(second) == 0:
        return Correlation(nan, (nan, nan), nan, n)
    value = float(_correlation(first, second[None])[0])
    return Correlation(value, _interval(first, value), _p(first, second, value), n)


def ranks(values: FloatArray) -> FloatArray:
    """Return the ranks (N,) from 1; ties share the mean of their ranks.

    Examples
    --------
    >>> ranks(np.array([3.0, 1.0, 3.0]))
    array([2.5, 1. , 2.5])
    """
    below = (values[None] < values[:, None]).sum(axis=1)
    same = (values[None] == values[:, None]).sum(axis=1)
    return np.asarray(below + (same + 1) / 2)


def _correlation(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the correlation of x (N,) with each row of y (K, N)."""
    x, y = x - x.mean(), y - y.mean(axis=1, keepdims=True)
    return np.asarray(np.clip(y @ x / np.sqrt((x @ x) * (y**2).sum(axis=1)), -1, 1).round(12))


def _p(x: FloatArray, y: FloatArray, value: float) -> float:
    n = len(x)
    if n <= _EXACT:
        orders = np.array(list(permutations(y)))
        return float((np.abs(_correlation(x, orders)) >= abs(value)).sum() / factorial(n))
    orders = np.random.default_rng(_SEED).permuted(np.tile(y, (10 * _DRAWS, 1)), axis=1)
    return float((1 + (np.abs(_correlation(x, orders)) >= abs(value)).sum()) / (1 + len(orders)))


def _interval(x: FloatArray, value: float) -> tuple[float, float]:
    """Return the correlations under which the value is in the upper or lower 2.5 % of samples with these ranks x."""
    rng = np.random.default_rng(_SEED)
    hidden = np.sort(rng.standard_normal((_DRAWS, len(x))), axis=1)[:, np.argsort(np.argsort(x, kind="stable"))]
    noise = rng.standard_normal((_DRAWS, len(x)))
    levels = np.linspace(-1, 1, _STEPS)  # of Spearman's correlation in the population
    above, below = [], []
    for pearson in 2 * np.sin(np.pi / 6 * levels):
        sample = pearson * hidden + np.sqrt(max(1 - pearson**2, 0.0)) * noise
        drawn = _correlation(x, sample.argsort(axis=1).argsort(axis=1).astype(np.float64))
        above.append(np.mean(drawn >= value))
        below.append(np.mean(drawn <= value))
    possible = levels[(np.array(above) > 0.025) & (np.array(below) > 0.025)]
    return float(possible.min()), float(possible.max())
