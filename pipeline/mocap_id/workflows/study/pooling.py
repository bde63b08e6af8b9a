"""From trials to people, and from people to the cohort: means, paired differences and correlations.

Every person counts once, whatever the number of trials. Some numbers may be missing; a number that cannot be computed
is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, TypeVar

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.prediction import Agreement
from mocap_id.reporting.contents import COHORT

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
_FEWEST = 4  # smallest number of people for which a correlation is computed
_MOST_SIGNS, _MOST_ORDERS = 14, 7  # largest numbers of people for which all signs, and all orders, are compared
_DRAWS = 20_000  # number of random signs or orders for more people
_SAMPLES, _STEPS = 2000, 81  # samples of a population with one correlation, and number of these correlations
_SEED = 20


@dataclass(frozen=True)
class IntervalEstimate:
    """A value with the ends of its 95 % interval; NaN if unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def minus(self, other: IntervalEstimate) -> IntervalEstimate:
        """Return this estimate minus ``other``, with an interval that assumes independent errors."""
        value = self.value - other.value
        below = math.hypot(self.value - self.low, other.high - other.value)
        above = math.hypot(self.high - self.value, other.value - other.low)
        return IntervalEstimate(value, value - below, value + above)

    def columns(self, name: str) -> dict[str, float]:
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def group_by(members: Iterable[T], key: Callable[[T], K]) -> Mapping[K, list[T]]:
    """Return lists of members by key, in the order in which the keys first occur."""
    groups: dict[K, list[T]] = {}
    for member in members:
        groups.setdefault(key(member), []).append(member)
    return groups


def find_mean_sd(values: Iterable[float | None]) -> tuple[float, float]:
    """Return mean and sample standard deviation (n − 1) of the known values; NaN if there are too few values.

    >>> find_mean_sd([1.0, None, 3.0])
    (2.0, 1.4142135623730951)
    """
    known = np.array([value for value in values if value is not None and math.isfinite(value)])
    return float(known.mean()) if len(known) else math.nan, sd_of(known)


def named_mean_sd(name: str, values: Iterable[float | None]) -> dict[str, float]:
    """Return mean and standard deviation as the columns ``name_mean`` and ``name_sd``."""
    return dict(zip((f"{name}_mean", f"{name}_sd"), find_mean_sd(values), strict=True))


