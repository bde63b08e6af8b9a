"""Unsafe states for a change of the setting: the person cannot hold the joint while the pressures settle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.pneumatics.switching import STEP, Controller, Person

_BRAKING = 30.0  # 1/s: rate at which the person brakes, as far as the strength allows
_SETTLED = 5.0  # simulated time constants
_TOLERANCE = 1e-3  # share of the range of the person's torque


@dataclass(frozen=True)
class TransitionMap:
    """Transitions from one node to another that start in the states of a grid."""

    before: int  # indices of the nodes
    after: int
    angle: FloatArray  # (A,) angles that can be held with both settings, rad
    velocity: FloatArray  # (V,) rad/s
    excess: FloatArray  # (A, V) largest torque beyond the person's limits during the transition, N·m
    switched: BoolArray  # (A,) whether the controller changes at this angle
    unsafe: BoolArray  # (A, V)


def map_transition(  # noqa: PLR0917
    person: Person, controller: Controller, before: int, after: int, speed: float, size: tuple[int, int] = (41, 21)
) -> TransitionMap | None:
    """Return the simulated transitions from all states that both nodes hold; the person brakes, then holds.

    The result is None if no angle can be held with both settings. ``before`` and ``after`` are indices of nodes;
    ``speed`` is the largest speed of the grid, rad/s; ``size`` is the number of its angles and velocities.
    """
    both = (controller.nodes[before].depth > 0) & (controller.nodes[after].depth > 0)
    if not both.any():
        return None
    held = controller.angle[both]
    angles = held[np.unique(np.linspace(0, len(held) - 1, size[0]).round().astype(int))]
    velocities = np.linspace(-speed, speed, size[1])
    grid = np.stack(np.meshgrid(angles, velocities, indexing="ij"), axis=-1).reshape(-1, 2)
    angle, velocity = grid[:, 0], grid[:, 1]
    target = controller.nodes[after].setting.pressures()
    pressures = controller.nodes[before].setting.pressures()
    worst = np.zeros(len(grid))
    for _ in range(int(_SETTLED * controller.slowest / STEP)):
        needed = person.holding_torque(angle, pressures[None])
        worst = np.maximum(worst, person.excess(needed))
        angle, velocity, _torque = person.step(angle, velocity, needed, -_BRAKING * velocity)
        pressures = controller.settle(pressures, target, STEP)
    worst = np.maximum(worst, person.excess(person.holding_torque(angle, pressures[None])))
    excess = worst.reshape(len(angles), len(velocities))
    tolerance = _TOLERANCE * (person.joint.torque_high - person.joint.torque_low)
    switched = controller.may_change(before, after, angles)
    return TransitionMap(before, after, angles, velocities, excess, switched, excess > tolerance)
