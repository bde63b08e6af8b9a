"""Simulated controller that changes the pressures of a joint's device between its tasks (thesis 9.6)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.config.prescription import ControllerRules, Task
from mocap_id.pneumatics.cylinder import Cylinder, PressureLimits, Setting, gas_of_change
from mocap_id.pneumatics.held_angles import find_holdable, find_task_setting
from mocap_id.pneumatics.switching import (
    STEP,
    Controller,
    Node,
    Person,
    SwitchedMotion,
    TransitionMap,
    compute_depths,
    map_transition,
    plan_tour,
    simulate_switching,
)
from mocap_id.prescription.one_joint import OneJoint

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
        nodes.append(Node(name, held[0], compute_depths(find_holdable(joint, cylinder, held[0], angle), angle)))
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
