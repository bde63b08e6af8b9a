"""Seat-off by the two rules of the thesis (6.4.2).

The thesis takes the chair as released when the measured wrench agrees with a model without a chair, and finds that the
feet then carry 72 % of the standing weight. Both instants are earlier than that of zero chair force.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.repetitions import Repetition


def share_crossing_time(time: FloatArray, vertical: FloatArray, share: float, repetition: Repetition) -> float:
    """Return the last time before the peak force at which the force under the feet exceeds a share of the weight.

    Crossings after the peak are ignored, because the force at the end of a fast rise is briefly below the share.

    Parameters
    ----------
    time : (T,) array
        s.
    vertical : (T,) array
        Force under the feet divided by the standing weight; NaN where unknown.
    share : float
        0.72 in the thesis.
    repetition : Repetition

    Returns
    -------
    float
        s, interpolated between samples; NaN without a known crossing.
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


def model_agreement_time(time: FloatArray, above_noise: BoolArray | None, repetition: Repetition) -> float:
    """Return when measured and modelled force agree: the end of the samples above the noise; NaN if unknown.

    Parameters
    ----------
    time : (T,) array
        s.
    above_noise : (T,) bool array or None
        See :class:`mocap_id.protocols.chair_contact.Contact`.
    repetition : Repetition
    """
    if above_noise is None or np.isnan(repetition.start):
        return float("nan")
    found = np.flatnonzero(above_noise & (time >= repetition.start) & (time <= repetition.seat_off))
    return float(time[min(found[-1] + 1, len(time) - 1)]) if len(found) else float("nan")
