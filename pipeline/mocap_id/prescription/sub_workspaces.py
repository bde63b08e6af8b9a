"""Sub-workspaces (thesis 9.6): the softest spring for an interval of angles, and the graph of sub-workspaces.

A node of the graph is the set of postures held with one setting, and an edge is an overlap. In the overlap of two
sub-workspaces, a device can change its setting while the person holds the posture, because the person's torque is
sufficient with both settings.

The limits of the torque are τ_low and τ_high, those of the rest angle θ_least and θ_most. A rest angle exists for a
stiffness k if w = g + kθ meets three inequalities: max w - min w ≤ τ_high - τ_low, max w - τ_high ≤ k θ_most and
min w - τ_low ≥ k θ_least. Each involves a maximum or minimum of functions that are linear in k, and is convex in k. The
suitable stiffnesses therefore form an interval, and bisection finds its lower end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.prescription.one_joint import OneJoint


@dataclass(frozen=True)
class SubWorkspace:
    """A sub-workspace: the postures that can be held with one setting of the springs."""

    name: str
    tasks: tuple[str, ...]
    stiffness: FloatArray | None  # (S,) stiffness of the least assistance, N·m/rad; None if no spring is sufficient
    rest: FloatArray | None  # (S,) rest angles, rad; NaN for no spring
    held: BoolArray  # (N,) whether each sampled posture can be held


@dataclass(frozen=True)
class Switch:
    """An overlap of two sub-workspaces, in which the setting can be changed."""

    between: tuple[int, int]  # indices of the nodes
    share: float  # fraction of the sampled postures that are in both
    posture: int  # index of the posture in the middle of the overlap


@dataclass(frozen=True)
class Graph:
    """Graph of sub-workspaces, with the switches between them as edges."""

    nodes: tuple[SubWorkspace, ...]
    switches: tuple[Switch, ...]

    def find_path(self, start: int, end: int) -> tuple[int, ...] | None:
        """Return the nodes of the shortest path between two nodes, both included; None if there is none."""
        previous: dict[int, int] = {start: start}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            if here == end:
                path = [end]
                while path[-1] != start:
                    path.append(previous[path[-1]])
                return tuple(reversed(path))
            for switch in self.switches:
                if here in switch.between:
                    other = switch.between[1] if switch.between[0] == here else switch.between[0]
                    if other not in previous:
                        previous[other] = here
                        queue.append(other)
        return None


def build_graph(nodes: Sequence[SubWorkspace], postures: FloatArray) -> Graph:
    """Return the graph of sub-workspaces, whose switches are overlaps of the sampled postures (N, n), rad."""
    switches = []
    for a in range(len(nodes)):
        for b in range(a + 1, len(nodes)):
            if nodes[a].stiffness is None or nodes[b].stiffness is None:
                continue
            both = np.flatnonzero(nodes[a].held & nodes[b].held)
            if len(both):
                middle = np.median(postures[both], axis=0)
                nearest = both[np.abs(postures[both] - middle).sum(axis=1).argmin()]
                switches.append(Switch((a, b), len(both) / len(postures), int(nearest)))
    return Graph(tuple(nodes), tuple(switches))


_GRID = 721
_STEPS = 200


def find_least_spring(
    joint: OneJoint, interval: tuple[float, float], rest: tuple[float, float], stiffest: float | None = None
) -> tuple[float, float] | None:
    """Return stiffness, N·m/rad, and rest angle, rad, of the softest spring that holds an interval of angles, rad.

    The result is (0, NaN) if no spring is needed, and None if no spring is sufficient. ``rest`` contains the smallest
    and largest rest angle, rad. ``stiffest`` is the largest stiffness; by default it is twenty times the largest
    gravitational moment per radian.
    """
    grid = np.linspace(*interval, _GRID) if interval[1] > interval[0] else np.array([interval[0]])
    gravity = joint.gravity(grid)

    def excess(k: float) -> float:
        w = gravity + k * grid
        above, below = w.max() - joint.torque_high, w.min() - joint.torque_low
        return float(max(above - below, above - k * rest[1], k * rest[0] - below)) / joint.weight

    if excess(0.0) <= 1e-9:
        return 0.0, np.nan
    low, high = 0.0, 20.0 * joint.weight if stiffest is None else stiffest
    best = _minimise(excess, low, high)
    if excess(best) > 1e-9:
        return None
    outside, inside = 0.0, best
    for _ in range(_STEPS):
        middle = 0.5 * (outside + inside)
        outside, inside = (outside, middle) if excess(middle) <= 1e-9 else (middle, inside)
    return inside, _middle_rest(joint, gravity + inside * grid, inside, rest)


def _minimise(excess: Callable[[float], float], low: float, high: float) -> float:
    """Return the minimiser of a convex function by ternary search, or the first point at which it is at most 0."""
    for _ in range(_STEPS):
        one, other = low + (high - low) / 3, high - (high - low) / 3
        here, there = excess(one), excess(other)
        if min(here, there) <= 0:
            return one if here <= 0 else other
        low, high = (low, other) if here <= there else (one, high)
    return 0.5 * (low + high)


def _middle_rest(joint: OneJoint, w: FloatArray, stiffness: float, rest: tuple[float, float]) -> float:
    """Return the rest angle, rad, in ``rest`` that best centres ``w`` (M,) minus the spring torque in the limits."""
    middle = 0.5 * (w.max() - joint.torque_high + w.min() - joint.torque_low) / stiffness
    return float(np.clip(middle, *rest))
