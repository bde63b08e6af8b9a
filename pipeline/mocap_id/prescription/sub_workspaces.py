"""Tasks as a graph of sub-workspaces (thesis 9.6): a node is what a spring lets a person hold, an edge an overlap.

Where two sub-workspaces overlap a device can change from one setting to the other while the person holds still, with
the person's own torque either way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Node:
    """A sub-workspace.

    Parameters
    ----------
    name : str
    tasks : tuple of str
    stiffness, rest : (S,) arrays or None
        The least assistance, N·m/rad and rad (NaN rest: no spring); None where no spring will do.
    held : (N,) bool array
        Of the sampled postures, which can be held with it.
    """

    name: str
    tasks: tuple[str, ...]
    stiffness: FloatArray | None
    rest: FloatArray | None
    held: BoolArray


@dataclass(frozen=True)
class Switch:
    """An overlap of two sub-workspaces, and where to change.

    Parameters
    ----------
    between : (int, int)
        Indices of the nodes.
    share : float
        Of the sampled postures, in both.
    posture : int
        Index of the one in the overlap's middle.
    """

    between: tuple[int, int]
    share: float
    posture: int


@dataclass(frozen=True)
class Graph:
    """Nodes, the switches between them, and the ways from node to node.

    Parameters
    ----------
    nodes : tuple of Node
    switches : tuple of Switch
    """

    nodes: tuple[Node, ...]
    switches: tuple[Switch, ...]

    def way(self, start: int, end: int) -> tuple[int, ...] | None:
        """Nodes of the shortest way between two, both included; None where there is none."""
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


def graph(nodes: Sequence[Node], postures: FloatArray) -> Graph:
    """The graph of sub-workspaces.

    Parameters
    ----------
    nodes : sequence of Node
    postures : (N, n) array
        Those that `held` is about, rad.
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
