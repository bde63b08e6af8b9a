"""Torque, stiffness and gas of a double-acting cylinder on a pulley at a joint (thesis 8.1.1, figure 8.1).

Both chambers are sealed with the joint fully flexed. The rod then travels x = r(θ_full - θ). The gas of a sealed
chamber follows P Vⁿ = constant, from n = 1 (slow, isothermal) to n = 1.4 (fast, adiabatic):

    V_f = A_f (d_f + s - x),  V_e = A_e (d_e + x),  P = P₀ (V₀/V)ⁿ
    τ = r (A_f (P_f - P_atm) - A_e (P_e - P_atm))
    K = -dτ/dθ = n r² (A_f² P_f/V_f + A_e² P_e/V_e)

Pressures are absolute, angles and torques are positive in flexion. The torque is linear in the sealed pressures P₀. A
chamber that is open to the atmosphere causes no torque and no stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

ISOTHERMAL, ADIABATIC = 1.0, 1.4  # exponents of air for slow and fast changes of volume
_COULOMB_SPEED = 0.05  # rad/s: below this speed, Coulomb friction grows with the speed
_GRID = 721  # number of angles between which the zero of the torque is searched
_ROUNDING = 1e-12  # fraction of the largest torque


@dataclass(frozen=True)
class Setting:
    """Absolute pressures at which the chambers are sealed, Pa; None for a chamber open to the atmosphere."""

    flexion: float | None
    extension: float | None

    @property
    def sealed(self) -> tuple[bool, bool]:
        return self.flexion is not None, self.extension is not None

    def pressures(self) -> FloatArray:
        """Return both sealed pressures (2,), Pa; 0 for an open chamber, whose pressure has no effect."""
        return np.array([self.flexion or 0.0, self.extension or 0.0])


@dataclass(frozen=True)
class PressureLimits:
    """Lowest and highest absolute pressure that can be sealed, Pa."""

    lowest: float
    supply: float


@dataclass(frozen=True)
class Cylinder:
    """A double-acting cylinder on a pulley.

    ValueError is raised if a dimension or the atmosphere is not above zero, or a friction or dead length is negative.

    Examples
    --------
    20 mm bore, 100 mm stroke, dead lengths of 10 mm and a pulley of 30 mm radius, 50 psi above the atmosphere on both
    sides, in the middle of the stroke:

    >>> area = np.pi * 0.01**2
    >>> cylinder = Cylinder(0.03, area, area, 0.01, 0.01, 0.1, 1.0, 1.4)
    >>> middle = np.array(1.0 - 0.05 / 0.03)
    >>> setting = Setting(*(446e3 / cylinder.compression(middle)))
    >>> print(round(float(cylinder.stiffness(middle, setting)), 1))
    5.9
    """

    pulley_radius: float  # m
    area_flexion: float  # piston area of the chamber that flexes the joint, m²; the rod reduces one of the areas
    area_extension: float  # piston area of the chamber that extends the joint, m²
    dead_flexion: float  # volume of ports and hoses in addition to the stroke, divided by the area, m
    dead_extension: float  # m
    stroke: float  # m
    full_flexion: float  # angle of the joint at one end of the stroke, at which the chambers are sealed, rad
    exponent: float = ISOTHERMAL  # n
    coulomb: float = 0.0  # Coulomb friction at the joint, N·m
    viscous: float = 0.0  # viscous friction at the joint, N·m·s/rad
    atmosphere: float = 101_325.0  # Pa

    def __post_init__(self) -> None:
        sizes = (self.pulley_radius, self.area_flexion, self.area_extension, self.stroke, self.atmosphere)
        if not all(0 < size < np.inf for size in sizes):
            raise ValueError("radius, areas, stroke and atmosphere of a cylinder must be above zero")
        if min(self.dead_flexion, self.dead_extension, self.coulomb, self.viscous) < 0:
            raise ValueError("dead lengths and friction of a cylinder must not be below zero")

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the joint that the stroke allows, rad."""
        return self.full_flexion - self.stroke / self.pulley_radius, self.full_flexion

    def allows(self, angle: FloatArray) -> BoolArray:
        low, high = self.limits
        return np.asarray((angle >= low - 1e-9) & (angle <= high + 1e-9))

    def volumes(self, angle: FloatArray) -> FloatArray:
        """Return the volumes (..., 2) of the flexion and the extension chamber, m³."""
        x = self.pulley_radius * (self.full_flexion - np.asarray(angle))
        flexion = self.area_flexion * (self.dead_flexion + self.stroke - x)
        return np.stack([flexion, self.area_extension * (self.dead_extension + x)], axis=-1)

    def compression(self, angle: FloatArray) -> FloatArray:
        """Return P/P₀ (..., 2) of sealed chambers at angles, rad; NaN where the volume is zero."""
        volumes = self.volumes(angle)
        ratio = self.volumes(np.asarray(self.full_flexion)) / np.where(volumes > 0, volumes, np.nan)
        return np.asarray(ratio**self.exponent)

    def torque_by_pressure(self, angle: FloatArray, sealed: tuple[bool, bool] = (True, True)) -> FloatArray:
        """Return the derivatives (..., 2) of the torque by both pressures, N·m/Pa; that of an open chamber is zero."""
        signed = np.array([self.area_flexion * sealed[0], -self.area_extension * sealed[1]])
        return np.asarray(self.pulley_radius * signed * self.compression(angle))

    def stiffness_by_pressure(self, angle: FloatArray, sealed: tuple[bool, bool] = (True, True)) -> FloatArray:
        """Return the derivatives (..., 2) of the stiffness by the sealed pressures, N·m/(rad Pa), at angles, rad."""
        areas = np.array([self.area_flexion * sealed[0], self.area_extension * sealed[1]])
        each = areas**2 * self.compression(angle) / self.volumes(angle)
        return np.asarray(self.exponent * self.pulley_radius**2 * each)

    def torque_of_atmosphere(self, sealed: tuple[bool, bool] = (True, True)) -> float:
        """Return the torque of the atmosphere's pressure on the piston areas of the sealed chambers, N·m."""
        signed = self.area_flexion * sealed[0] - self.area_extension * sealed[1]
        return -self.pulley_radius * signed * self.atmosphere

    def torque(self, angle: FloatArray, setting: Setting) -> FloatArray:
        """Return the torque on the joint without friction, N·m; NaN beyond the stroke."""
        by_pressure = self.torque_by_pressure(angle, setting.sealed)
        torque = by_pressure @ setting.pressures() + self.torque_of_atmosphere(setting.sealed)
        return np.where(self.allows(angle), torque, np.nan)

    def friction(self, velocity: FloatArray) -> FloatArray:
        """Return the friction torque, N·m, at velocities of the joint, rad/s; it opposes the motion."""
        velocity = np.asarray(velocity)
        return np.asarray(-self.coulomb * np.tanh(velocity / _COULOMB_SPEED) - self.viscous * velocity)

    def stiffness(self, angle: FloatArray, setting: Setting) -> FloatArray:
        """Return the stiffness -dτ/dθ without friction, N·m/rad; NaN beyond the stroke."""
        stiffness = self.stiffness_by_pressure(angle, setting.sealed) @ setting.pressures()
        return np.where(self.allows(angle), stiffness, np.nan)

    def rest_angle(self, setting: Setting) -> float | None:
        """Return the angle at which the torque is zero, rad; None if there is none within the stroke."""
        angle = np.linspace(*self.limits, _GRID)
        torque = self.torque(angle, setting)
        rounding = _ROUNDING * np.abs(torque).max()  # at an end of the stroke, rounding decides the sign of a zero
        crossing = np.flatnonzero((torque[:-1] >= -rounding) & (torque[1:] < rounding))  # the torque decreases
        if not len(crossing):
            return None
        k = int(crossing[0])
        low, high = float(angle[k]), float(angle[k + 1])
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if float(self.torque(np.array(middle), setting)) >= 0 else (low, middle)
        return 0.5 * (low + high)

    def at_exponent(self, exponent: float) -> Cylinder:
        return replace(self, exponent=exponent)


