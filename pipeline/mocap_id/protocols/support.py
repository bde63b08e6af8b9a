"""Vertical support in a rise that neither the ground nor the chair explains: an armrest, a rail, somebody's hand.

What the body's acceleration asks for, the plates together must give. What they give less, something else does. While
the thighs are on the seat that may be the chair, so without a plate under the chair only the part of the rise counts
in which no seat is near. A push with the hands on the own thighs is a force within the body: no plate can show it.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.posture import STANDING, Posture
from mocap_id.protocols.repetitions import Repetition

OFF_SEAT = 0.25
"""Of the rise: no seat is that high. Simulated chairs are released below 0.04, that of a real trial at 0.16."""

LIMIT = 0.05
"""Of the standing weight. Without any support the error of an allometric body is below."""

_QUIET = 0.1  # of the fastest speed
_LEAST = 5  # samples


def unexplained(
    time: FloatArray,
    posture: Posture,
    missing: FloatArray,
    weight: float,
    repetition: Repetition,
    *,
    seat_measured: bool,
) -> float:
    """Mean missing vertical force of a rise, of the standing weight; NaN where unknown.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    missing : (T,) array
        What a body model expects of the ground, less what the ground gives, N. What it misses in quiet standing is the
        model's own error, and is taken off.
    weight : float
        Standing weight, N.
    repetition : Repetition
    seat_measured : bool
        The chair's force is known and not among what is missing, so the whole rise counts.
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
