"""The two pressures with which a cylinder is nearest to a prescribed linear spring.

The torque and the stiffness of a cylinder are linear in the sealed pressures. The pressures for a spring at its rest
angle are therefore the solution of two linear equations. The nearest pressures over a range are a linear least-squares
solution. Both are bounded by the lowest pressure and the supply.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import Cylinder, PressureLimits, Setting

_GRID = 361
_CLOSE = 0.01  # largest differences of an attained spring: fraction of the stiffness, and rad


@dataclass(frozen=True)
class NearestSpring:
    """A setting of the cylinder, and the spring that it gives."""

    setting: Setting
    stiffness: float  # N·m/rad, at the rest angle, or of the line fitted over the range; NaN without a rest angle
    rest: float  # rest angle, rad; NaN if the torque is not zero at any angle of the stroke
    largest_error: float  # largest difference from the torque of the prescribed spring over the range, N·m
    rms_error: float  # root mean square of this difference, N·m
    range: tuple[float, float]  # range of angles over which the springs are compared, rad
    why: str  # reason why the spring is not attained; empty if it is attained


def find_nearest_setting(
    cylinder: Cylinder, stiffness: float, rest: float, limits: PressureLimits, angles: FloatArray | None = None
) -> NearestSpring:
    """Return the setting nearest to a linear spring of ``stiffness`` k, N·m/rad, and ``rest`` angle θ₀, rad.

    The torques should agree over ``angles`` (N,), rad; angles beyond the stroke are ignored. By default, stiffness and
    torque should agree at the rest angle, or the torque over the whole stroke if θ₀ is beyond it.

    ValueError is raised if no angle is within the stroke.
    """
    low, high = cylinder.limits
    local = angles is None and low <= rest <= high
    grid = np.linspace(low, high, _GRID) if angles is None else angles[(angles >= low) & (angles <= high)]
    if not len(grid):
        raise ValueError(
            f"no angle of the range is within the stroke, {np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
        )
    if local:
        weight = 0.25 * (high - low)  # rad: an error of stiffness counts as the torque at this distance
        angle = np.array(rest)
        matrix = np.stack([cylinder.torque_by_pressure(angle), -weight * cylinder.stiffness_by_pressure(angle)])
        target = np.array([-cylinder.torque_of_atmosphere(), -weight * stiffness])
    else:
        matrix = cylinder.torque_by_pressure(grid)
        target = -stiffness * (grid - rest) - cylinder.torque_of_atmosphere()
    free = np.linalg.lstsq(matrix * limits.supply, target, rcond=None)[0] * limits.supply
    share = lsq_linear(matrix * limits.supply, target, (limits.lowest / limits.supply, 1.0), method="bvls").x
    setting = Setting(*(share * limits.supply).tolist())
    spring = _stiffness_and_rest(cylinder, setting, grid, local)
    error = cylinder.torque(grid, setting) + stiffness * (grid - rest)
    why = _explain(free, limits, (stiffness, rest), spring, cylinder)
    spread = float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))
    return NearestSpring(setting, *spring, *spread, (float(grid.min()), float(grid.max())), why)


def _stiffness_and_rest(cylinder: Cylinder, setting: Setting, grid: FloatArray, local: bool) -> tuple[float, float]:
    """Return the stiffness, N·m/rad, and the rest angle, rad, at the rest angle or of a line fitted over the grid."""
    if local:
        rest = cylinder.rest_angle(setting)
        angle = np.nan if rest is None else rest
        return float(cylinder.stiffness(np.array(angle), setting)), angle
    line = np.stack([grid, np.ones_like(grid)], axis=1)
    slope, offset = np.linalg.lstsq(line, cylinder.torque(grid, setting), rcond=None)[0]
    return -float(slope), float(-offset / slope) if slope else np.nan


def _explain(
    free: FloatArray,
    limits: PressureLimits,
    target: tuple[float, float],
    attained: tuple[float, float],
    cylinder: Cylinder,
) -> str:
    """Return the reasons why the target (stiffness, rest angle) is not attained; empty if it is attained."""
    (stiffness, rest), (low, high) = target, cylinder.limits
    parts = []
    for name, pressure in zip(("flexion", "extension"), free.tolist(), strict=True):
        if pressure > limits.supply * (1 + 1e-9):
            parts.append(f"the {name} chamber would need {pressure:.0f} Pa, but the supply has {limits.supply:.0f} Pa")
        elif pressure < limits.lowest * (1 - 1e-9):
            parts.append(f"the {name} chamber would need {pressure:.0f} Pa, but the lowest is {limits.lowest:.0f} Pa")
    if not low <= rest <= high:
        limit = f"{np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
        parts.append(f"the rest angle {np.degrees(rest):.1f}° is beyond the stroke, {limit}")
    close = abs(attained[0] - stiffness) <= _CLOSE * stiffness and abs(attained[1] - rest) <= _CLOSE
    return "" if close else "; ".join(parts or ["the torque of a cylinder is not linear over this range"])
