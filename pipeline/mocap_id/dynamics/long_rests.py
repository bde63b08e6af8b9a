"""Rests that are longer than the motion: a held posture repeats its errors, and outweighs the motion in every mean."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_RESTING = 0.05  # of a fast joint velocity; slower is rest
_MOSTLY = 0.5  # share of rest from which it is left out
_LONG = 0.75  # share of rest from which it is thinned


def without_long_rests(velocity: FloatArray) -> BoolArray:
    """Return the samples (T,) to use: those in motion if the person mostly rests, else all.

    Parameters
    ----------
    velocity : (T, n) array
        Joint velocities, rad/s.
    """
    moving = _moving(velocity)
    return moving if len(moving) and moving.mean() < 1 - _MOSTLY else np.ones(len(moving), dtype=np.bool_)


def with_short_rests(velocity: FloatArray) -> BoolArray:
    """Return the samples (T,) to use: all, or, if rests are long, those in motion and about as many at rest.

    Parameters
    ----------
    velocity : (T, n) array
        Joint velocities, rad/s.
    """
    moving = _moving(velocity)
    if not len(moving) or moving.mean() >= 1 - _LONG:
        return np.ones(len(moving), dtype=np.bool_)
    rest, used = np.flatnonzero(~moving), moving.copy()
    used[rest[:: len(rest) // max(int(moving.sum()), 1)]] = True
    return used


def _moving(velocity: FloatArray) -> BoolArray:
    speed = np.abs(velocity).max(axis=1, initial=0.0)
    if not len(speed):
        return np.zeros(0, dtype=np.bool_)
    fast = max(np.quantile(speed, 0.95), 0.5 * speed.max())  # if nearly all is rest, the quantile is sway
    return np.asarray(speed >= _RESTING * fast)
