"""Simulated controller that changes the pressures of a chain's devices between its tasks (thesis 9.6)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.device import DeviceConfig
from mocap_id.config.prescription import ControllerRules, Task
from mocap_id.pneumatics.assisted_chain import Actuator, AssistedChain, find_pressures
from mocap_id.pneumatics.chain_tour import (
    STEP,
    ChainNode,
    ChainTour,
    TourRules,
    compute_node_depths,
    find_unsafe_changes,
    simulate_tour,
)
from mocap_id.pneumatics.cylinder import Setting, gas_of_change
from mocap_id.prescription.postures import sample_postures
from mocap_id.prescription.sub_workspaces import SubWorkspace
from mocap_id.workflows.prescribe.controlled_tasks import SETTLED, describe_chatter
from mocap_id.workflows.prescribe.result import PrescriptionResult
from mocap_id.workflows.prescribe.task_graph import task_points

_STARTS = 1024  # number of sampled postures from which the search for postures of a task starts
_MEETINGS = 13  # number of postures at which two sub-workspaces may be joined
_TOLERANCE = 1e-3  # fraction of the smallest range of a joint's torque


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
        return float(np.diff([k * STEP for k, _, _ in self.switches]).min(initial=np.inf))

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
    tolerance = _TOLERANCE * float(np.ptp(chain.strength, axis=1).min())
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
        tuple(_compute_gas(chain, nodes, tour)),
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
        if found is None or pressures is None or pressures[1] < -_TOLERANCE:
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


def _compute_gas(chain: AssistedChain, nodes: Sequence[ChainNode], tour: ChainTour) -> Iterator[float]:
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
