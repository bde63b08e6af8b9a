"""The softest spring that lets a person hold every angle of an interval (thesis 9.6).

Whether a rest angle exists for a stiffness k is three inequalities, each of a largest or smallest of functions that are
linear in k: max w - min w ≤ span, max w - τ_high ≤ k θ_most and min w - τ_low ≥ k θ_least for w = g + kθ. They are
convex in k, so the stiffnesses that will do are an interval, and its lower end is found by bisection, with nothing
missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.prescription.one_joint import OneJoint

_GRID = 721
_STEPS = 200


def least_spring(
    joint: OneJoint, interval: tuple[float, float], rest: tuple[float, float], stiffest: float | None = None
) -> tuple[float, float] | None:
    """Stiffness, N·m/rad, and rest angle, rad, of the softest spring.

    (0, NaN) where none is needed, None where none will do.

    Parameters
    ----------
    joint : OneJoint
    interval : (low, high)
        Angles that are to be held, rad; a point where both are the same.
    rest : (low, high)
        Allowed rest angles, rad.
    stiffest : float, optional
        N·m/rad; by default twenty times what gravity asks.
    """
    grid = np.linspace(*interval, _GRID) if interval[1] > interval[0] else np.array([interval[0]])
    gravity = joint.gravity(grid)

    def excess(k: float) -> float:
        w = gravity + k * grid
        above, below = w.max() - joint.torque_high, w.min() - joint.torque_low
        return float(max(above - below, above - k * rest[1], k * rest[0] - below)) / joint.weight

    if excess(0.0) <= 1e-9:
        return 0.0, np.nan
    low, high = 0.0, 20.0 * joint.weight if stiffest is None else stiffest
    best = _lowest(excess, low, high)
    if excess(best) > 1e-9:
        return None
    outside, inside = 0.0, best
    for _ in range(_STEPS):
        middle = 0.5 * (outside + inside)
        outside, inside = (outside, middle) if excess(middle) <= 1e-9 else (middle, inside)
    return inside, _rest(joint, gravity + inside * grid, inside, rest)


def _lowest(excess: Callable[[float], float], low: float, high: float) -> float:
    """Where a convex function is lowest, or the first point seen where it is at most 0, by thirds."""
    for _ in range(_STEPS):
        one, other = low + (high - low) / 3, high - (high - low) / 3
        here, there = excess(one), excess(other)
        if min(here, there) <= 0:
            return one if here <= 0 else other
        low, high = (low, other) if here <= there else (one, high)
    return 0.5 * (low + high)


def _rest(joint: OneJoint, w: FloatArray, stiffness: float, rest: tuple[float, float]) -> float:
    middle = 0.5 * (w.max() - joint.torque_high + w.min() - joint.torque_low) / stiffness
    return float(np.clip(middle, *rest))
