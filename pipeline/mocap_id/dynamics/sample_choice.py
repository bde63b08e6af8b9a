"""Choice of samples for a fit and for parts of a trial that are left out, and shortening of long rests."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.lowpass import erode
from mocap_id.dynamics.preparation import AnyTrial

LEAST_SECONDS = 1.0
"""Least duration of the samples of a fit, s."""
_FOLDS = 5  # largest number of folds; if there are more repetitions, neighbouring repetitions are left out together
_RESTING = 0.05  # fraction of a fast joint velocity below which a joint rests
_MOSTLY = 0.5  # fraction of rest above which all rest is left out
_LONG = 0.75  # fraction of rest above which rest is thinned


def select_samples(prepared: AnyTrial, gate: BoolArray) -> BoolArray:
    """Return a mask (T,) of the samples to fit: usable, and within the gate by at least the reach of the filter."""
    return prepared.usable & erode(gate, prepared.lowpass.reach_samples)


def number_parts(time: FloatArray, spans: FloatArray) -> IntArray:
    """Return the number (T,), from 0, of the part of the trial to which each sample belongs.

    A part is one repetition, or several neighbouring repetitions if there are more than five. ``spans`` (r, 2) are the
    first and last time of every repetition, in order, s. A sample between two repetitions belongs to the nearer one. If
    there are fewer than two repetitions, all samples belong to part 0.
    """
    between = (spans[:-1, 1] + spans[1:, 0]) / 2
    repetition = np.searchsorted(between, time)
    folds = min(len(spans), _FOLDS)
    return np.asarray(repetition * folds // max(len(spans), 1), dtype=np.int64)


def skip_long_rests(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the moving samples if the person rests most of the time, otherwise of all samples.

    ``velocity`` (T, n) are the joint velocities, rad/s, which are small at rest. The errors of a constant posture are
    the same in all its samples, and would outweigh the motion in every mean.
    """
    moving = _find_motion(velocity)
    return moving if len(moving) and moving.mean() < 1 - _MOSTLY else np.ones(len(moving), dtype=np.bool_)


def shorten_rests(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the moving and about as many resting samples if rests are long, otherwise of all samples.

    ``velocity`` (T, n) are the joint velocities, rad/s, which are small at rest.
    """
    moving = _find_motion(velocity)
    if not len(moving) or moving.mean() >= 1 - _LONG:
        return np.ones(len(moving), dtype=np.bool_)
    rest, used = np.flatnonzero(~moving), moving.copy()
    used[rest[:: len(rest) // max(int(moving.sum()), 1)]] = True
    return used


def _find_motion(velocity: FloatArray) -> BoolArray:
    """Return a mask (T,) of the samples in which at least one joint moves."""
    speed = np.abs(velocity).max(axis=1, initial=0.0)
    if not len(speed):
        return np.zeros(0, dtype=np.bool_)
    fast = max(
        np.quantile(speed, 0.95), 0.5 * speed.max()
    )  # if a person rests most of the time, the quantile is only sway
    return np.asarray(speed >= _RESTING * fast)
