"""Drop-outs of force plates: zero load under a standing person, such as after a loose cable."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs

_UNLOADED = 0.2
"""Share of the standing weight. An upright person always loads the plates more, except in a jump."""

_MIN_DURATION_S = 0.6
"""Minimum duration, longer than the flight of any jump."""


def find_dropouts(vertical: FloatArray, tall: BoolArray, rate: float, weight: float) -> BoolArray:
    """Find the samples (F,) at which the plates are unloaded although the person stands upright.

    Parameters
    ----------
    vertical : (F,) array
        Total upward force of the plates under the feet, N; NaN where unknown.
    tall : (F,) bool array
        Whether the person stands upright.
    rate : float
        Frames per second.
    weight : float
        Force while the person stands, N.
    """
    with np.errstate(invalid="ignore"):
        unloaded = vertical < _UNLOADED * weight
    lost = np.zeros(len(vertical), bool)
    for run in find_runs(unloaded):
        lost[run] = tall[run].sum() >= _MIN_DURATION_S * rate
    return lost
