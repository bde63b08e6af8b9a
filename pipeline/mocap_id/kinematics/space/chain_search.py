"""Search for the chain: divide, order, give landmarks to the segment before their joint, and divide again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.kinematics.hypotheses import SegmentationRules
from mocap_id.kinematics.space.bodies import SpaceBodies, SpaceBody
from mocap_id.kinematics.space.chain_order import SpaceChain, find_chain, give_landmarks_to_parents
from mocap_id.kinematics.space.division import Division, divide

_LENIENT = 0.9  # a joint whose landmarks are on the wrong side has a large residual; it is judged when they have moved
_ROUNDS = 3


@dataclass(frozen=True)
class SpaceSearch:
    """A chain, if there is one, and the divisions that led to it.

    Parameters
    ----------
    chain : SpaceChain or None
    bodies : tuple of SpaceBody
        All rigid bodies.
    made, refused : tuple of Division
        Accepted divisions, and the best division of every body that stayed whole.
    """

    chain: SpaceChain | None
    bodies: tuple[SpaceBody, ...]
    made: tuple[Division, ...]
    refused: tuple[Division, ...]


def search_chain(sorter: SpaceBodies, rules: SegmentationRules, needed: float) -> SpaceSearch:
    """Return the longest chain of real joints among rigid bodies.

    Landmarks on the wrong side of a joint spoil the bodies on both sides. When they have moved, every body is tried for
    another division.

    Parameters
    ----------
    sorter : SpaceBodies
    rules : SegmentationRules
    needed : float
        Least evidence of a division, 1 as a rule.
    """
    start: tuple[SpaceBody, ...] = (sorter.body(sorter.markers),)
    made: list[Division] = []
    for _ in range(_ROUNDS):
        found = divide(sorter, start, needed)
        if not found.made:
            break
        made += found.made
        chain = find_chain(found, sorter.points, rules, _LENIENT)
        if chain is None:
            start = tuple(found.bodies)
            break
        chain = give_landmarks_to_parents(chain, sorter)
        start = (*chain.bodies, *chain.branches)
    if found.made:
        found = divide(sorter, start, np.inf)
    return SpaceSearch(find_chain(found, sorter.points, rules), tuple(found.bodies), tuple(made), tuple(found.refused))
