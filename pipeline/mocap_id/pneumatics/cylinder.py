"""Torque and stiffness of a double-acting cylinder that turns a joint through a pulley (thesis 8.1.1, figure 8.1).

Both chambers are sealed with the joint fully flexed. The rod then travels x = r(θ_full - θ). The gas of a sealed
chamber follows P Vⁿ = constant, from n = 1 (slow, isothermal) to n = 1.4 (fast, adiabatic):

    V_f = A_f (d_f + s - x),  V_e = A_e (d_e + x),  P = P₀ (V₀/V)ⁿ
    τ = r (A_f (P_f - P_atm) - A_e (P_e - P_atm))
    K = -dτ/dθ = n r² (A_f² P_f/V_f + A_e² P_e/V_e)

Pressures are absolute, angles and torques are positive in flexion. The torque is linear in the sealed pressures P₀. A
chamber that is open to the atmosphere gives no torque and no stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

ISOTHERMAL, ADIABATIC = 1.0, 1.4
"""Exponents of slow and fast changes of volume of air."""
_COULOMB_SPEED = 0.05  # rad/s: below this speed, Coulomb friction grows with the speed
_GRID = 721  # angles between which the zero of the torque is searched
_ROUNDING = 1e-12  # of the largest torque


@dataclass(frozen=True)
class Setting:
    """Absolute pressures at which the chambers are sealed, Pa; None for a chamber open to the atmosphere."""

    flexion: float | None
    extension: float | None

    @property
    def sealed(self) -> tuple[bool, bool]:
        """Whether the flexion and the extension chamber are sealed."""
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

    Parameters
    ----------
    pulley_radius : float
        m.
    area_flexion, area_extension : float
        Piston area of the chamber that flexes the joint and of the one that extends it, m²; the rod makes one smaller.
    dead_flexion, dead_extension : float
        Volumes beside the stroke (ports, hoses), as a length of the chamber, m.
    stroke : float
        m.
    full_flexion : float
        Angle of the joint at one end of the stroke, at which the chambers are sealed, rad.
    exponent : float
        n.
    coulomb, viscous : float
        Friction at the joint, N·m and N·m·s/rad.
    atmosphere : float
        Pa.

    Raises
    ------
    ValueError
        A size is not above zero, or a friction or dead length is below zero.

    Examples
    --------
    20 mm bore, 100 mm stroke, dead lengths of 10 mm and a pulley of 30 mm radius, 50 psi above the atmosphere on both
    sides, in the middle of the stroke:

    >>> area = np.pi * 0.01**2
    >>> cylinder = Cylinder(0.03, area, area, 0.01, 0.01, 0.1, 1.0, 1.4)
    >>> middle = cylinder.with_pressures_at(1.0 - 0.05 / 0.03, 446e3, 446e3)
    >>> print(round(float(cylinder.stiffness(np.array(1.0 - 0.05 / 0.03), middle)), 1))
    5.9
    """

    pulley_radius: float
    area_flexion: float
    area_extension: float
    dead_flexion: float
    dead_extension: float
    stroke: float
    full_flexion: float
    exponent: float = ISOTHERMAL
    coulomb: float = 0.0
    viscous: float = 0.0
    atmosphere: float = 101_325.0

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

    def within(self, angle: FloatArray) -> BoolArray:
        """Return whether the stroke allows each angle, rad."""
        low, high = self.limits
        return np.asarray((angle >= low - 1e-9) & (angle <= high + 1e-9))

    def volumes(self, angle: FloatArray) -> FloatArray:
        """Return the volumes (..., 2) of the flexion and the extension chamber, m³."""
        x = self.pulley_radius * (self.full_flexion - np.asarray(angle))
        flexion = self.area_flexion * (self.dead_flexion + self.stroke - x)
        return np.stack([flexion, self.area_extension * (self.dead_extension + x)], axis=-1)

    def compression(self, angle: FloatArray) -> FloatArray:
        """Return P/P₀ (..., 2) of sealed chambers; NaN where no volume is left."""
        volumes = self.volumes(angle)
        ratio = self.volumes(np.asarray(self.full_flexion)) / np.where(volumes > 0, volumes, np.nan)
        return np.asarray(ratio**self.exponent)

    def torque_by_pressure(self, angle: FloatArray, sealed: tuple[bool, bool] = (True, True)) -> FloatArray:
        """Return the derivatives (..., 2) of the torque with respect to the sealed pressures, N·m/Pa.

        Parameters
        ----------
        angle : (...) array
            rad.
        sealed : (bool, bool)
            Whether the chambers of flexion and extension are sealed; the derivative of an open one is zero.
        """
        signed = np.array([self.area_flexion * sealed[0], -self.area_extension * sealed[1]])
        return np.asarray(self.pulley_radius * signed * self.compression(angle))

    def stiffness_by_pressure(self, angle: FloatArray, sealed: tuple[bool, bool] = (True, True)) -> FloatArray:
        """Return the derivatives (..., 2) of the stiffness, N·m/(rad Pa); arguments as for `torque_by_pressure`."""
        areas = np.array([self.area_flexion * sealed[0], self.area_extension * sealed[1]])
        each = areas**2 * self.compression(angle) / self.volumes(angle)
        return np.asarray(self.exponent * self.pulley_radius**2 * each)

    def torque_of_atmosphere(self, sealed: tuple[bool, bool] = (True, True)) -> float:
        """Return the torque of the atmosphere on the sealed chambers' areas, N·m."""
        signed = self.area_flexion * sealed[0] - self.area_extension * sealed[1]
        return -self.pulley_radius * signed * self.atmosphere

    def torque(self, angle: FloatArray, setting: Setting) -> FloatArray:
        """Return the torque on the joint without friction, N·m; NaN beyond the stroke."""
        by_pressure = self.torque_by_pressure(angle, setting.sealed)
        torque = by_pressure @ setting.pressures() + self.torque_of_atmosphere(setting.sealed)
        return np.where(self.within(angle), torque, np.nan)

    def friction(self, velocity: FloatArray) -> FloatArray:
        """Return the torque of friction on the joint, N·m, at velocities, rad/s; it acts against them."""
        velocity = np.asarray(velocity)
        return np.asarray(-self.coulomb * np.tanh(velocity / _COULOMB_SPEED) - self.viscous * velocity)

    def stiffness(self, angle: FloatArray, setting: Setting) -> FloatArray:
        """Return the stiffness -dτ/dθ without friction, N·m/rad; NaN beyond the stroke."""
        stiffness = self.stiffness_by_pressure(angle, setting.sealed) @ setting.pressures()
        return np.where(self.within(angle), stiffness, np.nan)

    def rest_angle(self, setting: Setting) -> float | None:
        """Return the angle at which the torque is zero, rad; None if there is none within the stroke."""
        angle = np.linspace(*self.limits, _GRID)
        torque = self.torque(angle, setting)
        rounding = _ROUNDING * np.abs(torque).max()  # at an end of the stroke, rounding decides the sign of a zero
        crossing = np.flatnonzero((torque[:-1] >= -rounding) & (torque[1:] < rounding))  # it falls with the angle
        if not len(crossing):
            return None
        k = int(crossing[0])
        low, high = float(angle[k]), float(angle[k + 1])
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if float(self.torque(np.array(middle), setting)) >= 0 else (low, middle)
        return 0.5 * (low + high)

    def with_pressures_at(self, angle: float, flexion: float, extension: float) -> Setting:
        """Return the setting whose chambers have these absolute pressures, Pa, at an angle, rad."""
        sealed = np.array([flexion, extension]) / self.compression(np.array(angle))
        return Setting(float(sealed[0]), float(sealed[1]))

    def at_exponent(self, exponent: float) -> Cylinder:
        """Return the cylinder with another exponent."""
        return replace(self, exponent=exponent)
