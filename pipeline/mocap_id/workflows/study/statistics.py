"""Means and spreads of a study's numbers, of which some are missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from mocap_id.dynamics.predict import Agreement

T = TypeVar("T")


def mean_sd(values: Iterable[float | None]) -> tuple[float, float]:
    """Mean and standard deviation (of a sample: n − 1) of what is known; NaN for want of one, or two, numbers.

    >>> mean_sd([1.0, None, 3.0])
    (2.0, 1.4142135623730951)
    """
    known = np.array([value for value in values if value is not None and math.isfinite(value)])
    mean = float(known.mean()) if len(known) else math.nan
    return mean, float(known.std(ddof=1)) if len(known) > 1 else math.nan


def groups(members: Iterable[T], key: Callable[[T], str]) -> Mapping[str, list[T]]:
    """Members by their key, in the order in which the keys first come."""
    found: dict[str, list[T]] = {}
    for member in members:
        found.setdefault(key(member), []).append(member)
    return found


def pooled(errors: Sequence[Agreement | None]) -> tuple[float, float]:
    """Mean and standard deviation of several errors' samples put together, each error counting alike.

    With means b_i and standard deviations s_i: mean b of the b_i, and sqrt(mean(s_i² + b_i²) − b²).
    """
    known = [error for error in errors if error is not None]
    if not known:
        return math.nan, math.nan
    bias = np.array([error.bias for error in known])
    square = np.array([error.sd**2 + error.bias**2 for error in known])
    mean = float(bias.mean())
    return mean, math.sqrt(max(float(square.mean()) - mean**2, 0.0))
