"""Rules that decide when a chair carries part of the body.

A chair on its own force plate shows contact directly (``seat-plate``). Otherwise the force of the chair is the force
missing under the feet, and one of three rules finds the contact:

- ``seat-force`` (default): a model identified on samples clearly off the chair predicts the force under the feet; the
  missing part is on the chair. There is contact while the missing vertical force exceeds a threshold of four standard
  deviations of the same difference off the chair, limited to 0.5 to 10 % of the standing weight. From there, contact
  is extended to the extrapolated instant of zero force (:mod:`mocap_id.protocols.release`).
- ``weight``: the chair is released when the feet carry 72 % of the standing weight. In simulated trials the chair
  still carries up to a quarter of the weight at that instant.
- ``knee``: there is no contact while the knee is straighter than 0.8 rad, as in the thesis (6.4.2). This excludes a
  third of the usable samples, including the most exciting ones. The rule needs no plate. It replaces
  the other rules if there are no plate readings while the person stands, or none while the hips are low.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.release import release

ContactRule = Literal["seat-force", "weight", "knee"]
DecidingRule = Literal["seat-plate", "seat-force", "weight", "knee"]

_SEATED = 0.5  # share of the rise: nobody sits higher
_CHAIR_SHARE = 0.8  # share of the weight: if the feet carry less, a chair carries the rest
_QUIET = 0.1  # share of the maximum speed
_SPREADS, _LEAST, _MOST = 4.0, 0.005, 0.1
_LOADED = 0.95  # quantile of the chair force that is taken as its full load


def standing_weight(posture: Posture, vertical: FloatArray) -> float:
    """Return the vertical force during quiet upright standing, N; NaN if nobody stands."""
    known = np.isfinite(vertical) & np.isfinite(posture.speed)
    upright = posture.upright & known
    if not upright.any():
        return float("nan")
    quiet = upright & (posture.speed < _QUIET * np.max(posture.speed[known]))
    return float(np.median(vertical[quiet if quiet.any() else upright]))


def uses_chair(posture: Posture, vertical: FloatArray, weight: float) -> bool | None:
    """Return whether a chair carries weight in the low phases, which it never does in a squat.

    The result is None without the standing weight, or without a plate reading in any low phase.

    Parameters
    ----------
    posture : Posture
    vertical : (T,) array
        Vertical force under the feet, N; NaN where unknown.
    weight : float
        Standing weight, N; NaN where unknown.
    """
    low = [run for run in find_runs(~posture.upright) if np.isfinite(vertical[run]).any()]
    if not low or np.isnan(weight):
        return None
    return any(float(np.nanmedian(vertical[run])) < _CHAIR_SHARE * weight for run in low)


def clearly_off_chair(posture: Posture) -> BoolArray:
    """Return the samples too high for chair contact: above 0.4 of the rise."""
    return np.nan_to_num(posture.height, nan=0.0) > 0.4


def contact_in_low_phases(posture: Posture, sign_of_contact: BoolArray) -> BoolArray:
    """Return contact in each low phase, (T,) bool, from the first to the last sample that indicates it.

    The person is taken as seated from the beginning of the recording to the first rise, and from the last descent to
    the end. Indications of contact above half of the rise are ignored.

    Parameters
    ----------
    posture : Posture
    sign_of_contact : (T,) bool array
        Samples that indicate contact.
    """
    signs = sign_of_contact & (np.nan_to_num(posture.height, nan=0.0) < _SEATED)
    out = np.zeros(len(signs), dtype=bool)
    for low in find_runs(~posture.upright):
        found = np.flatnonzero(signs[low])
        if len(found):
            first = low.start if low.start == 0 else low.start + int(found[0])
            last = low.stop if low.stop == len(signs) else low.start + int(found[-1]) + 1
            out[first:last] = True
    return out


def extend_to_release(time: FloatArray, touching: BoolArray, seat_force: FloatArray) -> BoolArray:
    """Extend contact beyond the samples above the noise, to the extrapolated instants of zero chair force.

    Parameters
    ----------
    time : (T,) array
        s.
    touching : (T,) bool array
        Samples with a chair force above the noise.
    seat_force : (T,) array
        Vertical force of the chair, N, unfiltered, because a low-pass would blur its end.
    """
    out = touching.copy()
    for run in find_runs(touching):
        full = float(np.nanquantile(seat_force[run], _LOADED)) if np.isfinite(seat_force[run]).any() else 0.0
        if run.stop < len(time):
            end = release(time, seat_force, float(time[run.stop - 1]), full)
            out[run.start : int(np.searchsorted(time, end, side="right"))] = True
        if run.start > 0:
            begin = -release(-time[::-1], seat_force[::-1], -float(time[run.start]), full)
            out[int(np.searchsorted(time, begin)) : run.stop] = True
    return out


def seat_force_threshold(seat_force: FloatArray, off_chair: BoolArray, weight: float) -> float:
    """Return the threshold of the missing vertical force for contact, N (see the module docstring).

    Parameters
    ----------
    seat_force : (T,) array
        Model minus measurement, N.
    off_chair : (T,) bool array
        Samples that give the standard deviation of the difference.
    weight : float
        Standing weight, N.
    """
    spread = float(np.nanstd(seat_force[off_chair]))
    return float(np.clip(_SPREADS * spread, _LEAST * weight, _MOST * weight))
