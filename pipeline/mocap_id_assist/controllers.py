"""Controllers that change the pressures of cylinders between sub-workspaces, simulated (thesis 9.6).

A node of a controller is a set of sealed pressures. The depth of a posture in a node is its distance from the nearest
posture that the person cannot hold with these pressures. The controller leaves a node where its depth is below a
margin, for the node with the largest depth, if this is above margin plus hysteresis. Before the controller changes
back, the joints have to move by at least the hysteresis. After a change, each sealed pressure settles with a
first-order lag.

One joint (:class:`AssistedJoint`) moves with its inertia and friction: the person follows a reference with the torque
that the motion needs, as far as the strength allows. The depth is exact on a grid of angles.

A chain (:class:`AssistedChain`) is treated as at rest in each posture: torques of acceleration and friction are
ignored. The person needs τ = g(q) - Σ τ_device(q). A posture can be held if every torque is within the limits, for
isothermal and for adiabatic changes of volume. The depth is, to first order, the smallest ratio of a torque's reserve
to the norm of its gradient. If the current node does not hold the posture, the depth of the next node must only be
above 0.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, PressureLimits
from mocap_id_assist.devices import RESERVE
from mocap_id_assist.springs import OneJoint

JOINT_STEP, CHAIN_STEP = 0.002, 0.01
"""Time steps of the simulated tours of a joint and of a chain, s."""


@dataclass(frozen=True)
class Actuator:
    """A cylinder whose travel follows the sum of its joints' angles."""

    cylinder: Cylinder
    limits: PressureLimits
    joints: tuple[int, ...]  # counted from 0
    fill: FloatArray  # (2,) time constants of rising pressures in the flexion and the extension chamber, s
    vent: FloatArray  # (2,) time constants of falling pressures, s
    temperature: float  # temperature of the gas, K

    @property
    def slowest(self) -> float:
        """The largest time constant, s."""
        return float(np.max([self.fill, self.vent]))


@dataclass(frozen=True)
class Node:
    """A node of a controller: its name and its sealed pressures (D, 2), Pa."""

    name: str
    pressures: FloatArray


@dataclass(frozen=True)
class Rules:
    """Rules of a controller and of the tour that tests it."""

    margin: float  # depth below which the controller leaves a node, rad
    hysteresis: float  # additional depth of the next node, rad
    speed: float  # largest speed of a joint, rad/s
    hold: float  # time for which the ends or postures of a task are held, s


@dataclass(frozen=True)
class Tour:
    """A simulated tour of n joints with D cylinders through all tasks and back, with T samples."""

    time: FloatArray  # (T,) s
    q: FloatArray  # (T, n) rad
    node: IntArray  # (T,) index of the current node
    pressures: FloatArray  # (T, D, 2) sealed pressures, Pa
    excess: FloatArray  # (T,) part of the holding torque beyond the person's limits, N·m
    switches: tuple[tuple[int, int, int], ...]  # sample, node before and node after each change
    torque: FloatArray | None = None  # (T,) the person's torque, N·m; for one joint only
    reference: FloatArray | None = None  # (T,) angle that the person follows, rad; for one joint only


@dataclass(frozen=True)
class NodeChange:
    """A change from one node to another, simulated from M states that both nodes hold."""

    before: int  # indices of the nodes
    after: int
    states: FloatArray  # (M, n) postures at rest, rad; for one joint (M, 2) angle, rad, and velocity, rad/s
    missing: FloatArray  # (M,) largest torque beyond the person's limits during the change, N·m
    switched: BoolArray  # (M,) whether the controller makes the change in this state
    unsafe: BoolArray  # (M,) whether the missing torque is above a tolerance


@dataclass(frozen=True)
class Visit:
    """A visit of a task in a tour."""

    task: str
    start: float  # s
    posture: FloatArray | None  # (n,) posture at the start, rad; None for one joint
    held: bool  # whether the task was reached and held
    missing: float  # largest missing torque, N·m


@dataclass(frozen=True)
class Controlled:
    """A controller for the tasks of n joints with D devices, its simulated tour and its checks."""

    nodes: tuple[Node, ...]
    joints: tuple[tuple[int, ...], ...]  # joints of each device, counted from 0
    grid: FloatArray  # (N, n) angles of the joint, or sampled postures of the chain, rad
    held: BoolArray  # (K, N) whether each of the K nodes holds each of them
    # (K,) smallest reserve of torque in each node's tasks: for one joint in N·m, for a chain as a fraction of the
    # intended reserve
    reserve: tuple[float, ...]
    made_for: tuple[tuple[float, float], ...]  # for one joint: the interval of each node's tasks, rad; else empty
    tour: Tour
    visits: tuple[Visit, ...]
    gas: tuple[float, ...]  # gas of each change in the tour, kg
    changes: tuple[NodeChange, ...]
    shortest_dwell: float  # shortest time in a node between two changes, s; infinite with fewer than two changes
    settling: float  # time that the pressures need to settle, s
    problems: tuple[str, ...]  # one sentence for each failed check


