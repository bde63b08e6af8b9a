"""The graph of sub-workspaces of a configuration's tasks (thesis 9.6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.prescription import Task
from mocap_id.prescription.one_spring import REST
from mocap_id.prescription.postures import sample_postures
from mocap_id.prescription.several_springs import find_holdable, prescribe_several
from mocap_id.prescription.sub_workspaces import Graph, SubWorkspace, build_graph, find_least_spring
from mocap_id.workflows.prescribe.result import PrescriptionResult

_ANGLES = 1441
_LEAST_FIRST = 1e3  # penalty that favours the softest springs
_SIDE = 3  # number of points along a side of a task's box


def build_task_graph(tasks: Sequence[Task], result: PrescriptionResult) -> tuple[Graph | None, FloatArray | None]:
    """Return the graph and its postures (N, n), rad; None without tasks.

    Tasks of one group belong to one node. The springs of a node are the softest springs that hold all its tasks. The
    node contains every posture that the person can hold with these springs.

    ValueError is raised if a task is outside the joint's limits, or cannot be reached.
    """
    if not tasks:
        return None, None
    groups: dict[str, list[Task]] = {}
    for task in tasks:
        groups.setdefault(task.group or task.name, []).append(task)
    if result.joint is not None:
        q = np.linspace(result.joint.lower, result.joint.upper, _ANGLES)[:, None]
        nodes = [_make_angle_node(name, members, result, q[:, 0]) for name, members in groups.items()]
        return build_graph(nodes, q), q
    assert result.postures is not None
    free = result.postures.cell < result.postures.cells
    nodes = [_make_tip_node(name, members, result, free) for name, members in groups.items()]
    return build_graph(nodes, result.postures.q[free]), result.postures.q[free]


def _make_angle_node(name: str, tasks: Sequence[Task], result: PrescriptionResult, angles: FloatArray) -> SubWorkspace:
    joint = result.joint
    assert joint is not None
    ends = np.radians([task.angles_deg for task in tasks if task.angles_deg is not None])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    if low < joint.lower or high > joint.upper:
        raise ValueError(
            f"the tasks of `{name}`, {np.degrees(low):.1f}° to {np.degrees(high):.1f}°, exceed the joint's limits"
        )
    allowed, stiffest = (result.places[0].rest, result.places[0].stiffest) if result.places else (REST, 0.0)
    spring = find_least_spring(joint, (low, high), allowed, stiffest)
    members = tuple(task.name for task in tasks)
    if spring is None:
        return SubWorkspace(name, members, None, None, np.zeros(len(angles), dtype=bool))
    stiffness, rest = spring
    torque = joint.torque(angles, stiffness, 0.0 if stiffness == 0 else rest)
    slack = 1e-6 * joint.weight
    held: BoolArray = (torque >= joint.torque_low - slack) & (torque <= joint.torque_high + slack)
    return SubWorkspace(name, members, np.array([stiffness]), np.array([rest]), held)


def _make_tip_node(name: str, tasks: Sequence[Task], result: PrescriptionResult, free: BoolArray) -> SubWorkspace:
    body, members = result.body, tuple(task.name for task in tasks)
    assert body.weights is not None and result.postures is not None
    points = np.concatenate([task_points(task) for task in tasks])
    wishes = result.config.wishes
    sampled = sample_postures(body.arm, body.weights, body.limits, result.places, points, wishes.postures, wishes.seed)
    try:
        springs = prescribe_several(sampled, result.places, body.strength, _LEAST_FIRST, wishes.boxes)
    except ValueError:
        return SubWorkspace(name, members, None, None, np.zeros(int(free.sum()), dtype=bool))
    held = find_holdable(result.postures, result.places, body.strength, springs)[free]
    return SubWorkspace(name, members, springs.stiffness, springs.rest, held)


def task_points(task: Task) -> FloatArray:
    """Return the points (P, 2) of a task, m: the task's point, or a grid in its box."""
    if task.point_m is not None:
        return np.array([task.point_m])
    assert task.box_m is not None
    low, high = np.array(task.box_m).min(axis=0), np.array(task.box_m).max(axis=0)
    across, up = (np.linspace(a, b, _SIDE) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
