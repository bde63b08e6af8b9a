"""The two pressures with which a cylinder is nearest to a prescribed linear spring.

The torque and the stiffness of a cylinder are linear in the sealed pressures. The pressures for a spring at its rest
angle are therefore the solution of two linear equations; those nearest to it over a range are a linear least-squares
solution. Both are bounded by the lowest pressure and the supply.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import Cylinder, PressureLimits, Setting

_GRID = 361
_CLOSE = 0.01  # of the stiffness, and rad: a spring within these is attained


@dataclass(frozen=True)
class NearestSpring:
    """A setting of the cylinder, and the spring that it gives.

    Parameters
    ----------
    setting : Setting
    stiffness, rest : float
        Stiffness, N·m/rad, and rest angle, rad, that the setting gives: at the rest angle, or of the line fitted over
        the range; NaN if the torque is not zero anywhere in the stroke.
    largest_error, rms_error : float
        Difference between the torques of the cylinder and of the prescribed spring over the range, N·m.
    range : (low, high)
        rad.
    why : str
        Why the spring is not attained; empty if it is.
    """

    setting: Setting
    stiffness: float
    rest: float
    largest_error: float
    rms_error: float
    range: tuple[float, float]
    why: str


def nearest_setting(
    cylinder: Cylinder, stiffness: float, rest: float, limits: PressureLimits, angles: FloatArray | None = None
) -> NearestSpring:
    """Find the setting that is nearest to a linear spring with torque -k(θ - θ₀).

    Parameters
    ----------
    cylinder : Cylinder
    stiffness, rest : float
        k, N·m/rad, and θ₀, rad.
    limits : PressureLimits
    angles : (N,) array, optional
        Angles over which the torque should agree, rad; those beyond the stroke are left out. By default, stiffness
        and torque should agree at the rest angle, or the torque over the whole stroke if θ₀ is beyond it.

    Raises
    ------
    ValueError
        No angle is within the stroke.
    """
    low, high = cylinder.limits
    local = angles is None and low <= rest <= high
    grid = np.linspace(low, high, _GRID) if angles is None else angles[(angles >= low) & (angles <= high)]
    if not len(grid):
        raise ValueError(
            f"the stroke allows {np.degrees(low):.1f}° to {np.degrees(high):.1f}°: no angle of the range is within it"
        )
    if local:
        weight = 0.25 * (high - low)  # rad: an error of stiffness counts as the torque at this distance
        at = np.array(rest)
        matrix = np.stack([cylinder.torque_by_pressure(at), -weight * cylinder.stiffness_by_pressure(at)])
        wanted = np.array([-cylinder.torque_of_atmosphere(), -weight * stiffness])
    else:
        matrix = cylinder.torque_by_pressure(grid)
        wanted = -stiffness * (grid - rest) - cylinder.torque_of_atmosphere()
    free = np.linalg.lstsq(matrix * limits.supply, wanted, rcond=None)[0] * limits.supply
    share = lsq_linear(matrix * limits.supply, wanted, (limits.lowest / limits.supply, 1.0), method="bvls").x
    setting = Setting(*(share * limits.supply).tolist())
    found = _stiffness_and_rest(cylinder, setting, grid, local)
    error = cylinder.torque(grid, setting) + stiffness * (grid - rest)
    why = _why(free, limits, (stiffness, rest), found, cylinder)
    spread = float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))
    return NearestSpring(setting, *found, *spread, (float(grid.min()), float(grid.max())), why)


def _stiffness_and_rest(cylinder: Cylinder, setting: Setting, grid: FloatArray, local: bool) -> tuple[float, float]:
    if local:
        rest = cylinder.rest_angle(setting)
        at = np.nan if rest is None else rest
        return float(cylinder.stiffness(np.array(at), setting)), at
    line = np.stack([grid, np.ones_like(grid)], axis=1)
    slope, offset = np.linalg.lstsq(line, cylinder.torque(grid, setting), rcond=None)[0]
    return -float(slope), float(-offset / slope) if slope else np.nan


def _why(
    free: FloatArray,
    limits: PressureLimits,
    wanted: tuple[float, float],
    found: tuple[float, float],
    cylinder: Cylinder,
) -> str:
    (stiffness, rest), (low, high) = wanted, cylinder.limits
    parts = []
    for name, pressure in zip(("flexion", "extension"), free.tolist(), strict=True):
        if pressure > limits.supply * (1 + 1e-9):
            parts.append(f"the {name} side would need {pressure:.0f} Pa, the supply has {limits.supply:.0f} Pa")
        elif pressure < limits.lowest * (1 - 1e-9):
            parts.append(f"the {name} side would need {pressure:.0f} Pa, the lowest is {limits.lowest:.0f} Pa")
    if not low <= rest <= high:
        limit = f"{np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
        parts.append(f"the rest angle {np.degrees(rest):.1f}° is beyond the stroke, {limit}")
    close = abs(found[0] - stiffness) <= _CLOSE * stiffness and abs(found[1] - rest) <= _CLOSE
    return "" if close else "; ".join(parts or ["the torque of a cylinder is not linear over this range"])
