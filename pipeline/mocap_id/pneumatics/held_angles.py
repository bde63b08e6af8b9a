"""Angles that a person can hold with a cylinder on one joint, and pressures for the widest range or for given tasks.

The joint is held where g(θ) - τ(θ) is within the limits of the person's torque, for isothermal and for adiabatic
changes of volume: a posture is reached fast, and the gas then reaches the temperature of its surroundings. Friction is
ignored, because it helps to hold the joint. τ is linear in the sealed pressures. The pressures that hold given angles
with the largest margin are therefore the solution of a linear programme.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.pneumatics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, PressureLimits, Setting
from mocap_id.prescription.one_joint import OneJoint

RESERVE = 0.1
"""Reserve of torque in tasks, in addition to friction, as a fraction of half the range of the person's torque."""
_SEARCH, _SIDE, _LEVELS, _FINE = 361, 33, 5, 2881  # angles and pressures of the grids; levels of the search
_TASK = 41  # number of angles of each task
_SLACK = 1e-6  # tolerance of the limits, as a fraction of the largest gravitational moment


def find_holdable(joint: OneJoint, cylinder: Cylinder, setting: Setting, angle: FloatArray) -> BoolArray:
    """Return whether each angle (N,), rad, can be held with a setting; False beyond the stroke."""
    slack = _SLACK * joint.weight
    torque = [joint.gravity(angle) - each.torque(angle, setting) for each in _slow_and_fast(cylinder)]
    return np.asarray(np.all([(t >= joint.torque_low - slack) & (t <= joint.torque_high + slack) for t in torque], 0))


def _slow_and_fast(cylinder: Cylinder) -> tuple[Cylinder, Cylinder]:
    """Return the cylinder for isothermal and for adiabatic changes of volume."""
    return cylinder.at_exponent(ISOTHERMAL), cylinder.at_exponent(ADIABATIC)


def find_held_range(
    joint: OneJoint, cylinder: Cylinder, setting: Setting, required: Sequence[float] = ()
) -> tuple[float, float] | None:
    """Return the widest interval that can be held and contains all required angles, rad; None if there is none."""
    angle = np.linspace(joint.lower, joint.upper, _FINE)
    held = find_holdable(joint, cylinder, setting, angle)
    parts = [(float(angle[run.start]), float(angle[run.stop - 1])) for run in find_runs(held)]
    step = float(angle[1] - angle[0])
    fitting = [part for part in parts if all(part[0] - step <= one <= part[1] + step for one in required)]
    return max(fitting, key=lambda part: part[1] - part[0], default=None)


def find_widest_setting(
    joint: OneJoint, cylinder: Cylinder, limits: PressureLimits, start: Setting, required: Sequence[float] = ()
) -> Setting:
    """Return the setting with the widest interval that can be held, by a search on ever finer grids of pressures.

    The result is at least as good as ``start``, such as the setting of the nearest spring. The interval must contain
    the ``required`` angles, rad.
    """
    best, worth = start, _held_width(joint, cylinder, start, required)
    centre, half = 0.5 * (limits.lowest + limits.supply) * np.ones(2), 0.5 * (limits.supply - limits.lowest)
    angle = np.linspace(joint.lower, joint.upper, _SEARCH)
    for _ in range(_LEVELS):
        sides = [np.clip(np.linspace(c - half, c + half, _SIDE), limits.lowest, limits.supply) for c in centre]
        pressures = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        width = _held_widths(joint, cylinder, angle, pressures, required) - 1e-3 * pressures.sum(axis=1) / limits.supply
        for top in np.argsort(-width)[:3]:
            trial = Setting(*pressures[top].tolist())
            other = _held_width(joint, cylinder, trial, required)
            if other > worth:
                best, worth = trial, other
        centre, half = best.pressures(), half / 6
    return best


def _held_width(joint: OneJoint, cylinder: Cylinder, setting: Setting, required: Sequence[float]) -> float:
    part = find_held_range(joint, cylinder, setting, required)
    return -1.0 if part is None else part[1] - part[0]


def _held_widths(
    joint: OneJoint, cylinder: Cylinder, angle: FloatArray, pressures: FloatArray, required: Sequence[float]
) -> FloatArray:
    """Return the width (M,) of the widest suitable held interval for pressures (M, 2), rad; -1 if there is none."""
    held = np.repeat(cylinder.allows(angle)[:, None], len(pressures), axis=1)  # (N, M)
    for each in _slow_and_fast(cylinder):
        torque = each.torque_by_pressure(angle) @ pressures.T + each.torque_of_atmosphere()
        needed = joint.gravity(angle)[:, None] - torque
        held &= (needed >= joint.torque_low) & (needed <= joint.torque_high)
    step = float(angle[1] - angle[0])
    first, last = (len(angle), -1) if not required else (int((min(required) - angle[0]) / step), 0)
    if required:
        last = int(np.ceil((max(required) - angle[0]) / step))
        held[:, ~held[first : last + 1].all(axis=0)] = False
    run = np.zeros(len(pressures), dtype=np.int64)
    most = run.copy()
    for k, row in enumerate(held):
        run = (run + 1) * row
        # only intervals that contain all required angles count
        counts = np.ones(len(run), dtype=bool) if not required else (k >= last) & (run > k - first)
        most = np.where(counts, np.maximum(most, run), most)
    return np.where(most > 0, (most - 1) * step, -1.0)


def find_task_setting(
    joint: OneJoint, cylinder: Cylinder, limits: PressureLimits, tasks: Sequence[tuple[float, float]]
) -> tuple[Setting, float] | None:
    """Return the lowest pressures that hold all tasks with a reserve, and the margin with these pressures, N·m.

    Tasks are intervals of angles, rad; None is returned if one of them is beyond the stroke. The reserve is
    :data:`RESERVE` plus the Coulomb friction, so that the person can also move. If no pressures have this reserve, the
    pressures with the largest margin are returned. If the margin is negative, some angle of a task cannot be held.
    """
    angle = np.concatenate([np.linspace(low, high, _TASK) for low, high in tasks])
    if not cylinder.allows(angle).all():
        return None
    by = np.concatenate([each.torque_by_pressure(angle) for each in _slow_and_fast(cylinder)]) * limits.supply
    needed = np.tile(joint.gravity(angle) - cylinder.torque_of_atmosphere(), 2)
    ones = np.ones((len(needed), 1))
    rows = np.concatenate([np.hstack([-by, ones]), np.hstack([by, ones])])  # variables: pressures / supply, margin
    most = np.concatenate([joint.torque_high - needed, needed - joint.torque_low])
    bounds = [(limits.lowest / limits.supply, 1.0)] * 2
    widest = linprog([0.0, 0.0, -1.0], rows, most, bounds=[*bounds, (None, None)])
    if widest.x is None:
        return None
    reserve = RESERVE * 0.5 * (joint.torque_high - joint.torque_low) + cylinder.coulomb
    margin = min(float(widest.x[2]), reserve)
    least = linprog([1.0, 1.0, 0.0], rows, most, bounds=[*bounds, (margin - 1e-9, None)])
    share = widest.x if least.x is None else least.x
    return Setting(*(share[:2] * limits.supply).tolist()), margin
