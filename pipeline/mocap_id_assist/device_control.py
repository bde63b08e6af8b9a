"""Simulated controllers that change the pressures of devices between tasks: one joint, or a chain (thesis 9.6)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.dynamics.cylinder import Cylinder, PressureLimits, Setting
from mocap_id_assist.assisted_body import PrescriptionResult, task_points
from mocap_id_assist.controllers import (
    STEP,
    TOUR_STEP,
    Actuator,
    AssistedChain,
    ChainNode,
    ChainTour,
    Controller,
    Node,
    Person,
    SwitchedMotion,
    TourRules,
    TransitionMap,
    compute_depths,
    compute_node_depths,
    find_pressures,
    find_unsafe_changes,
    map_transition,
    plan_tour,
    simulate_switching,
    simulate_tour,
)
from mocap_id_assist.devices import find_held_angles, find_task_setting, gas_of_change
from mocap_id_assist.files import ControllerRules, Task
from mocap_id_assist.one_joint import OneJoint
from mocap_id_assist.several_joints import SubWorkspace, sample_postures

_GRID = 721


_MEETINGS = 13  # number of angles at which two sub-workspaces may be joined


SETTLED = 3.0  # number of time constants after which pressures have settled; faster changes of the node are chatter


_AWAY = np.radians(2.0)  # rad, largest distance from the reference at the end of a hold of a task that is reached


_TOLERANCE = 1e-3  # fraction of the range of the person's torque


_FASTER = 1.5  # changes must be safe up to this factor times the speed of the tour


@dataclass(frozen=True)
class TaskVisit:
    """A visit of a task in the tour."""

    task: str
    time: tuple[float, float]  # start and end, s
    held: bool  # whether the task was reached and held
    missing: float  # largest missing torque, N·m


def describe_chatter(dwell: float, settling: float) -> list[str]:
    """Return a sentence if ``dwell``, the shortest time in a node, is below the settling time, s; else no sentence."""
    if dwell >= settling:
        return []
    return [
        f"the controller chatters: it stayed {dwell:.2f} s in a node, but the pressures need {settling:.2f} s to settle"
    ]


@dataclass(frozen=True)
class ControlledTasks:
    """The controller of a joint, its simulated tour and its checks."""

    person: Person
    controller: Controller
    tasks: tuple[tuple[str, float, float], ...]  # name of each node, and the interval of its tasks, rad
    margins: tuple[float, ...]  # smallest reserve of the person's torque in each interval, N·m
    left_out: tuple[str, ...]  # names of the nodes for which no pressures exist
    motion: SwitchedMotion
    visits: tuple[TaskVisit, ...]
    gas: tuple[float, ...]  # gas of each change in the tour, kg
    maps: tuple[TransitionMap, ...]

    @property
    def switches(self) -> tuple[tuple[int, int, int], ...]:
        """For each change in the tour: the sample, and the indices of the nodes before and after the change."""
        return self.motion.switches

    @property
    def settling(self) -> float:
        """Time that the pressures need to settle, s."""
        return SETTLED * self.controller.slowest

    @property
    def shortest_dwell(self) -> float:
        """Shortest time in a node between two changes, s; infinite with fewer than two changes."""
        return float(np.diff([k * STEP for k, _, _ in self.switches]).min(initial=np.inf))

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each failed check; empty if no check failed."""
        names = [node.name for node in self.controller.nodes]
        problems = [f"no pressures hold the tasks of {name}" for name in self.left_out]
        pairs = itertools.pairwise(range(len(names)))
        problems += [
            f"{names[a]} and {names[b]} have no overlap in which the pressures can change"
            for a, b in pairs
            if not (self._serves(a, b) and self._serves(b, a))
        ]
        missed = dict.fromkeys(visit.task for visit in self.visits if not visit.held)
        problems += [f"{task} is not held throughout" for task in missed]
        problems += describe_chatter(self.shortest_dwell, self.settling)
        for one in self.maps:
            unsafe = one.unsafe & one.switched[:, None]
            if unsafe.any():
                share = 100 * float(unsafe.sum()) / (one.switched.sum() * len(one.velocity))
                change = f"a change from {names[one.before]} to {names[one.after]}"
                problems.append(f"{change} is unsafe in {share:.0f} % of the states in which it happens")
        return tuple(problems)

    def _serves(self, before: int, after: int) -> bool:
        """Return whether node ``before`` holds the tasks of node ``after``, or can change to it and hold the joint."""
        depth, angle = self.controller.nodes[before].depth, self.controller.angle
        _, low, high = self.tasks[after]
        if (depth[(angle >= low) & (angle <= high)] > 0).all():
            return True
        return bool((self.controller.may_change(before, after, angle) & (depth > 0)).any())


