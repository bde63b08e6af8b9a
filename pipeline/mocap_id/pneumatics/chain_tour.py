"""A tour of a chain through the postures of tasks, with a controller that changes the pressures (thesis 9.6).

A node is a set of sealed pressures. The depth of a posture in a node is its distance from the nearest posture that the
node does not hold. The rule is the same as for one joint: where the depth is below a margin, the controller changes to
the node with the largest depth, if this is above margin plus hysteresis. If the current node does not hold the posture,
the depth must only be above 0. Each posture is treated as at rest: torques of acceleration and friction are ignored.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.pneumatics.assisted_chain import AssistedChain

STEP = 0.01
"""Time step of the tour, s."""
_NEIGHBOURS = 12
_BETWEEN = 33  # number of postures on the straight line from one stop to the next
_CHANGE = 1e-3  # rad: cost of a change of node in the search for a path
_SETTLING_STEPS = 40
_SETTLED = 4.0  # simulated time constants of a change


@dataclass(frozen=True)
class ChainNode:
    """A node of the controller: its name and its sealed pressures (D, 2), Pa."""

    name: str
    pressures: FloatArray


@dataclass(frozen=True)
class TourRules:
    """Rules of the controller and of the tour."""

    margin: float  # depth below which the controller leaves a node, rad
    hysteresis: float  # additional depth of the next node, rad
    speed: float  # largest speed of a joint, rad/s
    hold: float  # time for which each stop is held, s


@dataclass(frozen=True)
class ChainTour:
    """A simulated tour of n joints with D cylinders, with T samples."""

    time: FloatArray  # (T,) s
    q: FloatArray  # (T, n) rad
    node: IntArray  # (T,) index of the current node
    pressures: FloatArray  # (T, D, 2) sealed pressures, Pa
    excess: FloatArray  # (T,) part of the holding torque beyond the person's limits, N·m
    switches: tuple[tuple[int, int, int], ...]  # sample, node before and node after each change
    visits: tuple[tuple[int, int, int], ...]  # index of the stop, first and last sample at which it is held
    no_path: tuple[tuple[int, int], ...]  # pairs of stops without a path through held postures


def compute_node_depths(chain: AssistedChain, nodes: Sequence[ChainNode], q: FloatArray) -> FloatArray:
    """Return the depth (K, M) of postures (M, n) in each of the K nodes, rad."""
    return np.stack([chain.depth(q, node.pressures) for node in nodes])


def simulate_tour(
    chain: AssistedChain, nodes: Sequence[ChainNode], stops: FloatArray, postures: FloatArray, rules: TourRules
) -> ChainTour:
    """Return a tour through ``stops`` (P, n) and back; its paths use ``postures`` (N, n) that a node holds, rad."""
    order = [*range(len(stops)), *range(len(stops) - 2, -1, -1)]
    shares = np.linspace(0, 1, _BETWEEN)[1:-1, None]
    straight = [one + shares * (other - one) for one, other in itertools.pairwise(stops)]
    known = np.concatenate([stops, *straight, postures])
    deep = rules.margin + rules.hysteresis
    paths = functools.cache(lambda least: _find_paths(chain, nodes, known, len(stops), least))
    q, visits, no_path = [stops[order[0]][None]], [], []
    hold, count = max(int(rules.hold / STEP), 1), 1
    for a, b in [(order[0], order[0]), *itertools.pairwise(order)]:
        path = next((path for least in (deep, 0.0) if (path := _trace_path(*paths(least), a, b)) is not None), None)
        if path is None:
            no_path.append((a, b))
        points = known[[a, b] if path is None else np.array(path) % len(known)]
        pieces = [_move_straight(one, other, rules.speed) for one, other in itertools.pairwise(points)]
        q += [*pieces, np.repeat(stops[b][None], hold, axis=0)]
        count += sum(map(len, pieces)) + hold
        visits.append((b, count - hold, count - 1))
    return _control(chain, nodes, np.concatenate(q), rules, tuple(visits), tuple(dict.fromkeys(no_path)))


def _control(  # noqa: PLR0917
    chain: AssistedChain,
    nodes: Sequence[ChainNode],
    q: FloatArray,
    rules: TourRules,
    visits: tuple[tuple[int, int, int], ...],
    no_path: tuple[tuple[int, int], ...],
) -> ChainTour:
    """Return the tour with the node and the pressures of every sample."""
    depth = compute_node_depths(chain, nodes, q)
    here = int(depth[:, 0].argmax())
    gas, node, switches = nodes[here].pressures, np.empty(len(q), dtype=np.int64), []
    pressures = np.empty((len(q), *gas.shape))
    for k in range(len(q)):
        if depth[here, k] < rules.margin:
            better = int(depth[:, k].argmax())
            held = depth[here, k] > 0
            if better != here and depth[better, k] > (rules.margin + rules.hysteresis if held else 0.0):
                switches.append((k, here, better))
                here = better
        node[k], pressures[k] = here, gas
        gas = chain.settle(gas, nodes[here].pressures, STEP)
    excess = chain.excess(chain.holding_torques(q, pressures))
    time: FloatArray = STEP * np.arange(len(q), dtype=np.float64)
    return ChainTour(time, q, node, pressures, excess, tuple(switches), visits, no_path)


def find_unsafe_changes(
    chain: AssistedChain, before: ChainNode, after: ChainNode, q: FloatArray, tolerance: float
) -> tuple[BoolArray, FloatArray]:
    """Return whether a change of node at rest in postures (M, n) is unsafe, and the largest missing torque (M,), N·m.

    A change is unsafe if the holding torque exceeds the person's limits by more than a tolerance, N·m, while the
    pressures settle.
    """
    gas, worst = before.pressures, np.zeros(len(q))
    for _ in range(_SETTLING_STEPS + 1):
        worst = np.maximum(worst, chain.excess(chain.holding_torques(q, gas[None])))
        gas = chain.settle(gas, after.pressures, _SETTLED * chain.slowest / _SETTLING_STEPS)
    return worst > tolerance, worst


def _find_paths(
    chain: AssistedChain, nodes: Sequence[ChainNode], known: FloatArray, stops: int, least: float
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
            edges.append((k * len(known) + both, j * len(known) + both, np.full(len(both), _CHANGE)))
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


def _move_straight(start: FloatArray, end: FloatArray, speed: float) -> FloatArray:
    """Return postures (K, n) from ``start`` (excluded) to ``end``; no joint is faster than ``speed``, rad/s."""
    count = max(int(np.ceil(np.abs(end - start).max() / (speed * STEP))), 1)
    return np.asarray(start + np.linspace(0, 1, count + 1)[1:, None] * (end - start))
