"""Pressures of devices for the tasks of a joint or a chain, and checks of the controller that changes them (9.6)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.dynamics.cylinder import Setting
from mocap_id_assist.assisted_body import PrescriptionResult, find_task_points
from mocap_id_assist.controllers import (
    TOLERANCE,
    Actuator,
    AssistedChain,
    AssistedJoint,
    Controlled,
    JointController,
    Node,
    NodeChange,
    Rules,
    Tour,
    Visit,
    compute_depths,
    compute_node_depths,
    find_pressures,
    find_unsafe_changes,
    map_change,
    plan_tour,
    simulate_chain_tour,
    simulate_joint_tour,
)
from mocap_id_assist.devices import find_held_angles, find_task_setting, gas_of_change
from mocap_id_assist.files import ControllerRules, Task
from mocap_id_assist.springs import OneJoint, SubWorkspace, sample_postures

_GRID = 721
_MEETINGS = 13  # number of angles or postures at which two sub-workspaces may be joined
_CHATTER = 3.0  # number of time constants after which pressures have settled; faster changes of the node are chatter
_AWAY = np.radians(2.0)  # rad, largest distance from the reference at the end of a hold of a task that is reached
_FASTER = 1.5  # changes of a joint must be safe up to this factor times the speed of the tour
_STARTS = 1024  # number of sampled postures from which the search for postures of a task starts
_Part = TypeVar("_Part")


def control_joint(
    joint: OneJoint, inertia: float, device: DeviceConfig, tasks: Sequence[Task], wishes: ControllerRules
) -> Controlled:
    """Choose pressures for each group of tasks, simulate a tour through all tasks and back, and check the controller.

    ValueError is raised if no pressures hold the tasks of any group.
    """
    actuator, rules = _make_actuator(device, (0,)), _make_rules(wishes)
    cylinder, limits = actuator.cylinder, actuator.limits
    span = joint.torque_high - joint.torque_low

    # the interval of each group of tasks, in order of the angle, extended so that neighbours overlap
    pairs: dict[str, list[tuple[float, float]]] = {}
    for task in tasks:
        assert task.angles_deg is not None
        pairs.setdefault(task.group or task.name, []).append(task.angles_deg)
    groups = [
        (name, *np.radians([min(low for low, _ in ends), max(high for _, high in ends)]).tolist())
        for name, ends in pairs.items()
    ]
    groups.sort(key=lambda one: one[1] + one[2])
    names, intervals = [one[0] for one in groups], [(one[1], one[2]) for one in groups]

    def meet(k: int, joined: list[tuple[float, float]]) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
        half = rules.margin + rules.hysteresis
        (low, high), (first, last) = joined[k], joined[k + 1]
        for meeting in np.linspace(min(high, first), max(high, first), _MEETINGS).tolist():
            lower = low, min(max(high, meeting + half), joint.upper)
            yield lower, (max(min(first, meeting - half), joint.lower), last)

    def margin_of(interval: tuple[float, float]) -> float:
        found = find_task_setting(joint, cylinder, limits, [interval])
        return -np.inf if found is None else found[1]

    intervals = _join_neighbours(intervals, meet, margin_of)

    # one node for each interval that can be held
    angle = np.linspace(joint.lower, joint.upper, _GRID)
    nodes, depths, made_for, reserve, problems = [], [], [], [], []
    for name, interval in zip(names, intervals, strict=True):
        found = find_task_setting(joint, cylinder, limits, [interval])
        if found is None or found[1] < -TOLERANCE * span:
            problems.append(f"no pressures hold the tasks of {name}")
            continue
        nodes.append(Node(name, found[0].pressures()[None]))
        depths.append(compute_depths(find_held_angles(joint, cylinder, found[0], angle), angle))
        made_for.append(interval)
        reserve.append(found[1])
    if not nodes:
        raise ValueError(
            "the device has no pressures with which the person can hold the angles of all tasks of any group"
        )
    controller = JointController(tuple(nodes), angle, np.array(depths), rules)

    # the tour, and every change from all states in which both nodes hold the joint
    assisted = AssistedJoint(joint, inertia, actuator)
    pieces = [(task.name, *np.radians(task.angles_deg).tolist()) for task in tasks if task.angles_deg is not None]
    reference = plan_tour(pieces, rules, float(np.radians(wishes.tremor_deg)))
    start = int(np.argmax([float(controller.depth(k, reference.angle[0])) for k in range(len(nodes))]))
    tour = simulate_joint_tour(assisted, controller, reference, start)
    pairs_of_nodes = itertools.permutations(range(len(nodes)), 2)
    mapped = [map_change(assisted, controller, a, b, _FASTER * rules.speed) for a, b in pairs_of_nodes]
    changes = [one for one in mapped if one is not None]

    # the checks
    for a, b in itertools.pairwise(range(len(nodes))):
        if not (_serves(controller, made_for, a, b) and _serves(controller, made_for, b, a)):
            problems.append(f"{nodes[a].name} and {nodes[b].name} have no overlap in which the pressures can change")
    visits = []
    for task_name, begin, end, holds in reference.visits:
        missing = float(tour.excess[(tour.time >= begin) & (tour.time <= end)].max())
        away = float(np.abs(tour.q[:, 0] - reference.angle)[np.searchsorted(tour.time, holds) - 1].max())
        visits.append(Visit(task_name, begin, None, bool(missing <= TOLERANCE * span and away <= _AWAY), missing))
    problems += _describe_missed(visits)
    dwell, settling = _find_dwell(tour), _CHATTER * actuator.slowest
    problems += _describe_chatter(dwell, settling)
    for change in changes:
        unsafe = change.unsafe & change.switched
        if unsafe.any():
            share = 100 * float(unsafe.sum()) / change.switched.sum()
            problems.append(_describe_unsafe(nodes, change, share, "states"))
    return Controlled(
        nodes=tuple(nodes),
        joints=(actuator.joints,),
        grid=angle[:, None],
        held=controller.depths > 0,
        reserve=tuple(reserve),
        made_for=tuple(made_for),
        tour=tour,
        visits=tuple(visits),
        gas=_compute_gas([actuator], nodes, tour),
        changes=tuple(changes),
        shortest_dwell=dwell,
        settling=settling,
        problems=tuple(problems),
    )


def _serves(controller: JointController, made_for: Sequence[tuple[float, float]], before: int, after: int) -> bool:
    """Return whether node ``before`` holds the tasks of node ``after``, or can change to it and hold the joint."""
    depth, angle = controller.depths[before], controller.angle
    low, high = made_for[after]
    if (depth[(angle >= low) & (angle <= high)] > 0).all():
        return True
    return bool((controller.may_change(before, after, angle) & (depth > 0)).any())


def control_chain(
    result: PrescriptionResult, devices: Sequence[DeviceConfig | None], wishes: ControllerRules
) -> Controlled:
    """Choose pressures for each group of tasks, simulate a tour through all tasks and back, and check the controller.

    ValueError is raised if no pressures hold the tasks of any group.
    """
    assert result.graph is not None
    chain, q, rules = _make_chain(result, devices), result.graph.postures, _make_rules(wishes)

    # the postures of each group that can be held, extended so that neighbours overlap where the node can change: on the
    # straight line between their nearest stops
    tasks = {task.name: task for task in result.config.wishes.tasks}
    names: list[str] = []
    stops: list[str] = []  # task of each stop of the tour
    groups: list[FloatArray] = []  # (P, n) postures of the stops of each group, rad
    problems: list[str] = []
    for each in result.graph.nodes:
        own = None if each.stiffness is None else _find_postures(result, each, [tasks[name] for name in each.tasks])
        pressures = None if own is None else find_pressures(chain, own[1])
        if own is None or pressures is None or pressures[1] < -TOLERANCE:
            problems.append(f"no pressures hold the tasks of {each.name}")
            continue
        names.append(each.name)
        stops += own[0]
        groups.append(own[1])

    def meet(k: int, joined: list[FloatArray]) -> Iterator[tuple[FloatArray, FloatArray]]:
        one, other = groups[k], groups[k + 1]
        apart = np.linalg.norm(one[:, None] - other, axis=2)
        a, b = np.unravel_index(int(apart.argmin()), apart.shape)
        along = (other[b] - one[a]) / max(float(apart[a, b]), 1e-9)
        for share in np.linspace(0, 1, _MEETINGS):
            ends = np.array([[-1.0], [1.0]]) * (rules.margin + rules.hysteresis) * along
            meeting = np.clip(one[a] + share * (other[b] - one[a]) + ends, chain.lower, chain.upper)
            yield np.concatenate([joined[k], meeting]), np.concatenate([other, meeting])

    def margin_of(postures: FloatArray) -> float:
        found = find_pressures(chain, postures)
        return -np.inf if found is None else found[1]

    nodes, reserve = [], []
    for name, postures in zip(names, _join_neighbours(groups, meet, margin_of), strict=True):
        found = find_pressures(chain, postures)
        assert found is not None
        nodes.append(Node(name, found[0]))
        reserve.append(found[1])
    if not nodes:
        raise ValueError("no pressures of the devices hold the tasks of any group")

    # the tour, and every change at rest in the sampled postures that both nodes hold
    tour, visited, no_path = simulate_chain_tour(chain, nodes, np.concatenate(groups), q, rules)
    tolerance = TOLERANCE * float(np.ptp(chain.strength, axis=1).min())
    depth = compute_node_depths(chain, nodes, q)
    changes = []
    for before, after in itertools.permutations(range(len(nodes)), 2):
        both = (depth[before] > 0) & (depth[after] > 0)
        if both.any():
            unsafe, missing = find_unsafe_changes(chain, nodes[before], nodes[after], q[both], tolerance)
            switched = (depth[before, both] < rules.margin) & (depth[after, both] > rules.margin + rules.hysteresis)
            changes.append(NodeChange(before, after, q[both], missing, switched, unsafe))

    # the checks
    between = dict.fromkeys((stops[a], stops[b]) for a, b in no_path)
    problems += [f"there is no path between {a} and {b} through postures that a node holds" for a, b in between]
    visits = []
    for stop, first, last in visited:
        worst = float(tour.excess[first : last + 1].max())
        visits.append(Visit(stops[stop], float(tour.time[first]), tour.q[first], worst <= tolerance, worst))
    missed, largest = _describe_missed(visits), float(tour.excess.max())
    problems += missed
    if not missed and largest > tolerance:
        problems.append(f"between the tasks, up to {largest:.2f} N·m of torque are missing")
    dwell, settling = _find_dwell(tour), _CHATTER * chain.slowest
    problems += _describe_chatter(dwell, settling)
    for change in changes:
        if (change.unsafe & change.switched).any():
            share = 100 * float(change.unsafe[change.switched].mean())
            problems.append(_describe_unsafe(nodes, change, share, "postures"))
    return Controlled(
        nodes=tuple(nodes),
        joints=tuple(one.joints for one in chain.actuators),
        grid=q,
        held=depth > 0,
        reserve=tuple(reserve),
        made_for=(),
        tour=tour,
        visits=tuple(visits),
        gas=_compute_gas(chain.actuators, nodes, tour),
        changes=tuple(changes),
        shortest_dwell=dwell,
        settling=settling,
        problems=tuple(problems),
    )


def _make_chain(result: PrescriptionResult, devices: Sequence[DeviceConfig | None]) -> AssistedChain:
    """Return the chain with its cylinders; a spring without a device stays as prescribed in all nodes."""
    body, springs = result.body, result.several
    assert body.weights is not None and springs is not None
    weights, passive, actuators = body.weights, [], []
    for place, device, stiffness, rest in zip(result.places, devices, springs.stiffness, springs.rest, strict=True):
        if device is not None:
            actuators.append(_make_actuator(device, place.joints))
        elif stiffness > 0:
            passive.append((list(place.joints), float(stiffness), float(rest)))

    def held(q: FloatArray) -> FloatArray:
        torque = weights.torques(q).copy()
        for joints, stiffness, rest in passive:
            torque[:, joints] += stiffness * (q[:, joints].sum(axis=1, keepdims=True) - rest)
        return torque

    return AssistedChain(held, body.strength, body.limits.lower, body.limits.upper, tuple(actuators))


def _find_postures(
    result: PrescriptionResult, node: SubWorkspace, tasks: Sequence[Task]
) -> tuple[list[str], FloatArray]:
    """Return for P points the name of the task and the sampled posture (P, n), rad, with the largest torque reserve."""
    body, wishes = result.body, result.config.wishes
    assert body.weights is not None and node.stiffness is not None and node.rest is not None
    each = [(task.name, find_task_points(task)) for task in tasks]
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


def _make_actuator(device: DeviceConfig, joints: tuple[int, ...]) -> Actuator:
    keys = device.keys
    return Actuator(keys.cylinder(), keys.limits(), joints, *keys.settling.lags(), keys.temperature_K)


def _make_rules(wishes: ControllerRules) -> Rules:
    margin, hysteresis, speed = np.radians([wishes.margin_deg, wishes.hysteresis_deg, wishes.speed_deg_s]).tolist()
    return Rules(margin, hysteresis, speed, wishes.hold_s)


def _join_neighbours(
    parts: Sequence[_Part],
    meet: Callable[[int, list[_Part]], Iterator[tuple[_Part, _Part]]],
    margin_of: Callable[[_Part], float],
) -> list[_Part]:
    """Return the tasks of the groups, extended so that neighbours overlap where the smaller reserve is largest.

    ``meet`` yields extended parts k and k + 1 for each possible meeting; ``margin_of`` returns the reserve of a part.
    Neighbours stay apart if no pressures hold them where they meet.
    """
    joined = list(parts)
    for k in range(len(joined) - 1):
        best, worth = None, 0.0
        for sides in meet(k, joined):
            margin = min(margin_of(side) for side in sides)
            if margin > worth:
                best, worth = sides, margin
        if best is not None:
            joined[k], joined[k + 1] = best
    return joined


def _compute_gas(actuators: Sequence[Actuator], nodes: Sequence[Node], tour: Tour) -> tuple[float, ...]:
    """Return the gas of each change, from the pressures at the time of the change, kg."""
    return tuple(
        sum(
            gas_of_change(one.cylinder, Setting(*was.tolist()), Setting(*new.tolist()), one.temperature)
            for one, was, new in zip(actuators, tour.pressures[k], nodes[after].pressures, strict=True)
        )
        for k, _, after in tour.switches
    )


def _find_dwell(tour: Tour) -> float:
    """Return the shortest time in a node between two changes, s; infinite with fewer than two changes."""
    return float(np.diff([tour.time[k] for k, _, _ in tour.switches]).min(initial=np.inf))


def _describe_missed(visits: Sequence[Visit]) -> list[str]:
    return [f"{task} is not held throughout" for task in dict.fromkeys(v.task for v in visits if not v.held)]


def _describe_chatter(dwell: float, settling: float) -> list[str]:
    if dwell >= settling:
        return []
    return [
        f"the controller chatters: it stayed {dwell:.2f} s in a node, but the pressures need {settling:.2f} s to settle"
    ]


def _describe_unsafe(nodes: Sequence[Node], change: NodeChange, share: float, places: str) -> str:
    names = f"{nodes[change.before].name} to {nodes[change.after].name}"
    return f"a change from {names} is unsafe in {share:.0f} % of the {places} in which it happens"
