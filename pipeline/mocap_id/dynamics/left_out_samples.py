"""Samples of the repetitions that are left out in cross-validation, and samples to fit without them."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.filtered_trial import FilteredTrial
from mocap_id.dynamics.lowpass import erode

LEAST_SECONDS = 1.0
"""Least duration of the samples of a fit, s."""
_FOLDS = 5  # a fold takes about 20 ms; with more repetitions, neighbouring ones are left out together


def number_parts(time: FloatArray, spans: FloatArray) -> IntArray:
    """Return the part of each sample: one repetition, or several neighbouring ones if there are many.

    Parameters
    ----------
    time : (T,) array
        s.
    spans : (r, 2) array
        First and last time of every repetition, in order, s. A sample between two repetitions belongs to the nearer.

    Returns
    -------
    (T,) int array
        Part of each sample, 0 … K - 1; all 0 if there are fewer than two repetitions.
    """
    between = (spans[:-1, 1] + spans[1:, 0]) / 2
    repetition = np.searchsorted(between, time)
    folds = min(len(spans), _FOLDS)
    return np.asarray(repetition * folds // max(len(spans), 1), dtype=np.int64)


def samples_without_part(prepared: FilteredTrial, gate: BoolArray, part: IntArray, k: int) -> BoolArray:
    """Return the samples (T,) to fit without part k: within the gate, and beyond the filter's reach of the part."""
    return prepared.usable & erode(gate & (part != k), prepared.lowpass.reach_samples)