def control_tasks(
    joint: OneJoint, inertia: float, device: DeviceConfig, tasks: Sequence[Task], rules: ControllerRules
) -> ControlledTasks:
    """Choose pressures for each group of tasks, simulate a tour through all tasks and back, and return the controller.

    ValueError is raised if no pressures hold the tasks of any group.
    """
    cylinder, limits = device.keys.cylinder(), device.keys.limits()
    margin, hysteresis = np.radians([rules.margin_deg, rules.hysteresis_deg]).tolist()
    groups = _group_intervals(tasks)
    joined = _extend_intervals(joint, cylinder, limits, groups, 2 * (margin + hysteresis))
    angle = np.linspace(joint.lower, joint.upper, _GRID)
    nodes, kept, margins, left_out = [], [], [], []
    for name, low, high in joined:
        held = find_task_setting(joint, cylinder, limits, [(low, high)])
        if held is None or held[1] < -_TOLERANCE * (joint.torque_high - joint.torque_low):
            left_out.append(name)
            continue
        nodes.append(Node(name, held[0], compute_depths(find_held_angles(joint, cylinder, held[0], angle), angle)))
        kept.append((name, low, high))
        margins.append(held[1])
    if not nodes:
        raise ValueError(
            "the device has no pressures with which the person can hold the angles of all tasks of any group"
        )
    controller = Controller(tuple(nodes), angle, margin, hysteresis, *device.keys.settling.lags())
    person, speed = Person(joint, inertia, cylinder), float(np.radians(rules.speed_deg_s))
    pieces = [(task.name, *np.radians(task.angles_deg).tolist()) for task in tasks if task.angles_deg is not None]
    tour = plan_tour(pieces, speed, rules.hold_s, float(np.radians(rules.tremor_deg)))
    start = int(np.argmax([float(controller.depth(k, tour.angle[0])) for k in range(len(nodes))]))
    motion = simulate_switching(person, controller, tour, start)
    return ControlledTasks(
        person,
        controller,
        tuple(kept),
        tuple(margins),
        tuple(left_out),
        motion,
        _check_visits(person, motion),
        tuple(_compute_gas(cylinder, controller, motion, device.keys.temperature_K)),
        _map_transitions(person, controller, _FASTER * speed),
    )


