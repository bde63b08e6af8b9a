"""Torques of a person whose chain has cylinders at its joints, and pressures that hold given postures.

At rest, the person needs τ = g(q) - Σ τ_device(q). A posture can be held if every torque is within the limits, for
isothermal and for adiabatic changes of volume. To first order, the distance of a posture from the nearest posture that
cannot be held is the smallest ratio of a torque's reserve to the norm of its gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import (
    ADIABATIC,
    ISOTHERMAL,
    Cylinder,
    PressureLimits,
    excess_torque,
    settle_pressures,
)
from mocap_id.pneumatics.held_angles import RESERVE

_STEP = 1e-4  # rad, of the finite differences


@dataclass(frozen=True)
class Actuator:
    """A cylinder whose travel follows the sum of its joints' angles."""

    cylinder: Cylinder
    limits: PressureLimits
    joints: tuple[int, ...]  # counted from 0
    fill: FloatArray  # (2,) time constants of rising pressures in the flexion and the extension chamber, s
    vent: FloatArray  # (2,) time constants of falling pressures, s
    temperature: float  # temperature of the gas, K


@dataclass(frozen=True)
class AssistedChain:
    """A chain of n joints with D cylinders."""

    # function that returns the torques (M, n), N·m, that hold postures (M, n) with other springs, but without cylinders
    passive: Callable[[FloatArray], FloatArray]
    strength: FloatArray  # (n, 2) limits of the person's torques, N·m
    lower: FloatArray  # (n,) limits of the joints, rad
    upper: FloatArray  # (n,)
    actuators: tuple[Actuator, ...]

    def holding_torques(self, q: FloatArray, pressures: FloatArray, exponent: float | None = None) -> FloatArray:
        """Return the person's torques (M, n), N·m, that hold postures (M, n), rad, with given sealed pressures, Pa.

        ``pressures`` are (M, D, 2), or (1, D, 2) for all postures. ``exponent``, if given, replaces all exponents.
        """
        torque = self.passive(q).copy()
        for d, one in enumerate(self.actuators):
            cylinder = one.cylinder if exponent is None else one.cylinder.at_exponent(exponent)
            by_pressure = cylinder.torque_by_pressure(q[:, list(one.joints)].sum(axis=1))
            pull = (by_pressure * pressures[:, d]).sum(axis=1) + cylinder.torque_of_atmosphere()
            torque[:, list(one.joints)] -= pull[:, None]
        return torque

    def excess(self, needed: FloatArray) -> FloatArray:
        """Return the largest part (M,) of the torques (M, n) beyond the person's limits, N·m; at least 0."""
        return np.asarray(excess_torque(needed, self.strength[:, 0], self.strength[:, 1]).max(axis=1))

    def depth(self, q: FloatArray, pressures: FloatArray) -> FloatArray:
        """Return the distance (M,) of postures from the nearest posture that is not held with pressures (D, 2), rad.

        The distance is a first-order estimate, and negative for a posture that is not held. The limits of the strokes
        count as a boundary, but the limits of the joints do not.
        """
        depth = np.full(len(q), np.inf)
        for one in self.actuators:
            low, high = one.cylinder.limits
            angle = q[:, list(one.joints)].sum(axis=1)
            depth = np.minimum(depth, np.minimum(angle - low, high - angle) / np.sqrt(len(one.joints)))
        steps = _STEP * np.eye(q.shape[1])
        for exponent in (ISOTHERMAL, ADIABATIC):
            here = self.holding_torques(q, pressures[None], exponent)
            slopes = [
                self.holding_torques(q + step, pressures[None], exponent)
                - self.holding_torques(q - step, pressures[None], exponent)
                for step in steps
            ]
            steep = np.linalg.norm(np.stack(slopes), axis=0) / (2 * _STEP)
            reserve = np.minimum(self.strength[:, 1] - here, here - self.strength[:, 0])
            depth = np.minimum(depth, (reserve / np.maximum(steep, 1e-9)).min(axis=1))
        return np.where(np.isfinite(depth), depth, -np.inf)

    def settle(self, pressures: FloatArray, target: FloatArray, time: float) -> FloatArray:
        """Return the pressures (D, 2), Pa, after they have approached ``target`` (D, 2), Pa, for ``time``, s."""
        fill, vent = (np.stack([getattr(one, way) for one in self.actuators]) for way in ("fill", "vent"))
        return settle_pressures(pressures, target, time, fill, vent)

    @property
    def slowest(self) -> float:
        """The largest time constant, s."""
        return float(max(np.max([one.fill, one.vent]) for one in self.actuators))


def find_pressures(chain: AssistedChain, q: FloatArray) -> tuple[FloatArray, float] | None:
    """Return the lowest pressures (D, 2), Pa, that hold postures (M, n) with a reserve, and the fraction they attain.

    The reserve of a joint is :data:`~mocap_id.pneumatics.held_angles.RESERVE` times half the range of its torque, plus
    the Coulomb friction at the joint. If no pressures have this reserve, the pressures with the largest fraction of the
    reserve are returned; a negative fraction means that a posture cannot be held. None is returned if a posture is
    beyond a stroke.
    """
    count = len(chain.actuators)
    reserve = RESERVE * 0.5 * np.ptp(chain.strength, axis=1)
    rows, most, supply = [], [], np.array([one.limits.supply for one in chain.actuators])
    for one in chain.actuators:
        if not one.cylinder.allows(q[:, list(one.joints)].sum(axis=1)).all():
            return None
        reserve[list(one.joints)] += one.cylinder.coulomb
    unit = np.eye(2 * count).reshape(2 * count, count, 2) * supply[:, None]
    for exponent in (ISOTHERMAL, ADIABATIC):
        none = chain.holding_torques(q, np.zeros((1, count, 2)), exponent)
        by = np.stack([chain.holding_torques(q, each[None], exponent) - none for each in unit], axis=-1)  # (M, n, 2D)
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
    solution = widest.x if least.x is None else least.x
    return solution[:-1].reshape(count, 2) * supply[:, None], left
