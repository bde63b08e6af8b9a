"""Torques of a person whose chain carries cylinders, and pressures that hold given postures.

The person needs τ = g(q) - Σ τ_device(q) at rest, and holds a posture if every torque is within the limits, for
isothermal and for adiabatic changes of volume. The distance of a posture from the nearest one that is not held is, to
first order, the smallest reserve of a torque over the length of its gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, PressureLimits
from mocap_id.pneumatics.held_angles import RESERVE

_STEP = 1e-4  # rad, of the finite differences


@dataclass(frozen=True)
class Actuator:
    """A cylinder that pulls the sum of its joints' angles; joints count from 0.

    Parameters
    ----------
    cylinder : Cylinder
    limits : PressureLimits
    joints : tuple of int
    fill, vent : (2,) arrays
        Time constants of the flexion and the extension side for pressures that rise and that fall, s.
    temperature : float
        Of the gas, K.
    """

    cylinder: Cylinder
    limits: PressureLimits
    joints: tuple[int, ...]
    fill: FloatArray
    vent: FloatArray
    temperature: float


@dataclass(frozen=True)
class AssistedChain:
    """A chain of n joints with D cylinders.

    Parameters
    ----------
    passive : callable
        Torques (M, n) that hold postures (M, n) without the cylinders, N·m; springs without a cylinder are part of it.
    strength : (n, 2) array
        Limits of the person's torques, N·m.
    lower, upper : (n,) arrays
        Limits of the joints, rad.
    actuators : tuple of Actuator
    """

    passive: Callable[[FloatArray], FloatArray]
    strength: FloatArray
    lower: FloatArray
    upper: FloatArray
    actuators: tuple[Actuator, ...]

    def needed(self, q: FloatArray, pressures: FloatArray, exponent: float | None = None) -> FloatArray:
        """Return the person's torques (M, n), N·m, that hold postures (M, n) with sealed pressures (M or 1, D, 2), Pa.

        ``exponent`` replaces those of the cylinders.
        """
        torque = self.passive(q).copy()
        for d, one in enumerate(self.actuators):
            cylinder = one.cylinder if exponent is None else one.cylinder.at_exponent(exponent)
            by_pressure = cylinder.torque_by_pressure(q[:, list(one.joints)].sum(axis=1))
            pull = (by_pressure * pressures[:, d]).sum(axis=1) + cylinder.torque_of_atmosphere()
            torque[:, list(one.joints)] -= pull[:, None]
        return torque

    def excess(self, needed: FloatArray) -> FloatArray:
        """Return the largest torque (M,) beyond the person's limits, N·m; at least 0."""
        beyond = np.maximum(needed - self.strength[:, 1], self.strength[:, 0] - needed)
        return np.asarray(np.maximum(beyond, 0.0).max(axis=1))

    def depth(self, q: FloatArray, pressures: FloatArray) -> FloatArray:
        """Return the distance (M,) of postures from the nearest one that is not held with pressures (D, 2), rad.

        It is negative for a posture that is not held, and a first-order estimate. Limits of joints are no boundary.
        """
        found = np.full(len(q), np.inf)
        for one in self.actuators:
            low, high = one.cylinder.limits
            angle = q[:, list(one.joints)].sum(axis=1)
            found = np.minimum(found, np.minimum(angle - low, high - angle) / np.sqrt(len(one.joints)))
        steps = _STEP * np.eye(q.shape[1])
        for exponent in (ISOTHERMAL, ADIABATIC):
            here = self.needed(q, pressures[None], exponent)
            slopes = [
                self.needed(q + step, pressures[None], exponent) - self.needed(q - step, pressures[None], exponent)
                for step in steps
            ]
            steep = np.linalg.norm(np.stack(slopes), axis=0) / (2 * _STEP)
            reserve = np.minimum(self.strength[:, 1] - here, here - self.strength[:, 0])
            found = np.minimum(found, (reserve / np.maximum(steep, 1e-9)).min(axis=1))
        return np.where(np.isfinite(found), found, -np.inf)

    def settled(self, pressures: FloatArray, target: FloatArray, time: float) -> FloatArray:
        """Return the pressures (D, 2), Pa, after a time, s, in which they settle towards a target, Pa."""
        fill, vent = (np.stack([getattr(one, way) for one in self.actuators]) for way in ("fill", "vent"))
        lag = np.where(target > pressures, fill, vent)
        return np.asarray(target + (pressures - target) * np.exp(-time / lag))

    @property
    def slowest(self) -> float:
        """The largest time constant, s."""
        return float(max(np.max([one.fill, one.vent]) for one in self.actuators))


def pressures_for_postures(chain: AssistedChain, q: FloatArray) -> tuple[FloatArray, float] | None:
    """Find the lowest pressures (D, 2), Pa, that hold postures (M, n) with a reserve, and the share of it that is left.

    The reserve of a joint is :data:`~mocap_id.pneumatics.held_angles.RESERVE` of half its range of torque, and the
    Coulomb friction on it. If no pressures leave it, those with the largest share are returned; a negative share means
    that a posture cannot be held. None if a posture is beyond a stroke.
    """
    count = len(chain.actuators)
    reserve = RESERVE * 0.5 * np.ptp(chain.strength, axis=1)
    rows, most, supply = [], [], np.array([one.limits.supply for one in chain.actuators])
    for one in chain.actuators:
        if not one.cylinder.within(q[:, list(one.joints)].sum(axis=1)).all():
            return None
        reserve[list(one.joints)] += one.cylinder.coulomb
    unit = np.eye(2 * count).reshape(2 * count, count, 2) * supply[:, None]
    for exponent in (ISOTHERMAL, ADIABATIC):
        none = chain.needed(q, np.zeros((1, count, 2)), exponent)
        by = np.stack([chain.needed(q, each[None], exponent) - none for each in unit], axis=-1)  # (M, n, 2D)
        share = np.broadcast_to(reserve[:, None], (*none.shape, 1))
        for sign, limit in ((1.0, chain.strength[:, 1]), (-1.0, -chain.strength[:, 0])):
            rows.append(np.concatenate([sign * by, share], axis=-1).reshape(-1, 2 * count + 1))
            most.append((limit - sign * none).reshape(-1))
    matrix, bound = np.concatenate(rows), np.concatenate(most)
    box = [(one.limits.lowest / one.limits.supply, 1.0) for one in chain.actuators for _ in range(2)]
    widest = linprog([0.0] * (2 * count) + [-1.0], matrix, bound, bounds=[*box, (None, None)])
    if widest.x is None:
        return None
    left = min(float(widest.x[-1]), 1.0)
    least = linprog([1.0] * (2 * count) + [0.0], matrix, bound, bounds=[*box, (left - 1e-9, None)])
    found = widest.x if least.x is None else least.x
    return found[:-1].reshape(count, 2) * supply[:, None], left
