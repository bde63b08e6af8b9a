"""States in which a change of the setting is unsafe: the person cannot hold the joint until the pressures settle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.pneumatics.switching import STEP, Controller, Person

_BRAKING = 30.0  # 1/s: rate at which the person brakes, as far as the strength allows
_SETTLED = 5.0  # time constants
_TOLERANCE = 1e-3  # of the person's range of torque


@dataclass(frozen=True)
class TransitionMap:
    """Transitions from one node to another, started in states of a grid.

    Parameters
    ----------
    before, after : int
        Indices of the nodes.
    angle, velocity : (A,), (V,) arrays
        rad, rad/s; angles that can be held with both settings.
    excess : (A, V) array
        Largest torque beyond the person's limits during the transition, N·m.
    switched : (A,) bool array
        Whether the controller changes at this angle.
    unsafe : (A, V) bool array
    """

    before: int
    after: int
    angle: FloatArray
    velocity: FloatArray
    excess: FloatArray
    switched: BoolArray
    unsafe: BoolArray


def map_transition(  # noqa: PLR0917
    person: Person, controller: Controller, before: int, after: int, speed: float, size: tuple[int, int] = (41, 21)
) -> TransitionMap | None:
    """Simulate the transition from every state of the overlap; the person brakes, then holds.

    Parameters
    ----------
    person : Person
    controller : Controller
    before, after : int
        Indices of the nodes.
    speed : float
        Largest speed of the grid, rad/s.
    size : (int, int)
        Number of angles and velocities.

    Returns
    -------
    TransitionMap or None
        None if no angle can be held with both settings.
    """
    both = (controller.nodes[before].depth > 0) & (controller.nodes[after].depth > 0)
    if not both.any():
        return None
    inside = controller.angle[both]
    angles = inside[np.unique(np.linspace(0, len(inside) - 1, size[0]).round().astype(int))]
    velocities = np.linspace(-speed, speed, size[1])
    grid = np.stack(np.meshgrid(angles, velocities, indexing="ij"), axis=-1).reshape(-1, 2)
    angle, velocity = grid[:, 0], grid[:, 1]
    target = controller.nodes[after].setting.pressures()
    pressures = controller.nodes[before].setting.pressures()
    worst = np.zeros(len(grid))
    for _ in range(int(_SETTLED * controller.slowest / STEP)):
        needed = person.needed(angle, pressures[None])
        worst = np.maximum(worst, person.excess(needed))
        angle, velocity, _torque = person.step(angle, velocity, needed, -_BRAKING * velocity)
        pressures = controller.settled(pressures, target, STEP)
    worst = np.maximum(worst, person.excess(person.needed(angle, pressures[None])))
    excess = worst.reshape(len(angles), len(velocities))
    tolerance = _TOLERANCE * (person.joint.torque_high - person.joint.torque_low)
    switched = controller.changes(before, after, angles)
    return TransitionMap(before, after, angles, velocities, excess, switched, excess > tolerance)
