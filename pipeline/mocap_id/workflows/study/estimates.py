"""Values with intervals, and differences between conditions of the same people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import stdtrit

_EXACT = 14  # largest number of people of whom all signs are compared
_DRAWS, _SEED = 20_000, 20


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval; NaN if unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def minus(self, other: Estimate) -> Estimate:
        """Return the difference from another estimate whose error is independent."""
        value = self.value - other.value
        below = math.hypot(self.value - self.low, other.high - other.value)
        above = math.hypot(self.high - self.value, other.value - other.low)
        return Estimate(value, value - below, value + above)

    def columns(self, name: str) -> dict[str, float]:
        """Return the columns ``name``, ``name_low`` and ``name_high``."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def mean_estimate(estimates: Iterable[Estimate]) -> Estimate:
    """Return the mean of the known estimates; its interval takes their errors as common, so it gets no narrower.

    Examples
    --------
    >>> mean_estimate([Estimate(0.2, 0.1, 0.3), Estimate(0.4, 0.3, 0.5), Estimate()])
    Estimate(value=0.30000000000000004, low=0.2, high=0.4)
    """
    rows = np.array([(one.value, one.low, one.high) for one in estimates if math.isfinite(one.value)])
    return Estimate(*rows.mean(axis=0).tolist()) if len(rows) else Estimate()


def over_people(values: Sequence[float]) -> Estimate:
    """Return the mean over people, one value each, with Student's interval; without one for a single person.

    Examples
    --------
    >>> over_people([1.0, 2.0, 3.0]).value
    2.0
    """
    found = np.asarray(values, dtype=np.float64)
    n = len(found)
    if not n:
        return Estimate()
    half = float(stdtrit(n - 1, 0.975) * found.std(ddof=1) / np.sqrt(n)) if n > 1 else math.nan
    mean = float(found.mean())
    return Estimate(mean, mean - half, mean + half)


def sign_flip_p(differences: Sequence[float]) -> float:
    """Return the two-sided permutation p-value that paired differences have no preferred sign; NaN for one person.

    All signs are compared, or 20,000 random ones for more than 14 people.

    Examples
    --------
    >>> sign_flip_p([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])  # 2 of 64
    0.03125
    """
    found = np.asarray(differences, dtype=np.float64)
    n = len(found)
    if n < 2:
        return math.nan
    least = abs(found.sum()) - 1e-12 * np.abs(found).sum()
    if n <= _EXACT:
        signs = np.array(list(product((-1.0, 1.0), repeat=n)))
        return float(np.mean(np.abs(signs @ found) >= least))
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], (_DRAWS, n))
    return float((1 + (np.abs(signs @ found) >= least).sum()) / (1 + _DRAWS))
