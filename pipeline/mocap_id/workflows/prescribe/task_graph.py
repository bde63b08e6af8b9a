"""The graph of sub-workspaces of a configuration's tasks (thesis 9.6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.prescription import Task
from mocap_id.prescription.least_spring import find_least_spring
from mocap_id.prescription.one_spring import REST
from mocap_id.prescription.postures import sample_postures
from mocap_id.prescription.several_springs import find_holdable, prescribe_several
from mocap_id.prescription.sub_workspaces import Graph, SubWorkspace, build_graph
from mocap_id.workflows.prescribe.result import PrescriptionResult

_ANGLES = 1441
_LEAST_FIRST = 1e3  # penalty that favours the softest springs
_SIDE = 3  # points along a side of a task's box


def task_graph(tasks: Sequence[Task], found: PrescriptionResult) -> tuple[Graph | None, FloatArray | None]:
    """Return the graph and its postures (N, n), rad; None without tasks.

    Tasks of one group share a node. The springs of a node are the softest that hold all its tasks; the node contains
    every posture that the person can hold with them.

    Raises
    ------
    ValueError
        A task is outside the joint's limits, or cannot be reached.
    """
    if not tasks:
        return None, None
    groups: dict[str, list[Task]] = {}
    for task in tasks:
        groups.setdefault(task.group or task.name, []).append(task)
    if found.joint is not None:
        q = np.linspace(found.joint.lower, found.joint.upper, _ANGLES)[:, None]
        nodes = [_angle_node(name, members, found, q[:, 0]) for name, members in groups.items()]
        return build_graph(nodes, q), q
    assert found.postures is not None
    free = found.postures.cell < found.postures.cells
    nodes = [_tip_node(name, members, found, free) for name, members in groups.items()]
    return build_graph(nodes, found.postures.q[free]), found.postures.q[free]


def _angle_node(name: str, tasks: Sequence[Task], found: PrescriptionResult, angles: FloatArray) -> SubWorkspace:
    joint = found.joint
    assert joint is not None
    ends = np.radians([task.angles_deg for task in tasks if task.angles_deg is not None])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    if low < joint.lower or high > joint.upper:
        raise ValueError(
            f"the tasks of `{name}`, {np.degrees(low):.1f}° to {np.degrees(high):.1f}°, go beyond the joint's limits"
        )
    allowed, stiffest = (found.places[0].rest, found.places[0].stiffest) if found.places else (REST, 0.0)
    spring = find_least_spring(joint, (low, high), allowed, stiffest)
    members = tuple(task.name for task in tasks)
    if spring is None:
        return SubWorkspace(name, members, None, None, np.zeros(len(angles), dtype=bool))
    stiffness, rest = spring
    torque = joint.torque(angles, stiffness, 0.0 if stiffness == 0 else rest)
    slack = 1e-6 * joint.weight
    held: BoolArray = (torque >= joint.torque_low - slack) & (torque <= joint.torque_high + slack)
    return SubWorkspace(name, members, np.array([stiffness]), np.array([rest]), held)


def _tip_node(name: str, tasks: Sequence[Task], found: PrescriptionResult, free: BoolArray) -> SubWorkspace:
    body, members = found.body, tuple(task.name for task in tasks)
    assert body.weights is not None and found.postures is not None
    points = np.concatenate([task_points(task) for task in tasks])
    wishes = found.config.wishes
    sampled = sample_postures(body.arm, body.weights, body.limits, found.places, points, wishes.postures, wishes.seed)
    try:
        springs = prescribe_several(sampled, found.places, body.strength, _LEAST_FIRST, wishes.boxes)
    except ValueError:
        return SubWorkspace(name, members, None, None, np.zeros(int(free.sum()), dtype=bool))
    held = find_holdable(found.postures, found.places, body.strength, springs)[free]
    return SubWorkspace(name, members, springs.stiffness, springs.rest, held)


def task_points(task: Task) -> FloatArray:
    """Return the points (P, 2) of a task: its point, or a grid over its box."""
    if task.point_m is not None:
        return np.array([task.point_m])
    assert task.box_m is not None
    low, high = np.array(task.box_m).min(axis=0), np.array(task.box_m).max(axis=0)
    across, up = (np.linspace(a, b, _SIDE) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
