"""Simulation of a controller that changes the pressures between the sub-workspaces of a joint's tasks (thesis 9.6)."""

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
    compute_depths,
    plan_tour,
    simulate_switching,
)
from mocap_id.pneumatics.unsafe_states import TransitionMap, map_transition
from mocap_id.prescription.one_joint import OneJoint

_GRID = 721
_MEETINGS = 13  # angles at which two sub-workspaces may be joined
_SETTLED = 3.0  # time constants; nodes that change faster chatter
_AWAY = np.radians(2.0)  # farther from the reference at the end of a hold, the task is not reached
_TOLERANCE = 1e-3  # of the person's range of torque
_FASTER = 1.5  # times the speed of the tour: changes must be safe up to this speed


@dataclass(frozen=True)
class TaskVisit:
    """A visit of a task in the tour: whether it was reached and held, and the largest missing torque, N·m."""

    task: str
    time: tuple[float, float]
    held: bool
    missing: float


@dataclass(frozen=True)
class ControlledTasks:
    """The controller, its simulated tour and its checks.

    Parameters
    ----------
    joint : Person
    controller : Controller
    tasks : tuple of (node, low, high)
        Angles that each node was made for, rad.
    margins : tuple of float
        Smallest reserve of the person's torque in these angles, N·m.
    left_out : tuple of str
        Nodes for which no pressures exist.
    motion : SwitchedMotion
    visits : tuple of TaskVisit
    gas : tuple of float
        Gas of each change in the tour, kg.
    maps : tuple of TransitionMap
    shortest_dwell, settling : float
        Shortest time in a node between two changes, s (infinite with fewer), and the time in which pressures settle.
    """

    person: Person
    controller: Controller
    tasks: tuple[tuple[str, float, float], ...]
    margins: tuple[float, ...]
    left_out: tuple[str, ...]
    motion: SwitchedMotion
    visits: tuple[TaskVisit, ...]
    gas: tuple[float, ...]
    maps: tuple[TransitionMap, ...]
    shortest_dwell: float
    settling: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences about every check that failed."""
        names = [node.name for node in self.controller.nodes]
        found = [f"no pressures hold the tasks of {name}" for name in self.left_out]
        pairs = itertools.pairwise(range(len(names)))
        found += [
            f"{names[a]} and {names[b]} have no overlap in which the pressures can change"
            for a, b in pairs
            if not (self._can_serve(a, b) and self._can_serve(b, a))
        ]
        lost = dict.fromkeys(visit.task for visit in self.visits if not visit.held)
        found += [f"{task} is not held throughout" for task in lost]
        if self.shortest_dwell < self.settling:
            found.append(
                f"the controller chatters: it stayed {self.shortest_dwell:.2f} s in a node, and the pressures need "
                f"{self.settling:.2f} s to settle"
            )
        for one in self.maps:
            unsafe = one.unsafe & one.switched[:, None]
            if unsafe.any():
                share = 100 * float(unsafe.sum()) / (one.switched.sum() * len(one.velocity))
                way = f"from {names[one.before]} to {names[one.after]}"
                found.append(f"a change {way} is unsafe in {share:.0f} % of the states in which it happens")
        return tuple(found)

    def _can_serve(self, before: int, after: int) -> bool:
        """Return whether a node holds the angles of another, or can change to it while the joint is held."""
        depth, angle = self.controller.nodes[before].depth, self.controller.angle
        _, low, high = self.tasks[after]
        if (depth[(angle >= low) & (angle <= high)] > 0).all():
            return True
        return bool((self.controller.may_change(before, after, angle) & (depth > 0)).any())


def control_tasks(
    joint: OneJoint, inertia: float, device: DeviceConfig, tasks: Sequence[Task], rules: ControllerRules
) -> ControlledTasks:
    """Choose pressures for each group of tasks, and simulate the controller through all tasks and back.

    Raises
    ------
    ValueError
        No pressures hold the tasks of any group.
    """
    cylinder, limits = device.keys.cylinder(), device.keys.limits()
    margin, hysteresis = np.radians([rules.margin_deg, rules.hysteresis_deg]).tolist()
    groups = _intervals(tasks)
    joined = _joined(joint, cylinder, limits, groups, 2 * (margin + hysteresis))
    angle = np.linspace(joint.lower, joint.upper, _GRID)
    nodes, kept, margins, left_out = [], [], [], []
    for name, low, high in joined:
        found = find_task_setting(joint, cylinder, limits, [(low, high)])
        if found is None or found[1] < -_TOLERANCE * (joint.torque_high - joint.torque_low):
            left_out.append(name)
            continue
        nodes.append(Node(name, found[0], compute_depths(find_holdable(joint, cylinder, found[0], angle), angle)))
        kept.append((name, low, high))
        margins.append(found[1])
    if not nodes:
        raise ValueError("no pressures of the device hold the tasks of any group")
    controller = Controller(tuple(nodes), angle, margin, hysteresis, *device.keys.settling.lags())
    person, speed = Person(joint, inertia, cylinder), float(np.radians(rules.speed_deg_s))
    pieces = [(task.name, *np.radians(task.angles_deg).tolist()) for task in tasks if task.angles_deg is not None]
    tour = plan_tour(pieces, speed, rules.hold_s, float(np.radians(rules.tremor_deg)))
    start = int(np.argmax([float(controller.depth(k, tour.angle[0])) for k in range(len(nodes))]))
    motion = simulate_switching(person, controller, tour, start)
    times = np.array([k * STEP for k, _, _ in motion.switches])
    maps = _maps(person, controller, _FASTER * speed)
    return ControlledTasks(
        person,
        controller,
        tuple(kept),
        tuple(margins),
        tuple(left_out),
        motion,
        _visits(person, motion),
        tuple(_gas(cylinder, controller, motion, device.keys.temperature_K)),
        maps,
        float(np.diff(times).min(initial=np.inf)),
        _SETTLED * controller.slowest,
    )


def _intervals(tasks: Sequence[Task]) -> list[tuple[str, float, float]]:
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


def _joined(
    joint: OneJoint,
    cylinder: Cylinder,
    limits: PressureLimits,
    groups: list[tuple[str, float, float]],
    overlap: float,
) -> list[tuple[str, float, float]]:
    """Return the intervals, with neighbours extended so that both are held in an overlap in which to change."""
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


def _maps(person: Person, controller: Controller, speed: float) -> tuple[TransitionMap, ...]:
    count = range(len(controller.nodes))
    found = [map_transition(person, controller, a, b, speed) for a in count for b in count if a != b]
    return tuple(one for one in found if one is not None)


def _visits(person: Person, motion: SwitchedMotion) -> tuple[TaskVisit, ...]:
    tour, span = motion.tour, person.joint.torque_high - person.joint.torque_low
    visits = []
    for visit in tour.visits:
        during = (tour.time >= visit.time[0]) & (tour.time <= visit.time[1])
        missing = float(motion.excess[during].max())
        away = float(np.abs(motion.angle - tour.angle)[np.searchsorted(tour.time, visit.held_until) - 1].max())
        visits.append(TaskVisit(visit.task, visit.time, bool(missing <= _TOLERANCE * span and away <= _AWAY), missing))
    return tuple(visits)


def _gas(cylinder: Cylinder, controller: Controller, motion: SwitchedMotion, temperature: float) -> list[float]:
    """Return the gas of each change, from the pressures of its moment, kg."""

    def setting(pressures: FloatArray) -> Setting:
        return Setting(*pressures.tolist())

    return [
        gas_of_change(cylinder, setting(motion.pressures[k]), controller.nodes[after].setting, temperature)
        for k, _, after in motion.switches
    ]