def _group_intervals(tasks: Sequence[Task]) -> list[tuple[str, float, float]]:
    """Return the interval of each group of tasks, rad, in order of the angle."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for task in tasks:
        assert task.angles_deg is not None
        groups.setdefault(task.group or task.name, []).append(task.angles_deg)
    ends = [
        (name, *np.radians([min(low for low, _ in pairs), max(high for _, high in pairs)]).tolist())
        for name, pairs in groups.items()
    ]
    return sorted(ends, key=lambda one: one[1] + one[2])


def _extend_intervals(
    joint: OneJoint,
    cylinder: Cylinder,
    limits: PressureLimits,
    groups: list[tuple[str, float, float]],
    overlap: float,
) -> list[tuple[str, float, float]]:
    """Return the intervals (name, low, high), extended so that, if possible, neighbours overlap by ``overlap``, rad."""
    joined = list(groups)
    for k in range(len(joined) - 1):
        (name, low, high), (other, first, last) = joined[k], joined[k + 1]
        best, worth = None, 0.0
        between = min(high, first), max(high, first)
        for meeting in np.linspace(*between, _MEETINGS).tolist():
            lower = low, min(max(high, meeting + overlap / 2), joint.upper)
            upper = max(min(first, meeting - overlap / 2), joint.lower), last
            sides = [find_task_setting(joint, cylinder, limits, [side]) for side in (lower, upper)]
            margin = min((-np.inf if side is None else side[1]) for side in sides)
            if margin > worth:
                best, worth = (lower, upper), margin
        if best is not None:
            joined[k], joined[k + 1] = (name, *best[0]), (other, *best[1])
    return joined


def _map_transitions(person: Person, controller: Controller, speed: float) -> tuple[TransitionMap, ...]:
    pairs = itertools.permutations(range(len(controller.nodes)), 2)
    maps = [map_transition(person, controller, a, b, speed) for a, b in pairs]
    return tuple(one for one in maps if one is not None)


def _check_visits(person: Person, motion: SwitchedMotion) -> tuple[TaskVisit, ...]:
    tour, span = motion.tour, person.joint.torque_high - person.joint.torque_low
    visits = []
    for visit in tour.visits:
        during = (tour.time >= visit.time[0]) & (tour.time <= visit.time[1])
        missing = float(motion.excess[during].max())
        away = float(np.abs(motion.angle - tour.angle)[np.searchsorted(tour.time, visit.held_until) - 1].max())
        visits.append(TaskVisit(visit.task, visit.time, bool(missing <= _TOLERANCE * span and away <= _AWAY), missing))
    return tuple(visits)


def _compute_gas(cylinder: Cylinder, controller: Controller, motion: SwitchedMotion, temperature: float) -> list[float]:
    """Return the gas of each change, from the pressures at the time of the change, kg."""

    def setting(pressures: FloatArray) -> Setting:
        return Setting(*pressures.tolist())

    return [
        gas_of_change(cylinder, setting(motion.pressures[k]), controller.nodes[after].setting, temperature)
        for k, _, after in motion.switches
    ]


_STARTS = 1024  # number of sampled postures from which the search for postures of a task starts


_MEETINGS = 13  # number of postures at which two sub-workspaces may be joined


_SHARE_TOLERANCE = 1e-3  # fraction of the smallest range of a joint's torque


@dataclass(frozen=True)
class ChainChange:
    """A change at rest from one node (a set of pressures) to another, in the M sampled postures that both hold."""

    before: int  # index of the node
    after: int  # index of the node
    q: FloatArray  # (M, n) postures, rad
    switched: BoolArray  # (M,) whether the controller changes the node in this posture
    unsafe: BoolArray  # (M,) whether the person cannot hold the posture during the change
    missing: FloatArray  # (M,) largest missing torque, N·m


@dataclass(frozen=True)
class ControlledChain:
    """The controller of a chain, its simulated tour and its checks."""

    chain: AssistedChain
    nodes: tuple[ChainNode, ...]
    margins: tuple[float, ...]  # smallest reserve in each node's tasks, as a fraction of the intended reserve
    held: FloatArray  # (K,) fraction of the sampled postures that each of the K nodes holds
    left_out: tuple[str, ...]  # names of the nodes for which no pressures exist
    stops: tuple[str, ...]  # name of the task of each stop of the tour
    tour: ChainTour
    missing: tuple[float, ...]  # largest missing torque in each visit, N·m
    gas: tuple[float, ...]  # gas of each change in the tour, kg
    changes: tuple[ChainChange, ...]
    tolerance: float  # missing torque up to which a posture counts as held, N·m

    @property
    def switches(self) -> tuple[tuple[int, int, int], ...]:
        """For each change in the tour: the sample, and the indices of the nodes before and after the change."""
        return self.tour.switches

    @property
    def settling(self) -> float:
        """Time that the pressures need to settle, s."""
        return SETTLED * self.chain.slowest

    @property
    def shortest_dwell(self) -> float:
        """Shortest time in a node between two changes, s; infinite with fewer than two changes."""
        return float(np.diff([k * TOUR_STEP for k, _, _ in self.switches]).min(initial=np.inf))

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each failed check; empty if no check failed."""
        problems = [f"no pressures hold the tasks of {name}" for name in self.left_out]
        between = dict.fromkeys((self.stops[a], self.stops[b]) for a, b in self.tour.no_path)
        problems += [f"there is no path between {a} and {b} through postures that a node holds" for a, b in between]
        visits = zip(self.tour.visits, self.missing, strict=True)
        missed = dict.fromkeys(self.stops[stop] for (stop, _, _), missing in visits if missing > self.tolerance)
        problems += [f"{task} is not held throughout" for task in missed]
        largest = float(self.tour.excess.max())
        if not missed and largest > self.tolerance:
            problems.append(f"between the tasks, up to {largest:.2f} N·m of torque are missing")
        problems += describe_chatter(self.shortest_dwell, self.settling)
        for one in self.changes:
            if (one.unsafe & one.switched).any():
                share = 100 * float(one.unsafe[one.switched].mean())
                change = f"a change from {self.nodes[one.before].name} to {self.nodes[one.after].name}"
                problems.append(f"{change} is unsafe in {share:.0f} % of the postures in which it happens")
        return tuple(problems)


