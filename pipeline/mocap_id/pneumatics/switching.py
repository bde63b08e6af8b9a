"""Hybrid controller that switches between sub-workspaces, simulated for one joint with a cylinder (thesis 9.6).

Each node of the controller has a setting of the cylinder and the angles that the person can hold with it. The depth of
an angle in a node is its distance from the nearest angle that is not held. The controller changes from node i to j
where the depth in i is below a margin, and the depth in j is above margin plus hysteresis. Before the controller
changes back, the joint has to move by at least the hysteresis. After a change, each sealed pressure settles with a
first-order lag. The person follows a reference with the torque that the motion needs, as far as the strength allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.pneumatics.cylinder import Cylinder, Setting, excess_torque, settle_pressures
from mocap_id.prescription.one_joint import OneJoint

STEP = 0.002
"""Time step of the simulation, s."""
_TRACKING = 12.0  # rad/s: bandwidth of the person's corrections
_STARTS = 4.0  # 1/s: largest acceleration of a tour divided by its largest speed


@dataclass(frozen=True)
class Node:
    """A node of the controller: its setting, and the depth of each grid angle (N,), rad."""

    name: str
    setting: Setting
    depth: FloatArray


@dataclass(frozen=True)
class Controller:
    """Nodes and rules of the controller."""

    nodes: tuple[Node, ...]
    angle: FloatArray  # (N,) grid of angles of the nodes' depths, rad
    margin: float  # depth below which the controller leaves a node, rad
    hysteresis: float  # additional depth of the next node, rad
    fill: FloatArray  # (2,) time constants of rising pressures in the flexion and the extension chamber, s
    vent: FloatArray  # (2,) time constants of falling pressures, s

    @property
    def slowest(self) -> float:
        """The largest time constant, s."""
        return float(np.max([self.fill, self.vent]))

    def depth(self, node: int, angle: FloatArray) -> FloatArray:
        """Return the depth of angles in a node, rad."""
        return np.asarray(np.interp(angle, self.angle, self.nodes[node].depth))

    def may_change(self, before: int, after: int, angle: FloatArray) -> BoolArray:
        """Return whether the controller may change from one node to another at each angle, rad."""
        return np.asarray(
            (self.depth(before, angle) < self.margin) & (self.depth(after, angle) > self.margin + self.hysteresis)
        )

    def next_node(self, node: int, angle: float) -> int:
        """Return the next node at an angle, rad: the allowed node with the largest depth, or else the same node."""
        at = np.array(angle)
        others = [k for k in range(len(self.nodes)) if k != node and bool(self.may_change(node, k, at))]
        return max(others, key=lambda k: float(self.depth(k, at)), default=node)

    def settle(self, pressures: FloatArray, target: FloatArray, time: float) -> FloatArray:
        """Return the pressures (..., 2), Pa, after they have approached ``target`` (..., 2), Pa, for ``time``, s."""
        return settle_pressures(pressures, target, time, self.fill, self.vent)


def compute_depths(held: BoolArray, angle: FloatArray) -> FloatArray:
    """Return the distance (N,) of each angle from the nearest angle that is not held, rad.

    For an angle that is not held, it is minus the distance from the nearest held angle. The ends of the grid do not
    count as a boundary. If all angles are held, every depth is the width of the grid.
    """
    width = float(angle[-1] - angle[0])
    if held.all() or not held.any():
        return np.full(len(angle), width if held.all() else -width)
    apart = np.abs(angle[:, None] - angle)
    inside = np.where(held, np.inf, apart).min(axis=1)
    return np.asarray(np.where(held, inside, -np.where(held, apart, np.inf).min(axis=1)))


@dataclass(frozen=True)
class Person:
    """A person's joint with its limits of angle and torque, and the device on it."""

    joint: OneJoint
    inertia: float  # kg·m²
    cylinder: Cylinder

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the joint within the stroke of the device, rad."""
        low, high = self.cylinder.limits
        return max(low, self.joint.lower), min(high, self.joint.upper)

    def holding_torque(self, angle: FloatArray, pressures: FloatArray) -> FloatArray:
        """Return the person's torque (B,), N·m, that holds angles (B,), rad, with sealed pressures (B, 2), Pa."""
        device = (self.cylinder.torque_by_pressure(angle) * pressures).sum(axis=-1)
        return np.asarray(self.joint.gravity(angle) - device - self.cylinder.torque_of_atmosphere())

    def excess(self, needed: FloatArray) -> FloatArray:
        """Return the part of a torque beyond the person's limits, N·m; at least 0."""
        return excess_torque(needed, self.joint.torque_low, self.joint.torque_high)

    def step(
        self, angle: FloatArray, velocity: FloatArray, needed: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angle, velocity and the person's torque (B,) after a step with an intended acceleration, rad/s²."""
        friction = self.cylinder.friction(velocity)
        torque = np.clip(needed - friction + self.inertia * acceleration, self.joint.torque_low, self.joint.torque_high)
        velocity = velocity + STEP * (torque - needed + friction) / self.inertia
        moved = angle + STEP * velocity
        angle = np.clip(moved, *self.limits)
        return angle, np.where(moved == angle, velocity, 0.0), torque


@dataclass(frozen=True)
class Visit:
    """A visit of a task in a tour."""

    task: str
    time: tuple[float, float]  # start and end, s
    held_until: tuple[float, float]  # last time at which each end of the task is held, s


@dataclass(frozen=True)
class Tour:
    """Reference motion through all tasks, with T samples."""

    time: FloatArray  # (T,) s
    angle: FloatArray  # (T,) rad
    velocity: FloatArray  # (T,) rad/s
    acceleration: FloatArray  # (T,) rad/s²
    visits: tuple[Visit, ...]


@dataclass(frozen=True)
class SwitchedMotion:
    """A simulated tour with the controller, with T samples."""

    tour: Tour
    angle: FloatArray  # (T,) rad
    velocity: FloatArray  # (T,) rad/s
    torque: FloatArray  # (T,) the person's torque, N·m
    excess: FloatArray  # (T,) part of the holding torque beyond the person's limits, N·m
    node: IntArray  # (T,) index of the current node
    pressures: FloatArray  # (T, 2) sealed pressures, Pa
    switches: tuple[tuple[int, int, int], ...]  # sample, node before and node after each change


def plan_tour(tasks: Sequence[tuple[str, float, float]], speed: float, hold: float, tremor: float = 0.0) -> Tour:
    """Return a tour that visits all tasks (name, low, high), rad, in order and back, and moves through each interval.

    ``speed`` is the largest speed of a movement, rad/s; each movement has minimum jerk and a bounded acceleration. The
    ends of each task are held for ``hold``, s. ``tremor`` is the amplitude of a tremor of 5 Hz, rad.
    """
    order = [*tasks, *tasks[-2::-1]]
    pieces, visits, here, now = [np.array([order[0][1]])], [], order[0][1], 0.0
    for name, low, high in order:
        ends = (low, high) if abs(low - here) <= abs(high - here) else (high, low)
        arrivals, departures = [], []
        for end in ends:
            distance = abs(end - here)
            duration = max(1.875 * distance / speed, np.sqrt(5.7735 * distance / (_STARTS * speed)), STEP)
            s = np.arange(1, int(np.ceil(duration / STEP)) + 1) * STEP / duration
            s = np.minimum(s, 1.0)
            still = np.full(int(hold / STEP), end)
            pieces += [here + (end - here) * (10 * s**3 - 15 * s**4 + 6 * s**5), still]
            arrivals.append(now + len(s) * STEP)
            now, here = arrivals[-1] + len(still) * STEP, end
            departures.append(now)
        visits.append(Visit(name, (arrivals[0], now), (departures[0], departures[1])))
    angle: FloatArray = np.concatenate(pieces)
    time = np.asarray(STEP * np.arange(len(angle)), dtype=np.float64)
    angle += tremor * np.sin(2 * np.pi * 5.0 * time)
    velocity: FloatArray = np.gradient(angle, STEP)
    acceleration: FloatArray = np.gradient(velocity, STEP)
    return Tour(time, angle, velocity, acceleration, tuple(visits))


def simulate_switching(person: Person, controller: Controller, tour: Tour, start: int) -> SwitchedMotion:
    """Return the simulated tour that starts in node ``start``."""
    count, node = len(tour.time), start
    angle, velocity = np.clip(tour.angle[:1], *person.limits), np.zeros(1)
    pressures = controller.nodes[start].setting.pressures()
    track, nodes = np.empty((count, 4)), np.empty(count, dtype=np.int64)
    gas, switches = np.empty((count, 2)), []
    for k in range(count):
        after = controller.next_node(node, float(angle[0])) if k % 5 == 0 else node
        if after != node:
            switches.append((k, node, after))
            node = after
        needed = person.holding_torque(angle, pressures[None])
        track[k] = angle[0], velocity[0], 0.0, person.excess(needed)[0]
        nodes[k], gas[k] = node, pressures
        error, rate = tour.angle[k] - angle, tour.velocity[k] - velocity
        intended = tour.acceleration[k] + 2 * _TRACKING * rate + _TRACKING**2 * error
        angle, velocity, torque = person.step(angle, velocity, needed, intended)
        track[k, 2] = torque[0]
        pressures = controller.settle(pressures, controller.nodes[node].setting.pressures(), STEP)
    angles, velocities, torques, excess = track.T
    return SwitchedMotion(tour, angles, velocities, torques, excess, nodes, gas, tuple(switches))


_BRAKING = 30.0  # 1/s: rate at which the person brakes, as far as the strength allows
_SETTLED = 5.0  # simulated time constants
_TOLERANCE = 1e-3  # fraction of the range of the person's torque


@dataclass(frozen=True)
class TransitionMap:
    """Transitions from one node to another that start in the states of a grid."""

    before: int  # indices of the nodes
    after: int
    angle: FloatArray  # (A,) angles that can be held with both settings, rad
    velocity: FloatArray  # (V,) rad/s
    excess: FloatArray  # (A, V) largest torque beyond the person's limits during the transition, N·m
    switched: BoolArray  # (A,) whether the controller changes at this angle
    unsafe: BoolArray  # (A, V) whether the excess is above the tolerance


def map_transition(  # noqa: PLR0917
    person: Person, controller: Controller, before: int, after: int, speed: float, size: tuple[int, int] = (41, 21)
) -> TransitionMap | None:
    """Return simulated transitions from all states that both nodes hold; the person brakes and then holds the joint.

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
