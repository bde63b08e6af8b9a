"""Search for the chain among rigid bodies in space.

The bodies are divided and ordered from the body that moves least, over real joints, to the farthest tip. Landmarks near
a joint are assigned to the segment before it. Then the bodies are divided again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, islice, pairwise

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.hypotheses import SegmentationRules
from mocap_id.kinematics.space.bodies import (
    LEAST,
    NARROW,
    SpatialBodies,
    SpatialBody,
    SpatialPairJoint,
    fit_pair_joint,
    subtract_means,
)
from mocap_id.kinematics.space.division import Division, Partition, build_partition, divide, spanning_tree
from mocap_id.kinematics.space.exchange import exchange_markers

CHANCE = 0.65
"""Largest residual of a joint, relative to the motion of one body in the other without a joint."""

_NEAR_JOINT = 0.08  # m; largest distance of a joint's bony landmarks from its estimated centre
_AS_RIGID = 3.5  # largest ratio of a reassigned landmark's residuals on the segments before and after the joint
_MOST = 0.025  # m; largest residual of a reassigned landmark on the segment before the joint
_CHOICES = 20
_ROUNDS = 3
_LENIENT = 0.9  # limit of joint residuals while landmarks may still be on the wrong segment
_CLEAR = 1.5  # evidence above which a division is kept in any case
_COARSE = 4.0  # evidence above which a division is made first


@dataclass(frozen=True)
class SpatialBodyChain:
    """Bodies from base to tip, with their joints."""

    bodies: tuple[SpatialBody, ...]  # n + 1 bodies
    joints: tuple[SpatialPairJoint, ...]  # joint k - 1 connects bodies k - 1 (first) and k (second)
    branches: tuple[SpatialBody, ...]  # bodies that are not on the chain
    joined: tuple[bool, ...]  # for each branch, whether joints connect it with the chain


def find_chain(
    partition: Partition, points: FloatArray, rules: SegmentationRules, chance: float = CHANCE
) -> SpatialBodyChain | None:
    """Return the longest chain of real joints from the body that moves least; None if there is no real joint.

    Each connected group of bodies has its own base. Of equally long chains, the chain whose joints rotate most is
    chosen; the other arm of a person is then a branch. Trajectories (F, M, 3) are in the lab, m; ``chance`` is as for
    :func:`is_real`.
    """
    count = len(partition.bodies)
    near: dict[int, list[int]] = {body: [] for body in range(count)}
    for i, j in spanning_tree(partition.joints, count):
        if is_real(partition.joints[i, j], rules, chance):
            near[i].append(j)
            near[j].append(i)
    motion = [float(np.median(measure_scatter(points[:, body.markers]))) for body in partition.bodies]
    paths: list[list[int]] = []
    for group in _find_groups(near):
        root = min(group, key=lambda body: motion[body])
        paths += [path[: rules.longest] for path in _extend_path(near, [root])]

    def summed_arcs(path: list[int]) -> float:
        return sum(partition.joints[min(pair), max(pair)].arc for pair in pairwise(path))

    best = max(paths, key=lambda path: (len(path), summed_arcs(path)), default=[])
    if len(best) < 2:
        return None
    reached = next(group for group in _find_groups(near) if best[0] in group)
    rest = [body for body in range(count) if body not in best]
    bodies = tuple(partition.bodies[body] for body in best)
    return SpatialBodyChain(
        bodies,
        fit_joints_along(bodies),
        tuple(partition.bodies[body] for body in rest),
        tuple(body in reached for body in rest),
    )


def is_real(joint: SpatialPairJoint, rules: SegmentationRules, chance: float = CHANCE) -> bool:
    """Return whether two bodies rotate far enough about a common point.

    Bodies that hardly move also share a point. ``chance`` is therefore the largest residual of the joint, relative to
    the motion of one body in the other without a joint.
    """
    return joint.residual <= min(rules.max_residual, chance * joint.free) and joint.arc >= rules.min_arc


def fit_joints_along(bodies: Sequence[SpatialBody]) -> tuple[SpatialPairJoint, ...]:
    """Return the joints of consecutive bodies."""
    return tuple(fit_pair_joint(first, second) for first, second in pairwise(bodies))


def give_landmarks_to_parents(chain: SpatialBodyChain, sorter: SpatialBodies) -> SpatialBodyChain:
    """Return the chain with markers near a joint assigned to the segment before it, if they fit both segments.

    The motion of a marker near a joint's centre hardly determines its segment, because skin moves the marker more than
    the joint does. Bony landmarks there, such as epicondyles, malleoli and styloid processes, are ends of the segment
    before the joint.
    """
    bodies = list(chain.bodies)
    for _ in range(_ROUNDS):
        before = [body.markers for body in bodies]
        for k in range(1, len(bodies)):
            bodies[k - 1], bodies[k] = _give_landmarks(bodies[k - 1], bodies[k], sorter)
        if all(map(np.array_equal, before, [body.markers for body in bodies])):
            break
    return SpatialBodyChain(tuple(bodies), fit_joints_along(bodies), chain.branches, chain.joined)


def _give_landmarks(parent: SpatialBody, child: SpatialBody, sorter: SpatialBodies) -> tuple[SpatialBody, SpatialBody]:
    """Return two bodies after the landmarks near their joint that fit the parent are assigned to it."""
    joint = fit_pair_joint(parent, child)
    own = child.markers
    _, place, _ = subtract_means(child.local(sorter.points[:, own]))
    near = np.linalg.norm(place - joint.in_second, axis=1) <= _NEAR_JOINT
    near &= parent.residual[own] <= np.minimum(_AS_RIGID * child.residual[own], _MOST)
    for size in range(min(int(near.sum()), len(own) - LEAST), 0, -1):
        groups = islice(combinations(own[near].tolist(), size), _CHOICES)
        choices = [_move_markers(np.array(group), parent, child, sorter) for group in groups]
        possible = [choice for choice in choices if choice is not None]
        if possible:
            return min(possible, key=lambda bodies: bodies[1].rms_residual)
    return parent, child


def _move_markers(
    given: IntArray, parent: SpatialBody, child: SpatialBody, sorter: SpatialBodies
) -> tuple[SpatialBody, SpatialBody] | None:
    """Return two bodies after some markers are reassigned from the child to the parent; None if this is not allowed."""
    kept, taken = np.setdiff1d(child.markers, given), np.sort(np.concatenate([parent.markers, given]))
    constraints = sorter.constraints
    together = bool(np.isin(constraints.unit[given], constraints.unit[kept]).any())
    if together or not constraints.allow(taken) or sorter.body(kept).width < NARROW:
        return None
    return sorter.body(taken), sorter.body(kept)


def measure_scatter(points: FloatArray) -> FloatArray:
    """Return the rms distance (M,) of trajectories (F, M, 3) from their means, m; NaN if never visible."""
    off, _, counts = subtract_means(points)
    return np.where(counts > 0, np.sqrt(np.sum(off**2, axis=(0, 2)) / np.maximum(counts, 1)), np.nan)


def _find_groups(near: dict[int, list[int]]) -> list[set[int]]:
    """Return the connected groups of bodies."""
    groups: list[set[int]] = []
    for body in near:
        if any(body in group for group in groups):
            continue
        group, open_ends = {body}, [body]
        while open_ends:
            more = [other for other in near[open_ends.pop()] if other not in group]
            group.update(more)
            open_ends += more
        groups.append(group)
    return groups


def _extend_path(near: dict[int, list[int]], path: list[int]) -> list[list[int]]:
    """Return all paths that begin with ``path`` and continue to a tip."""
    onward = [body for body in near[path[-1]] if body not in path]
    if not onward:
        return [path]
    return [longer for body in onward for longer in _extend_path(near, [*path, body])]


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
    """Return the search whose chain has most markers, among searches with and without weak divisions.

    If skin is divided off as a separate body, this body is a branch. Without this division, its markers are on the
    chain.
    """
    best = search = search_chain(sorter, rules, 1.0)
    for _ in range(_ROUNDS):
        weakest = min((each.evidence for each in search.made), default=np.inf)
        if best.chain is None or not best.chain.branches or weakest > _CLEAR:
            break
        search = search_chain(sorter, rules, weakest * (1 + 1e-9))
        if search.carried > best.carried:
            best = search
    return best


def search_chain(sorter: SpatialBodies, rules: SegmentationRules, needed: float) -> SpatialSearch:
    """Return the longest chain of real joints among rigid bodies, with divisions of at least the evidence ``needed``.

    Landmarks on the wrong side of a joint distort the bodies on both sides. Therefore only clear divisions are made
    first. After the landmarks are reassigned, every body is tested for another division. At the end, bodies exchange
    markers.
    """
    start: tuple[SpatialBody, ...] = (sorter.body(sorter.markers),)
    made: list[Division] = []
    for clear in (True, *(False,) * _ROUNDS):
        partition = divide(sorter, start, max(needed, _COARSE) if clear else needed)
        if not partition.made and not clear:
            break
        made += partition.made
        chain = find_chain(partition, sorter.points, rules, _LENIENT)
        if chain is None:
            start = tuple(partition.bodies)
            continue
        chain = give_landmarks_to_parents(chain, sorter)
        start = (*chain.bodies, *chain.branches)
    for least in (needed, np.inf) if made else ():
        start = exchange_markers(sorter, start)
        chain = find_chain(build_partition(start), sorter.points, rules, _LENIENT)
        if chain is not None:
            chain = give_landmarks_to_parents(chain, sorter)
            start = (*chain.bodies, *chain.branches)
        partition = divide(sorter, start, least)
        if not partition.made:
            break
        made += partition.made
        start = tuple(partition.bodies)
    return SpatialSearch(
        find_chain(partition, sorter.points, rules), tuple(partition.bodies), tuple(made), tuple(partition.refused)
    )
