"""Means and spreads of numbers of which some may be missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from mocap_id.dynamics.comparison import Agreement

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)


def mean_sd(values: Iterable[float | None]) -> tuple[float, float]:
    """Return mean and sample standard deviation (n − 1) of the known values; NaN for too few of them.

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
    """Return the members by key, in the order in which the keys first come."""
    found: dict[K, list[T]] = {}
    for member in members:
        found.setdefault(key(member), []).append(member)
    return found


def pooled(errors: Sequence[Agreement | None]) -> tuple[float, float]:
    """Return mean and standard deviation of the samples of several errors together, each error with the same weight.

    With means b_i and standard deviations s_i: mean b of the b_i, and sqrt(mean(s_i² + b_i²) − b²).
    """
    known = [error for error in errors if error is not None]
    if not known:
        return math.nan, math.nan
    bias = np.array([error.bias for error in known])
    square = np.array([error.sd**2 + error.bias**2 for error in known])
    mean = float(bias.mean())
    return mean, math.sqrt(max(float(square.mean()) - mean**2, 0.0))