def control_chain(
    result: PrescriptionResult, devices: Sequence[DeviceConfig | None], rules: ControllerRules
) -> ControlledChain:
    """Choose pressures for each group of tasks, simulate a tour through all tasks and back, and return the controller.

    ValueError is raised if no pressures hold the tasks of any group.
    """
    assert result.graph is not None and result.graph_postures is not None
    chain, q = _make_chain(result, devices), result.graph_postures
    margin, hysteresis, speed = np.radians([rules.margin_deg, rules.hysteresis_deg, rules.speed_deg_s]).tolist()
    tour_rules = TourRules(margin, hysteresis, speed, rules.hold_s)
    nodes, margins, stops, stop_postures = [], [], [], []
    groups, left_out = _find_groups(result, chain)
    extended = _extend_groups(chain, [postures for _, _, postures in groups], 2 * (margin + hysteresis))
    for (name, names, own), postures in zip(groups, extended, strict=True):
        pressures = find_pressures(chain, postures)
        assert pressures is not None
        nodes.append(ChainNode(name, pressures[0]))
        margins.append(pressures[1])
        stops += names
        stop_postures.append(own)
    if not nodes:
        raise ValueError("no pressures of the devices hold the tasks of any group")
    tour = simulate_tour(chain, nodes, np.concatenate(stop_postures), q, tour_rules)
    tolerance = _SHARE_TOLERANCE * float(np.ptp(chain.strength, axis=1).min())
    depth = compute_node_depths(chain, nodes, q)
    return ControlledChain(
        chain,
        tuple(nodes),
        tuple(margins),
        (depth > 0).mean(axis=1),
        tuple(left_out),
        tuple(stops),
        tour,
        tuple(float(tour.excess[a : b + 1].max()) for _, a, b in tour.visits),
        tuple(_compute_chain_gas(chain, nodes, tour)),
        tuple(_check_changes(chain, nodes, depth, q, tour_rules, tolerance)),
        tolerance,
    )


def _find_groups(
    result: PrescriptionResult, chain: AssistedChain
) -> tuple[list[tuple[str, list[str], FloatArray]], list[str]]:
    """Return each group that can be held as (name, tasks, postures (P, n)), and the names of the other groups.

    ``tasks`` and ``postures`` (rad) contain the task and the posture of each of the P stops of the group.
    """
    assert result.graph is not None
    tasks = {task.name: task for task in result.config.wishes.tasks}
    groups, left_out = [], []
    for each in result.graph.nodes:
        found = None if each.stiffness is None else _postures(result, each, [tasks[name] for name in each.tasks])
        pressures = None if found is None else find_pressures(chain, found[1])
        if found is None or pressures is None or pressures[1] < -_SHARE_TOLERANCE:
            left_out.append(each.name)
        else:
            groups.append((each.name, *found))
    return groups, left_out


def _extend_groups(chain: AssistedChain, groups: Sequence[FloatArray], overlap: float) -> list[FloatArray]:
    """Return the postures of the groups, extended so that neighbouring groups overlap where the node can change.

    The overlap, of length ``overlap`` (rad), is on the straight line between the nearest stops of both groups, at the
    point where the smaller one of their reserves is largest.
    """
    joined = list(groups)
    for k, (one, other) in enumerate(itertools.pairwise(groups)):
        apart = np.linalg.norm(one[:, None] - other, axis=2)
        a, b = np.unravel_index(int(apart.argmin()), apart.shape)
        along = (other[b] - one[a]) / max(float(apart[a, b]), 1e-9)
        best, worth = None, 0.0
        for share in np.linspace(0, 1, _MEETINGS):
            meeting = one[a] + share * (other[b] - one[a]) + np.array([[-0.5], [0.5]]) * overlap * along
            meeting = np.clip(meeting, chain.lower, chain.upper)
            sides = [np.concatenate([joined[k], meeting]), np.concatenate([other, meeting])]
            found = [find_pressures(chain, side) for side in sides]
            margin = min((-np.inf if each is None else each[1]) for each in found)
            if margin > worth:
                best, worth = sides, margin
        if best is not None:
            joined[k], joined[k + 1] = best
    return joined


