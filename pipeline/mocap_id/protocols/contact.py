"""When a chair carries part of the body.

A chair on a plate of its own shows it (``seat-plate``). Otherwise its force is what is missing under the feet, and
three rules find it:

- ``seat-force`` (default): a model identified on samples that are surely off the chair says what the feet should
  carry; what they carry less is on the chair. Contact lasts while the missing vertical force exceeds a threshold:
  four standard deviations of the same difference off the chair, between 0.5 and 10 % of the standing weight, and from
  there until it vanishes as its course foretells (:mod:`mocap_id.protocols.release`).
- ``weight``: the chair is released when the feet carry 72 % of the standing weight. In simulated trials the chair
  still carries up to a quarter of the weight then.
- ``knee``: off the chair is where the knee is straighter than 0.8 rad, as in the thesis (6.4.2). It leaves out a
  third of the samples that could be used, and the most exciting ones. It needs no plate, and is what is left where
  the plates miss the standing phases, whose weight the other two rules compare with, or all of the low ones.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.release import release

ContactRule = Literal["seat-force", "weight", "knee"]
DecidingRule = Literal["seat-plate", "seat-force", "weight", "knee"]

_SEATED = 0.5  # of the rise: nobody sits above
_CHAIR_SHARE = 0.8  # of the weight: feet that carry less than this all the while share it with a chair
_QUIET = 0.1  # of the fastest speed
_SPREADS, _LEAST, _MOST = 4.0, 0.005, 0.1
_LOADED = 0.95  # quantile of the chair's force that stands for its full load


def standing_weight(posture: Posture, vertical: FloatArray) -> float:
    """Vertical force of quiet upright standing, N; NaN where there is none."""
    known = np.isfinite(vertical) & np.isfinite(posture.speed)
    upright = posture.upright & known
    if not upright.any():
        return float("nan")
    quiet = upright & (posture.speed < _QUIET * np.max(posture.speed[known]))
    return float(np.median(vertical[quiet if quiet.any() else upright]))


def uses_chair(posture: Posture, vertical: FloatArray, weight: float) -> bool | None:
    """Whether the feet are relieved of weight in the low phases; in a squat they never are.

    None where the plates do not tell: without the standing weight, or without a reading in any low phase.

    Parameters
    ----------
    posture : Posture
    vertical : (T,) array
        Vertical force under the feet, N; NaN where unknown.
    weight : float
        Standing weight, N; NaN where unknown.
    """
    low = [run for run in runs(~posture.upright) if np.isfinite(vertical[run]).any()]
    if not low or np.isnan(weight):
        return None
    return any(float(np.nanmedian(vertical[run])) < _CHAIR_SHARE * weight for run in low)


def surely_free(posture: Posture) -> BoolArray:
    """Samples that no chair can reach: upright, and above 0.4 of the rise."""
    return np.nan_to_num(posture.height, nan=0.0) > 0.4


def touching(posture: Posture, sign_of_contact: BoolArray) -> BoolArray:
    """Contact with the chair in every low phase, from the first to the last sample that shows it.

    Before the first rise and after the last descent the person stays seated, to the ends of the recording. Signs of
    contact above half of the rise are something else.

    Parameters
    ----------
    posture : Posture
    sign_of_contact : (T,) bool array
    """
    signs = sign_of_contact & (np.nan_to_num(posture.height, nan=0.0) < _SEATED)
    out = np.zeros(len(signs), dtype=bool)
    for low in runs(~posture.upright):
        found = np.flatnonzero(signs[low])
        if len(found):
            first = low.start if low.start == 0 else low.start + int(found[0])
            last = low.stop if low.stop == len(signs) else low.start + int(found[-1]) + 1
            out[first:last] = True
    return out


def until_zero(time: FloatArray, touching: BoolArray, seat_force: FloatArray) -> BoolArray:
    """Contact from where the chair's force begins to where it vanishes, beyond where it stands out of the noise.

    Parameters
    ----------
    time : (T,) array
        s.
    touching : (T,) bool array
        Where it stands out.
    seat_force : (T,) array
        Vertical force of the chair, N, as it is: a low-pass would blur its end.
    """
    out = touching.copy()
    for run in runs(touching):
        full = float(np.nanquantile(seat_force[run], _LOADED)) if np.isfinite(seat_force[run]).any() else 0.0
        if run.stop < len(time):
            end = release(time, seat_force, float(time[run.stop - 1]), full)
            out[run.start : int(np.searchsorted(time, end, side="right"))] = True
        if run.start > 0:
            begin = -release(-time[::-1], seat_force[::-1], -float(time[run.start]), full)
            out[int(np.searchsorted(time, begin)) : run.stop] = True
    return out


def seat_force_threshold(seat_force: FloatArray, off_chair: BoolArray, weight: float) -> float:
    """Missing vertical force that counts as contact, N: see the module's text.

    Parameters
    ----------
    seat_force : (T,) array
        Model less measurement, N.
    off_chair : (T,) bool array
        Samples to take the difference's spread from.
    weight : float
        Standing weight, N.
    """
    spread = float(np.nanstd(seat_force[off_chair]))
    return float(np.clip(_SPREADS * spread, _LEAST * weight, _MOST * weight))
