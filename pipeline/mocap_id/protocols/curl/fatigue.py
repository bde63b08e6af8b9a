"""Trends over the curls of a trial, as signs of fatigue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import FloatArray

_LEAST = 4  # curls with a known value


@dataclass(frozen=True)
class Trend:
    """Linear trend of a quantity over the curls."""

    slope: float  # change from one curl to the next, in the unit of the quantity
    interval: tuple[float, float]  # 95 % interval of the slope by Student's t
    count: int  # number of curls with a known value


def fit_trend(values: FloatArray) -> Trend | None:
    """Fit the linear trend of a quantity (n,) over n curls by least squares; None with fewer than four known values.

    Examples
    --------
    >>> fit_trend(np.array([1.0, 2.0, 3.0, 4.0])).slope
    1.0
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < _LEAST:
        return None
    number = known - known.mean()
    slope = float(number @ values[known] / (number @ number))
    rest = values[known] - values[known].mean() - slope * number
    free = len(known) - 2
    half = float(stdtrit(free, 0.975) * np.sqrt(rest @ rest / free / (number @ number)))
    return Trend(slope, (slope - half, slope + half), len(known))
