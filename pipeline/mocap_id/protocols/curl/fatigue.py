"""Trends over the curls of a trial: what changes as the person tires."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from mocap_id.arrays import FloatArray

_LEAST = 4  # curls


@dataclass(frozen=True)
class Trend:
    """Change of a quantity from one curl to the next, by least squares over the complete curls.

    Parameters
    ----------
    slope : float
        Per curl.
    interval : (float, float)
        95 % interval by Student's t.
    count : int
        Number of curls.
    """

    slope: float
    interval: tuple[float, float]
    count: int


def trend(values: FloatArray) -> Trend | None:
    """Return the trend of a quantity (n,) over the curls; None with fewer than four known values.

    Examples
    --------
    >>> trend(np.array([1.0, 2.0, 3.0, 4.0])).slope
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
