"""Which samples belong to a repetition that is left out, and which can then be fitted."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.lowpass import erode
from mocap_id.dynamics.prepare import Prepared

LEAST_SECONDS = 1.0
"""Of samples that a fit needs."""
_FOLDS = 5  # a fold costs some 20 ms; with more repetitions neighbouring ones are left out together


def parts(time: FloatArray, spans: FloatArray) -> IntArray:
    """Number the part of each sample: one a repetition, or a run of neighbouring ones where there are many.

    Parameters
    ----------
    time : (T,) array
        s.
    spans : (r, 2) array
        First and last time of every repetition, in order, s. What lies between two belongs to the nearer.

    Returns
    -------
    (T,) int array
        0 … K - 1; all 0 where there are fewer than two repetitions.
    """
    between = (spans[:-1, 1] + spans[1:, 0]) / 2
    repetition = np.searchsorted(between, time)
    folds = min(len(spans), _FOLDS)
    return np.asarray(repetition * folds // max(len(spans), 1), dtype=np.int64)


def without(prepared: Prepared, gate: BoolArray, part: IntArray, k: int) -> BoolArray:
    """Samples (T,) to fit on without part k: off the chair and off the part by the filter's reach."""
    return prepared.usable & erode(gate & (part != k), prepared.lowpass.reach_samples)
