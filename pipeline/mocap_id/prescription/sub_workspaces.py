"""Graph of sub-workspaces (thesis 9.6): a node is the set of postures held with one spring, an edge is an overlap.

In the overlap of two sub-workspaces, a device can change its setting while the person holds still, because the person's
torque is sufficient with both settings.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class SubWorkspace:
    """A sub-workspace: the postures that can be held with one setting of the springs.

    Parameters
    ----------
    name : str
    tasks : tuple of str
    stiffness, rest : (S,) arrays or None
        The least assistance, N·m/rad and rad (a rest angle of NaN: no spring); None if no spring is sufficient.
    held : (N,) bool array
        Whether each sampled posture can be held.
    """

    name: str
    tasks: tuple[str, ...]
    stiffness: FloatArray | None
    rest: FloatArray | None
    held: BoolArray


@dataclass(frozen=True)
class Switch:
    """An overlap of two sub-workspaces, in which the setting can be changed.

    Parameters
    ----------
    between : (int, int)
        Indices of the nodes.
    share : float
        Fraction of the sampled postures that is in both.
    posture : int
        Index of the posture in the middle of the overlap.
    """

    between: tuple[int, int]
    share: float
    posture: int


@dataclass(frozen=True)
class Graph:
    """Graph of sub-workspaces, with the switches between them as edges.

    Parameters
    ----------
    nodes : tuple of SubWorkspace
    switches : tuple of Switch
    """

    nodes: tuple[SubWorkspace, ...]
    switches: tuple[Switch, ...]

    def way(self, start: int, end: int) -> tuple[int, ...] | None:
        """Return the nodes of the shortest path between two nodes, both included; None if there is none."""
        came: dict[int, int] = {start: start}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            if here == end:
                path = [end]
                while path[-1] != start:
                    path.append(came[path[-1]])
                return tuple(reversed(path))
            for switch in self.switches:
                if here in switch.between:
                    other = switch.between[1] if switch.between[0] == here else switch.between[0]
                    if other not in came:
                        came[other] = here
                        queue.append(other)
        return None


def build_graph(nodes: Sequence[SubWorkspace], postures: FloatArray) -> Graph:
    """Build the graph of sub-workspaces.

    Parameters
    ----------
    nodes : sequence of SubWorkspace
    postures : (N, n) array
        The sampled postures, rad.
    """
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