def _settle(pressures: FloatArray, target: FloatArray, time: float, fill: FloatArray, vent: FloatArray) -> FloatArray:
    """Return the pressures (D, 2), Pa, after they have approached ``target`` (D, 2), Pa, for ``time``, s.

    ``fill`` and ``vent`` are the time constants of rising and falling pressures, s.
    """
    lag = np.where(target > pressures, fill, vent)
    return np.asarray(target + (pressures - target) * np.exp(-time / lag))


def _excess(torque: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """Return the part of a torque beyond the limits ``low`` and ``high``, N·m; at least 0."""
    return np.asarray(np.maximum(np.maximum(torque - high, low - torque), 0.0))


_TRACKING = 12.0  # rad/s: bandwidth of the person's corrections
_BRAKING = 30.0  # 1/s: rate at which the person brakes, as far as the strength allows
_STARTS = 4.0  # 1/s: largest acceleration of a tour divided by its largest speed
_SETTLED = 5.0  # simulated time constants of a change
TOLERANCE = 1e-3  # fraction of the range of the person's torque


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
class JointController:
    """The K nodes of a controller for one joint, their depths, and its rules."""

    nodes: tuple[Node, ...]
    angle: FloatArray  # (N,) grid of angles, rad
    depths: FloatArray  # (K, N) depth of each angle of the grid in each node, rad
    rules: Rules

    def depth(self, node: int, angle: FloatArray) -> FloatArray:
        """Return the depth of angles in a node, rad."""
        return np.asarray(np.interp(angle, self.angle, self.depths[node]))

    def may_change(self, before: int, after: int, angle: FloatArray) -> BoolArray:
        """Return whether the controller may change from one node to another at each angle, rad."""
        rules = self.rules
        deep = self.depth(after, angle) > rules.margin + rules.hysteresis
        return np.asarray((self.depth(before, angle) < rules.margin) & deep)


@dataclass(frozen=True)
class AssistedJoint:
    """A person's joint with its limits of angle and torque, and the device on it."""

    joint: OneJoint
    inertia: float  # kg·m²
    actuator: Actuator

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the joint within the stroke of the device, rad."""
        low, high = self.actuator.cylinder.limits
        return max(low, self.joint.lower), min(high, self.joint.upper)

    def holding_torque(self, angle: FloatArray, pressures: FloatArray) -> FloatArray:
        """Return the person's torque (B,), N·m, that holds angles (B,), rad, with sealed pressures (B, 2), Pa."""
        cylinder = self.actuator.cylinder
        device = (cylinder.torque_by_pressure(angle) * pressures).sum(axis=-1)
        return np.asarray(self.joint.gravity(angle) - device - cylinder.torque_of_atmosphere())

    def excess(self, needed: FloatArray) -> FloatArray:
        """Return the part of a torque beyond the person's limits, N·m; at least 0."""
        return _excess(needed, self.joint.torque_low, self.joint.torque_high)

    def step(
        self, angle: FloatArray, velocity: FloatArray, needed: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angle, velocity and the person's torque (B,) after a step with an intended acceleration, rad/s²."""
        friction = self.actuator.cylinder.friction(velocity)
        torque = np.clip(needed - friction + self.inertia * acceleration, self.joint.torque_low, self.joint.torque_high)
        velocity = velocity + JOINT_STEP * (torque - needed + friction) / self.inertia
        moved = angle + JOINT_STEP * velocity
        angle = np.clip(moved, *self.limits)
        return angle, np.where(moved == angle, velocity, 0.0), torque


@dataclass(frozen=True)
class ReferenceMotion:
    """Reference motion of one joint through all tasks, with T samples."""

    time: FloatArray  # (T,) s
    angle: FloatArray  # (T,) rad
    velocity: FloatArray  # (T,) rad/s
    acceleration: FloatArray  # (T,) rad/s²
    # task, start and end of each visit, s, and the last time at which each end of the task is held, s
    visits: tuple[tuple[str, float, float, tuple[float, float]], ...]


def plan_tour(tasks: Sequence[tuple[str, float, float]], rules: Rules, tremor: float = 0.0) -> ReferenceMotion:
    """Return a reference that visits all tasks (name, low, high), rad, in order and back, through each interval.

    Each movement has minimum jerk and a bounded acceleration. The ends of each task are held. ``tremor`` is the
    amplitude of a tremor of 5 Hz, rad.
    """
    order = [*tasks, *tasks[-2::-1]]
    pieces, visits, here, now = [np.array([order[0][1]])], [], order[0][1], 0.0
    for name, low, high in order:
        ends = (low, high) if abs(low - here) <= abs(high - here) else (high, low)
        arrivals, departures = [], []
        for end in ends:
            distance = abs(end - here)
            duration = max(
                1.875 * distance / rules.speed, np.sqrt(5.7735 * distance / (_STARTS * rules.speed)), JOINT_STEP
            )
            s = np.arange(1, int(np.ceil(duration / JOINT_STEP)) + 1) * JOINT_STEP / duration
            s = np.minimum(s, 1.0)
            still = np.full(int(rules.hold / JOINT_STEP), end)
            pieces += [here + (end - here) * (10 * s**3 - 15 * s**4 + 6 * s**5), still]
            arrivals.append(now + len(s) * JOINT_STEP)
            now, here = arrivals[-1] + len(still) * JOINT_STEP, end
            departures.append(now)
        visits.append((name, arrivals[0], now, (departures[0], departures[1])))
    angle: FloatArray = np.concatenate(pieces)
    time = np.asarray(JOINT_STEP * np.arange(len(angle)), dtype=np.float64)
    angle += tremor * np.sin(2 * np.pi * 5.0 * time)
    velocity: FloatArray = np.gradient(angle, JOINT_STEP)
    acceleration: FloatArray = np.gradient(velocity, JOINT_STEP)
    return ReferenceMotion(time, angle, velocity, acceleration, tuple(visits))


def simulate_joint_tour(
    assisted: AssistedJoint, controller: JointController, reference: ReferenceMotion, start: int
) -> Tour:
    """Return the simulated tour along a reference; it starts in node ``start``.

    At every fifth sample, the controller changes to the allowed node with the largest depth.
    """
    count, node, nodes = len(reference.time), start, controller.nodes
    angle, velocity = np.clip(reference.angle[:1], *assisted.limits), np.zeros(1)
    pressures, fill, vent = nodes[start].pressures, assisted.actuator.fill, assisted.actuator.vent
    track, active = np.empty((count, 3)), np.empty(count, dtype=np.int64)
    gas, switches = np.empty((count, 1, 2)), []
    for k in range(count):
        if k % 5 == 0:
            here = angle[0]
            others = [j for j in range(len(nodes)) if j != node and bool(controller.may_change(node, j, here))]
            after = max(others, key=lambda j: float(controller.depth(j, here)), default=node)
            if after != node:
                switches.append((k, node, after))
                node = after
        needed = assisted.holding_torque(angle, pressures)
        active[k], gas[k] = node, pressures
        error, rate = reference.angle[k] - angle, reference.velocity[k] - velocity
        intended = reference.acceleration[k] + 2 * _TRACKING * rate + _TRACKING**2 * error
        track[k, :2] = angle[0], assisted.excess(needed)[0]
        angle, velocity, torque = assisted.step(angle, velocity, needed, intended)
        track[k, 2] = torque[0]
        pressures = _settle(pressures, nodes[node].pressures, JOINT_STEP, fill, vent)
    angles, excess, torques = track.T
    return Tour(
        reference.time, angles[:, None], active, gas, excess, tuple(switches), torques, reference=reference.angle
    )


def map_change(  # noqa: PLR0917
    assisted: AssistedJoint,
    controller: JointController,
    before: int,
    after: int,
    speed: float,
    size: tuple[int, int] = (41, 21),
) -> NodeChange | None:
    """Return the change from node ``before`` to ``after``, simulated from a grid of all states that both nodes hold.

    The person brakes and then holds the joint. The result is None if no angle can be held with both settings. ``speed``
    is the largest speed of the grid, rad/s; ``size`` is the number of its angles and velocities.
    """
    both = (controller.depths[before] > 0) & (controller.depths[after] > 0)
    if not both.any():
        return None
    held = controller.angle[both]
    angles = held[np.unique(np.linspace(0, len(held) - 1, size[0]).round().astype(int))]
    velocities = np.linspace(-speed, speed, size[1])
    grid = np.stack(np.meshgrid(angles, velocities, indexing="ij"), axis=-1).reshape(-1, 2)
    angle, velocity = grid[:, 0], grid[:, 1]
    pressures, target = controller.nodes[before].pressures, controller.nodes[after].pressures
    worst = np.zeros(len(grid))
    for _ in range(int(_SETTLED * assisted.actuator.slowest / JOINT_STEP)):
        needed = assisted.holding_torque(angle, pressures)
        worst = np.maximum(worst, assisted.excess(needed))
        angle, velocity, _torque = assisted.step(angle, velocity, needed, -_BRAKING * velocity)
        pressures = _settle(pressures, target, JOINT_STEP, assisted.actuator.fill, assisted.actuator.vent)
    worst = np.maximum(worst, assisted.excess(assisted.holding_torque(angle, pressures)))
    tolerance = TOLERANCE * (assisted.joint.torque_high - assisted.joint.torque_low)
    switched = controller.may_change(before, after, grid[:, 0])
    return NodeChange(before, after, grid, worst, switched, worst > tolerance)


_DIFFERENCE = 1e-4  # rad, of the finite differences


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
        return np.asarray(_excess(needed, self.strength[:, 0], self.strength[:, 1]).max(axis=1))

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
        steps = _DIFFERENCE * np.eye(q.shape[1])
        for exponent in (ISOTHERMAL, ADIABATIC):
            here = self.holding_torques(q, pressures[None], exponent)
            slopes = [
                self.holding_torques(q + step, pressures[None], exponent)
                - self.holding_torques(q - step, pressures[None], exponent)
                for step in steps
            ]
            steep = np.linalg.norm(np.stack(slopes), axis=0) / (2 * _DIFFERENCE)
            reserve = np.minimum(self.strength[:, 1] - here, here - self.strength[:, 0])
            depth = np.minimum(depth, (reserve / np.maximum(steep, 1e-9)).min(axis=1))
        return np.where(np.isfinite(depth), depth, -np.inf)

    def settle(self, pressures: FloatArray, target: FloatArray, time: float) -> FloatArray:
        """Return the pressures (D, 2), Pa, after they have approached ``target`` (D, 2), Pa, for ``time``, s."""
        fill, vent = (np.stack([getattr(one, way) for one in self.actuators]) for way in ("fill", "vent"))
        return _settle(pressures, target, time, fill, vent)

    @property
    def slowest(self) -> float:
        """The largest time constant, s."""
        return max(one.slowest for one in self.actuators)


def find_pressures(chain: AssistedChain, q: FloatArray) -> tuple[FloatArray, float] | None:
    """Return the lowest pressures (D, 2), Pa, that hold postures (M, n) with a reserve, and the fraction they attain.

    The reserve of a joint is :data:`~mocap_id_assist.devices.RESERVE` times half the range of its torque, plus
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


_NEIGHBOURS = 12
_BETWEEN = 33  # number of postures on the straight line from one stop to the next
_NODE_CHANGE = 1e-3  # rad: cost of a change of node in the search for a path
_SETTLING_STEPS = 40
_CHAIN_SETTLED = 4.0  # simulated time constants of a change


def compute_node_depths(chain: AssistedChain, nodes: Sequence[Node], q: FloatArray) -> FloatArray:
    """Return the depth (K, M) of postures (M, n) in each of the K nodes, rad."""
    return np.stack([chain.depth(q, node.pressures) for node in nodes])


def simulate_chain_tour(
    chain: AssistedChain, nodes: Sequence[Node], stops: FloatArray, postures: FloatArray, rules: Rules
) -> tuple[Tour, list[tuple[int, int, int]], list[tuple[int, int]]]:
    """Return a tour through ``stops`` (P, n) and back, its visits, and pairs of stops without a path.

    The paths use ``postures`` (N, n), rad, that a node holds. A visit is the index of the stop, and the first and last
    sample at which it is held. Between stops without a path, the chain moves straight.
    """
    order = [*range(len(stops)), *range(len(stops) - 2, -1, -1)]
    shares = np.linspace(0, 1, _BETWEEN)[1:-1, None]
    straight = [one + shares * (other - one) for one, other in itertools.pairwise(stops)]
    known = np.concatenate([stops, *straight, postures])
    deep = rules.margin + rules.hysteresis
    paths = functools.cache(lambda least: _find_paths(chain, nodes, known, len(stops), least))
    pieces, visits, no_path = [stops[order[0]][None]], [], []
    hold, count = max(int(rules.hold / CHAIN_STEP), 1), 1
    for a, b in [(order[0], order[0]), *itertools.pairwise(order)]:
        path = next((path for least in (deep, 0.0) if (path := _trace_path(*paths(least), a, b)) is not None), None)
        if path is None:
            no_path.append((a, b))
        points = known[[a, b] if path is None else np.array(path) % len(known)]
        for one, other in itertools.pairwise(points):
            steps = max(int(np.ceil(np.abs(other - one).max() / (rules.speed * CHAIN_STEP))), 1)
            pieces.append(one + np.linspace(0, 1, steps + 1)[1:, None] * (other - one))
            count += steps
        pieces.append(np.repeat(stops[b][None], hold, axis=0))
        count += hold
        visits.append((b, count - hold, count - 1))
    q = np.concatenate(pieces)

    # the node and the pressures of every sample
    depth = compute_node_depths(chain, nodes, q)
    here = int(depth[:, 0].argmax())
    gas, node, switches = nodes[here].pressures, np.empty(len(q), dtype=np.int64), []
    pressures = np.empty((len(q), *gas.shape))
    for k in range(len(q)):
        if depth[here, k] < rules.margin:
            better = int(depth[:, k].argmax())
            held = depth[here, k] > 0
            if better != here and depth[better, k] > (deep if held else 0.0):
                switches.append((k, here, better))
                here = better
        node[k], pressures[k] = here, gas
        gas = chain.settle(gas, nodes[here].pressures, CHAIN_STEP)
    excess = chain.excess(chain.holding_torques(q, pressures))
    time: FloatArray = CHAIN_STEP * np.arange(len(q), dtype=np.float64)
    return Tour(time, q, node, pressures, excess, tuple(switches)), visits, list(dict.fromkeys(no_path))


def find_unsafe_changes(
    chain: AssistedChain, before: Node, after: Node, q: FloatArray, tolerance: float
) -> tuple[BoolArray, FloatArray]:
    """Return whether a change of node at rest in postures (M, n) is unsafe, and the largest missing torque (M,), N·m.

    A change is unsafe if the holding torque exceeds the person's limits by more than a tolerance, N·m, while the
    pressures settle.
    """
    gas, worst = before.pressures, np.zeros(len(q))
    for _ in range(_SETTLING_STEPS + 1):
        worst = np.maximum(worst, chain.excess(chain.holding_torques(q, gas[None])))
        gas = chain.settle(gas, after.pressures, _CHAIN_SETTLED * chain.slowest / _SETTLING_STEPS)
    return worst > tolerance, worst


def _find_paths(
    chain: AssistedChain, nodes: Sequence[Node], known: FloatArray, stops: int, least: float
) -> tuple[IntArray, IntArray]:
    """Return the states at the stops, and the previous state of every state on the shortest path from each stop.

    A state is a node together with one of the postures ``known``. Except at the stops, its depth is above ``least``,
    rad. If ``least`` is margin plus hysteresis, the controller can change to this node when it leaves a different one.
    The previous state is negative if there is no path.
    """
    depth = compute_node_depths(chain, nodes, known)
    usable = depth > least
    usable[:, :stops] = depth[:, :stops] > 0
    neighbours = cKDTree(known).query(known, k=min(_NEIGHBOURS + 1, len(known)))
    distance, other = np.asarray(neighbours[0]), np.asarray(neighbours[1])
    start, end, length = np.repeat(np.arange(len(known)), distance.shape[1]), other.reshape(-1), distance.reshape(-1)
    between = compute_node_depths(chain, nodes, 0.5 * (known[start] + known[end]))
    edges = []
    for k in range(len(nodes)):
        free = (length > 0) & usable[k, start] & usable[k, end] & (between[k] > 0)
        edges.append((k * len(known) + start[free], k * len(known) + end[free], length[free]))
        for j in range(k):
            both = np.flatnonzero(usable[k] & usable[j])
            edges.append((k * len(known) + both, j * len(known) + both, np.full(len(both), _NODE_CHANGE)))
    one, two, cost = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = csr_array((cost, (one, two)), shape=(depth.size,) * 2)
    states = depth[:, :stops].argmax(axis=0) * len(known) + np.arange(stops)
    return states, np.asarray(dijkstra(graph, directed=False, indices=states, return_predecessors=True)[1])


def _trace_path(states: IntArray, before: IntArray, start: int, end: int) -> list[int] | None:
    """Return the states on the path between the stops ``start`` and ``end``; None if there is no path."""
    path = [int(states[end])]
    while path[-1] != states[start]:
        if before[start, path[-1]] < 0:
            return None
        path.append(int(before[start, path[-1]]))
    return path[::-1]
