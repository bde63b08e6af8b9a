"""Means, standard deviations, intervals and p-values of numbers, some of which may be missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import factorial, nan
from typing import TypeVar

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.comparison import Agreement

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
_EXACT = 14  # largest number of people for which all signs are compared
_DRAWS, _SEED = 20_000, 20


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % interval; NaN if unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def minus(self, other: Estimate) -> Estimate:
        """Return this estimate minus ``other``, with an interval that assumes independent errors."""
        value = self.value - other.value
        below = math.hypot(self.value - self.low, other.high - other.value)
        above = math.hypot(self.high - self.value, other.value - other.low)
        return Estimate(value, value - below, value + above)

    def columns(self, name: str) -> dict[str, float]:
        """Return the columns ``name``, ``name_low`` and ``name_high``."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def average_estimates(estimates: Iterable[Estimate]) -> Estimate:
    """Return the mean of the known estimates; its interval assumes that all estimates have the same error.

    Examples
    --------
    >>> average_estimates([Estimate(0.2, 0.1, 0.3), Estimate(0.4, 0.3, 0.5), Estimate()])
    Estimate(value=0.30000000000000004, low=0.2, high=0.4)
    """
    rows = np.array([(one.value, one.low, one.high) for one in estimates if math.isfinite(one.value)])
    return Estimate(*rows.mean(axis=0).tolist()) if len(rows) else Estimate()


def average_people(values: Sequence[float]) -> Estimate:
    """Return the mean of the people's values with Student's interval, which is NaN for one person.

    Examples
    --------
    >>> average_people([1.0, 2.0, 3.0]).value
    2.0
    """
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if not n:
        return Estimate()
    half = float(stdtrit(n - 1, 0.975) * array.std(ddof=1) / np.sqrt(n)) if n > 1 else math.nan
    mean = float(array.mean())
    return Estimate(mean, mean - half, mean + half)


def sign_flip_p(differences: Sequence[float]) -> float:
    """Return the two-sided permutation p-value of the hypothesis that the differences have no preferred sign.

    All combinations of signs are compared, or 20,000 random combinations for more than 14 people. NaN for one person.

    Examples
    --------
    >>> sign_flip_p([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])  # 2 of 64
    0.03125
    """
    array = np.asarray(differences, dtype=np.float64)
    n = len(array)
    if n < 2:
        return math.nan
    least = abs(array.sum()) - 1e-12 * np.abs(array).sum()
    if n <= _EXACT:
        signs = np.array(list(product((-1.0, 1.0), repeat=n)))
        return float(np.mean(np.abs(signs @ array) >= least))
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], (_DRAWS, n))
    return float((1 + (np.abs(signs @ array) >= least).sum()) / (1 + _DRAWS))


def mean_sd(values: Iterable[float | None]) -> tuple[float, float]:
    """Return mean and sample standard deviation (n − 1) of the known values; NaN if there are too few values.

    Examples
    --------
    >>> mean_sd([1.0, None, 3.0])
    (2.0, 1.4142135623730951)
    """
    known = np.array([value for value in values if value is not None and math.isfinite(value)])
    mean = float(known.mean()) if len(known) else math.nan
    return mean, float(known.std(ddof=1)) if len(known) > 1 else math.nan


def named_mean_sd(name: str, values: Iterable[float | None]) -> dict[str, float]:
    """Return mean and standard deviation as the columns ``name_mean`` and ``name_sd``."""
    mean, sd = mean_sd(values)
    return {f"{name}_mean": mean, f"{name}_sd": sd}


def group_by(members: Iterable[T], key: Callable[[T], K]) -> Mapping[K, list[T]]:
    """Return lists of members by key, in the order in which the keys first occur."""
    groups: dict[K, list[T]] = {}
    for member in members:
        groups.setdefault(key(member), []).append(member)
    return groups


def pool_errors(errors: Sequence[Agreement | None]) -> tuple[float, float]:
    """Return mean and standard deviation of the samples of several errors together; each error has the same weight.

    From means b_i and standard deviations s_i: the mean b of the b_i, and sqrt(mean(s_i² + b_i²) − b²). NaN without a
    known error.
    """
    known = [error for error in errors if error is not None]
    if not known:
        return math.nan, math.nan
    bias = np.array([error.bias for error in known])
    square = np.array([error.sd**2 + error.bias**2 for error in known])
    mean = float(bias.mean())
    return mean, math.sqrt(max(float(square.mean()) - mean**2, 0.0))


FEWEST = 4
"""Smallest number of people for which a correlation is computed."""
_EXACT_RANKS = 7  # largest number of people for which all orders are compared
_RANK_DRAWS, _STEPS = 2000, 81
_RANK_SEED = 20


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
    if n <= _EXACT_RANKS:
        orders = np.array(list(permutations(y)))
        return float((np.abs(_correlate(x, orders)) >= abs(value)).sum() / factorial(n))
    orders = np.random.default_rng(_RANK_SEED).permuted(np.tile(y, (10 * _RANK_DRAWS, 1)), axis=1)
    return float((1 + (np.abs(_correlate(x, orders)) >= abs(value)).sum()) / (1 + len(orders)))


def _find_interval(x: FloatArray, value: float) -> tuple[float, float]:
    """Return the lowest and highest correlation in the population for which ``value`` is plausible at the ranks x."""
    rng = np.random.default_rng(_RANK_SEED)
    hidden = np.sort(rng.standard_normal((_RANK_DRAWS, len(x))), axis=1)[:, np.argsort(np.argsort(x, kind="stable"))]
    noise = rng.standard_normal((_RANK_DRAWS, len(x)))
    levels = np.linspace(-1, 1, _STEPS)  # Spearman's correlation in the population
    above, below = [], []
    for pearson in 2 * np.sin(np.pi / 6 * levels):
        sample = pearson * hidden + np.sqrt(max(1 - pearson**2, 0.0)) * noise
        drawn = _correlate(x, sample.argsort(axis=1).argsort(axis=1).astype(np.float64))
        above.append(np.mean(drawn >= value))
        below.append(np.mean(drawn <= value))
    possible = levels[(np.array(above) > 0.025) & (np.array(below) > 0.025)]
    return float(possible.min()), float(possible.max())