def sd_of(values: Sequence[float] | FloatArray) -> float:
    """Return the sample standard deviation (n − 1); NaN for less than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def pool_people(
    rows: Iterable[Mapping[str, Any]], keys: Sequence[str], columns: Mapping[str, tuple[str, str]]
) -> Iterator[dict[str, Any]]:
    """Yield a row of the cohort for each combination of ``keys``, from one row for each person.

    ``columns`` names the pooled columns of the people, and for each the columns of the mean and of the standard
    deviation over the people; an empty name leaves one out.
    """
    for group, own in group_by(rows, lambda row: tuple(row[key] for key in keys)).items():
        row = dict(zip(keys, group, strict=True)) | {"subject": COHORT, "subjects": len(own)}
        row["trials"] = sum(one["trials"] for one in own)
        for column, names in columns.items():
            row |= {
                name: value for name, value in zip(names, find_mean_sd(one[column] for one in own), strict=True) if name
            }
        yield row


def pool_differences(people: Mapping[str, Sequence[float]], columns: str) -> dict[str, Any]:
    """Return the cohort's row of paired differences, from the differences of each person.

    The row has the number of people, the mean over the people with its interval, and these ``columns``, separated by
    blanks: ``pairs``, ``p`` (see :func:`sign_flip_p`), and the standard deviations ``sd`` of all differences,
    ``sd_between`` of the people's means and ``sd_within`` people, pooled.
    """
    means = [float(np.mean(own)) for own in people.values()]
    freedom = sum(len(own) - 1 for own in people.values())
    squares = sum(float(np.var(own)) * len(own) for own in people.values())
    find: Mapping[str, Callable[[], float]] = {
        "pairs": lambda: sum(map(len, people.values())),
        "p": lambda: sign_flip_p(means),
        "sd": lambda: sd_of([one for own in people.values() for one in own]),
        "sd_between": lambda: sd_of(means),
        "sd_within": lambda: float(np.sqrt(squares / freedom)) if freedom else math.nan,
    }
    row = {"people": len(means), **average_people(means).columns("difference")}
    return row | {name: find[name]() for name in columns.split()}


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


def average_estimates(estimates: Iterable[IntervalEstimate]) -> IntervalEstimate:
    """Return the mean of the known estimates; its interval assumes that all estimates have the same error.

    >>> average_estimates([IntervalEstimate(0.2, 0.1, 0.3), IntervalEstimate(0.4, 0.3, 0.5), IntervalEstimate()])
    IntervalEstimate(value=0.30000000000000004, low=0.2, high=0.4)
    """
    rows = np.array([(one.value, one.low, one.high) for one in estimates if math.isfinite(one.value)])
    return IntervalEstimate(*rows.mean(axis=0).tolist()) if len(rows) else IntervalEstimate()


def average_people(values: Sequence[float]) -> IntervalEstimate:
    """Return the mean of the people's values with Student's interval, which is NaN for one person.

    >>> average_people([1.0, 2.0, 3.0]).value
    2.0
    """
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if not n:
        return IntervalEstimate()
    half = float(stdtrit(n - 1, 0.975) * array.std(ddof=1) / np.sqrt(n)) if n > 1 else math.nan
    mean = float(array.mean())
    return IntervalEstimate(mean, mean - half, mean + half)


def sign_flip_p(differences: Sequence[float]) -> float:
    """Return the two-sided permutation p-value of the hypothesis that the differences have no preferred sign.

    All combinations of signs are compared, or 20,000 random combinations for more than 14 people. NaN for one person.

    >>> sign_flip_p([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])  # 2 of 64
    0.03125
    """
    array = np.asarray(differences, dtype=np.float64)
    n = len(array)
    if n < 2:
        return math.nan
    least = abs(array.sum()) - 1e-12 * np.abs(array).sum()
    if n <= _MOST_SIGNS:
        signs = np.array(list(product((-1.0, 1.0), repeat=n)))
        return float(np.mean(np.abs(signs @ array) >= least))
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], (_DRAWS, n))
    return float((1 + (np.abs(signs @ array) >= least).sum()) / (1 + _DRAWS))


def correlate_ranks(x: FloatArray, y: FloatArray) -> tuple[IntervalEstimate, float, int]:
    """Return Spearman's correlation of ``x`` (N,), which may have ties, with ``y`` (N,); pairs with a NaN are left out.

    Correlation and p-value are NaN for fewer than four people, or if a variable is constant. The last result is the
    number of people for whom both variables are known.

    The two-sided p-value of no correlation compares all orders of ``y``, or 20,000 random orders for more than seven
    people. The interval contains the correlations of a normal copula for which the observed value is not in the upper
    or lower 2.5 % of samples with the ties of ``x``. A bootstrap fails, because each resample of perfectly ordered
    people is ordered too.

    >>> estimate, p, _ = correlate_ranks(np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.358, 0.270, 0.178, 0.0015]))
    >>> estimate.value, round(p, 3)
    (-1.0, 0.083)
    """
    known = np.isfinite(x) & np.isfinite(y)
    first, second = _rank(x[known]), _rank(y[known])
    n = int(known.sum())
    if n < _FEWEST or np.ptp(first) == 0 or np.ptp(second) == 0:
        return IntervalEstimate(), math.nan, n
    value = float(_correlate(first, second[None])[0])
    if n <= _MOST_ORDERS:
        orders = np.array(list(permutations(second)))
        p = float((np.abs(_correlate(first, orders)) >= abs(value)).sum() / math.factorial(n))
    else:
        orders = np.random.default_rng(_SEED).permuted(np.tile(second, (_DRAWS, 1)), axis=1)
        p = float((1 + (np.abs(_correlate(first, orders)) >= abs(value)).sum()) / (1 + len(orders)))
    # The lowest and highest correlation in the population for which the value is plausible at these ranks.
    rng = np.random.default_rng(_SEED)
    hidden = np.sort(rng.standard_normal((_SAMPLES, n)), axis=1)[:, np.argsort(np.argsort(first, kind="stable"))]
    noise = rng.standard_normal((_SAMPLES, n))
    levels = np.linspace(-1, 1, _STEPS)  # Spearman's correlation in the population
    above, below = [], []
    for pearson in 2 * np.sin(np.pi / 6 * levels):
        sample = pearson * hidden + np.sqrt(max(1 - pearson**2, 0.0)) * noise
        drawn = _correlate(first, sample.argsort(axis=1).argsort(axis=1).astype(np.float64))
        above.append(np.mean(drawn >= value))
        below.append(np.mean(drawn <= value))
    possible = levels[(np.array(above) > 0.025) & (np.array(below) > 0.025)]
    return IntervalEstimate(value, float(possible.min()), float(possible.max())), p, n


def _rank(values: FloatArray) -> FloatArray:
    """Return the ranks (N,) from 1; tied values share the mean of their ranks.

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