def _make_chain(result: PrescriptionResult, devices: Sequence[DeviceConfig | None]) -> AssistedChain:
    """Return the chain with its cylinders; a spring without a device stays as prescribed in all nodes."""
    body, springs = result.body, result.several
    assert body.weights is not None and springs is not None
    weights, passive = body.weights, []
    actuators = []
    for place, device, stiffness, rest in zip(result.places, devices, springs.stiffness, springs.rest, strict=True):
        if device is None:
            passive += [(list(place.joints), float(stiffness), float(rest))] if stiffness > 0 else []
            continue
        keys = device.keys
        actuators.append(
            Actuator(keys.cylinder(), keys.limits(), place.joints, *keys.settling.lags(), keys.temperature_K)
        )

    def held(q: FloatArray) -> FloatArray:
        torque = weights.torques(q).copy()
        for joints, stiffness, rest in passive:
            torque[:, joints] += stiffness * (q[:, joints].sum(axis=1, keepdims=True) - rest)
        return torque

    return AssistedChain(held, body.strength, body.limits.lower, body.limits.upper, tuple(actuators))


def _postures(result: PrescriptionResult, node: SubWorkspace, tasks: Sequence[Task]) -> tuple[list[str], FloatArray]:
    """Return for P points the name of the task and the sampled posture (P, n), rad, with the largest torque reserve."""
    body, wishes = result.body, result.config.wishes
    assert body.weights is not None and node.stiffness is not None and node.rest is not None
    each = [(task.name, task_points(task)) for task in tasks]
    points = np.concatenate([some for _, some in each])
    sampled = sample_postures(body.arm, body.weights, body.limits, result.places, points, _STARTS, wishes.seed)
    needed = sampled.gravity.copy()
    for s, place in enumerate(result.places):
        if node.stiffness[s] > 0:
            needed[:, list(place.joints)] += (node.stiffness[s] * (sampled.stretch[:, s] - node.rest[s]))[:, None]
    reserve = np.minimum(body.strength[:, 1] - needed, needed - body.strength[:, 0]).min(axis=1)
    best = []
    for k in range(len(points)):
        own = np.flatnonzero(sampled.cell == sampled.cells + k)
        best.append(sampled.q[own[reserve[own].argmax()]])
    return [name for name, some in each for _ in some], np.array(best)


def _compute_chain_gas(chain: AssistedChain, nodes: Sequence[ChainNode], tour: ChainTour) -> Iterator[float]:
    """Yield the gas of each change, from the pressures at the time of the change, kg."""
    for k, _, after in tour.switches:
        yield sum(
            gas_of_change(one.cylinder, Setting(*was.tolist()), Setting(*new.tolist()), one.temperature)
            for one, was, new in zip(chain.actuators, tour.pressures[k], nodes[after].pressures, strict=True)
        )


def _check_changes(  # noqa: PLR0917
    chain: AssistedChain,
    nodes: Sequence[ChainNode],
    depth: FloatArray,
    q: FloatArray,
    rules: TourRules,
    tolerance: float,
) -> Iterator[ChainChange]:
    """Yield the changes between all pairs of nodes that hold common postures; ``depth`` (K, N) is for ``q`` (N, n)."""
    for a, b in itertools.permutations(range(len(nodes)), 2):
        both = (depth[a] > 0) & (depth[b] > 0)
        if not both.any():
            continue
        unsafe, missing = find_unsafe_changes(chain, nodes[a], nodes[b], q[both], tolerance)
        switched = (depth[a, both] < rules.margin) & (depth[b, both] > rules.margin + rules.hysteresis)
        yield ChainChange(a, b, q[both], switched, unsafe, missing)
