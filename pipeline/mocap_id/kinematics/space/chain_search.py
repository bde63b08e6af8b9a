"""Search for the chain: divide, order, give landmarks to the segment before their joint, and divide again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.kinematics.hypotheses import SegmentationRules
from mocap_id.kinematics.space.bodies import SpatialBodies, SpatialBody
from mocap_id.kinematics.space.chain_order import SpatialBodyChain, find_chain, give_landmarks_to_parents
from mocap_id.kinematics.space.division import Division, build_partition, divide
from mocap_id.kinematics.space.exchange import exchange_markers

_LENIENT = 0.9  # limit of joint residuals while landmarks may still be on the wrong side
_CLEAR = 1.5  # evidence above which a division is kept in any case
_COARSE = 4.0  # evidence above which a division is made first
_ROUNDS = 3


@dataclass(frozen=True)
class SpatialSearch:
    """Chain, if there is one, and the divisions that led to it."""

    chain: SpatialBodyChain | None  # None if there is no chain
    bodies: tuple[SpatialBody, ...]  # all rigid bodies
    made: tuple[Division, ...]  # accepted divisions
    refused: tuple[Division, ...]  # best division of every body that was not divided

    @property
    def carried(self) -> int:
        """Number of markers on the chain."""
        return 0 if self.chain is None else sum(len(body.markers) for body in self.chain.bodies)


def search_best_chain(sorter: SpatialBodies, rules: SegmentationRules) -> SpatialSearch:
    """Return the chain with most markers, with or without the weak divisions.

    Skin that was treated as a segment of its own is a branch. Without this division, its markers are on the chain.
    """
    best = found = search_chain(sorter, rules, 1.0)
    for _ in range(_ROUNDS):
        weakest = min((each.evidence for each in found.made), default=np.inf)
        if best.chain is None or not best.chain.branches or weakest > _CLEAR:
            break
        found = search_chain(sorter, rules, weakest * (1 + 1e-9))
        if found.carried > best.carried:
            best = found
    return best


def search_chain(sorter: SpatialBodies, rules: SegmentationRules, needed: float) -> SpatialSearch:
    """Return the longest chain of real joints among rigid bodies, with divisions of at least the evidence ``needed``.

    Landmarks on the wrong side of a joint distort the bodies on both sides. Therefore only clear divisions are made
    first. After the landmarks have moved, every body is tested for another division. At the end, bodies exchange
    markers.
    """
    start: tuple[SpatialBody, ...] = (sorter.body(sorter.markers),)
    made: list[Division] = []
    for clear in (True, *(False,) * _ROUNDS):
        found = divide(sorter, start, max(needed, _COARSE) if clear else needed)
        if not found.made and not clear:
            break
        made += found.made
        chain = find_chain(found, sorter.points, rules, _LENIENT)
        if chain is None:
            start = tuple(found.bodies)
            continue
        chain = give_landmarks_to_parents(chain, sorter)
        start = (*chain.bodies, *chain.branches)
    for least in (needed, np.inf) if made else ():
        start = exchange_markers(sorter, start)
        chain = find_chain(build_partition(start), sorter.points, rules, _LENIENT)
        if chain is not None:
            chain = give_landmarks_to_parents(chain, sorter)
            start = (*chain.bodies, *chain.branches)
        found = divide(sorter, start, least)
        if not found.made:
            break
        made += found.made
        start = tuple(found.bodies)
    return SpatialSearch(
        find_chain(found, sorter.points, rules), tuple(found.bodies), tuple(made), tuple(found.refused)
    )
