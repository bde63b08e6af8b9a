"""Stretches in which a plate says nothing of who stands on it: a cable came off, an amplifier was reset."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_NOTHING = 0.2
"""Of the standing weight: a body that stays upright weighs more at any time, but in a jump."""

_LASTS_S = 0.6
"""Longer than the flight of any jump."""


def dropped_out(vertical: FloatArray, tall: BoolArray, rate: float, weight: float) -> BoolArray:
    """Samples (F,) of stretches in which the plates carry nothing although the person stands upright in them.

    Parameters
    ----------
    vertical : (F,) array
        Upward force of the feet's plates together, N; NaN where unknown.
    tall : (F,) bool array
        The person stands upright.
    rate : float
        Hz.
    weight : float
        What they carry while the person stands, N.
    """
    with np.errstate(invalid="ignore"):
        nothing = vertical < _NOTHING * weight
    lost = np.zeros(len(vertical), bool)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], nothing.astype(np.int8), [0]))))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        lost[start:stop] = tall[start:stop].sum() >= _LASTS_S * rate
    return lost