def compute_torque_and_sd(  # noqa: PLR0917
    cylinder: Cylinder,
    setting: Setting,
    angle: FloatArray,
    sds: Mapping[str, float],
    velocity: FloatArray | None = None,
    angle_sd: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the torque of a device on the joint and its standard deviation at angles (N,), rad; (N,) each, N·m.

    Both are NaN beyond the stroke. ``sds`` are standard deviations of fields of :class:`Cylinder`, by name; ``gauge``
    is that of each sealed pressure, Pa. ``angle_sd`` is that of the angle, rad. Without a velocity, rad/s, the torque
    excludes friction, but its standard deviation includes Coulomb friction. The errors of the description are
    independent of each other and constant over the angles, so those of neighbouring samples are the same, not
    independent.
    """
    angle = np.asarray(angle, dtype=np.float64)

    def torque(one: Cylinder) -> FloatArray:  # also slightly beyond the stroke of a changed cylinder
        friction = 0.0 if velocity is None else one.friction(velocity)
        by_pressure = one.torque_by_pressure(angle, setting.sealed)
        return np.asarray(by_pressure @ setting.pressures() + one.torque_of_atmosphere(setting.sealed) + friction)

    variance = (cylinder.stiffness(angle, setting) * angle_sd) ** 2
    if velocity is None:
        variance = variance + cylinder.coulomb**2 / 3  # uniform between flexing and extending
    for name, sd in sds.items():
        if name == "gauge":
            by_pressure = cylinder.torque_by_pressure(angle, setting.sealed)
            variance = variance + (by_pressure**2).sum(axis=-1) * sd**2
            continue
        value = getattr(cylinder, name)
        step = min(0.1 * sd, 0.5 * abs(value))
        if step == 0:
            continue
        more, less = (torque(replace(cylinder, **{name: value + change})) for change in (step, -step))
        variance = variance + ((more - less) / (2 * step) * sd) ** 2
    inside = cylinder.allows(angle)
    return np.where(inside, torque(cylinder), np.nan), np.where(inside, np.sqrt(variance), np.nan)
