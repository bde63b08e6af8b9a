"""Seat-off by the two rules of the thesis (6.4.2), beside the instant at which the chair's force vanishes.

The thesis sees the chair released where the measured wrench comes to be what a model without a chair expects, and finds
that the feet then carry 72 % of the standing weight. Both come before the force is exactly zero.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.repetitions import Repetition


def past_share(time: FloatArray, vertical: FloatArray, share: float, repetition: Repetition) -> float:
    """When the feet's force rises past a share of the standing weight for the last time before its peak in the rise.

    A fast rise ends with less than that share for an instant, so what comes after the peak does not count.

    Parameters
    ----------
    time : (T,) array
        s.
    vertical : (T,) array
        Force under the feet over the standing weight; NaN where unknown.
    share : float
        0.72 in the thesis.
    repetition : Repetition

    Returns
    -------
    float
        s, between two samples; NaN where the force is not seen to pass.
    """
    rise = np.flatnonzero((time >= repetition.start) & (time <= repetition.stand))
    if not len(rise) or not np.isfinite(vertical[rise]).any():
        return float("nan")
    top = int(np.nanargmax(vertical[rise]))
    known = rise[: top + 1][np.isfinite(vertical[rise[: top + 1]])]
    below = np.flatnonzero(vertical[known] < share)
    if not len(below) or below[-1] + 1 >= len(known):
        return float("nan")
    i, j = known[below[-1]], known[below[-1] + 1]
    return float(np.interp(share, vertical[[i, j]], time[[i, j]]))


def where_models_meet(time: FloatArray, shown: BoolArray | None, repetition: Repetition) -> float:
    """When measured and modelled force come together: the end of what stands out of the noise; NaN where unknown.

    Parameters
    ----------
    time : (T,) array
        s.
    shown : (T,) bool array or None
        See :class:`mocap_id.protocols.sit_to_stand.Contact`.
    repetition : Repetition
    """
    if shown is None or np.isnan(repetition.start):
        return float("nan")
    found = np.flatnonzero(shown & (time >= repetition.start) & (time <= repetition.seat_off))
    return float(time[min(found[-1] + 1, len(time) - 1)]) if len(found) else float("nan")
