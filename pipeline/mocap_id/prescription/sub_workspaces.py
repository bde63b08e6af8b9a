"""Graph of sub-workspaces (thesis 9.6): a node is the set of postures held with one setting, an edge is an overlap.

In the overlap of two sub-workspaces, a device can change its setting while the person holds the posture, because the
person's torque is sufficient with both settings.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray


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
    share: float  # share of the sampled postures that is in both
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
