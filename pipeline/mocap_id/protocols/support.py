"""Unexplained vertical support during a rise: an armrest, a rail or a helping hand.

The plates must carry what the acceleration of the body requires; a missing force acts elsewhere. While the thighs are
on the seat it may act on the chair, so without a plate under the chair only the upper part of the rise is used. Pushing
with the hands on one's own thighs is an internal force, which no plate can show.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition

OFF_SEAT = 0.25
"""Share of the rise above which no seat is. Simulated chairs are released below 0.04, that of a real trial at 0.16."""

LIMIT = 0.05
"""Share of the standing weight; the error of an allometric body without any support is smaller."""

_QUIET = 0.1  # share of the maximum speed
_LEAST = 5  # samples


def unexplained_support(
    time: FloatArray,
    posture: Posture,
    missing: FloatArray,
    weight: float,
    repetition: Repetition,
    *,
    seat_measured: bool,
) -> float:
    """Return the mean missing vertical force of a rise as a share of the standing weight; NaN if unknown.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    missing : (T,) array
        Ground force predicted by a body model minus measured ground force, N. Its median in quiet standing is the
        error of the model and is subtracted.
    weight : float
        Standing weight, N.
    repetition : Repetition
    seat_measured : bool
        Whether the chair force is measured and excluded from ``missing``; the whole rise is then used.
    """
    with np.errstate(invalid="ignore"):
        quiet = (posture.height > STANDING) & (posture.speed < _QUIET * np.nanmax(posture.speed))
        rise = (time >= repetition.start) & (time <= repetition.stand)
        if not seat_measured:
            rise &= (posture.height > OFF_SEAT) & (posture.height < STANDING)
    rise &= np.isfinite(missing)
    quiet &= np.isfinite(missing)
    if np.count_nonzero(rise) < _LEAST or not quiet.any():
        return float("nan")
    return float((missing[rise].mean() - np.median(missing[quiet])) / weight)
