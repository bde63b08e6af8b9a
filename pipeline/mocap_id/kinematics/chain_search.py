"""Search for chains from the base to a tip over real joints, at every level (number of bodies).

A joint is real if its two bodies rotate far enough about a point that is fixed in both
(``SegmentationRules.is_joint``). The best chain of each number of segments is kept for the report. Only the best chain
of a level can be chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.hypotheses import FLOOR, Hypothesis, SegmentationProblem, SegmentationRules
from mocap_id.kinematics.joint import PairJoint
from mocap_id.kinematics.rigid_body import RigidBody

_APART = 0.2  # m; least distance between two limbs on either side of their parent
_MIDDLE = 0.03  # m; largest distance of their parent from the middle between two limbs
_ASIDE = 0.05  # m; least distance of a limb to one side of its parent
_SAME_PLACE = 0.15  # m; largest distance between the joints of a pair of limbs in the side view
_NEEDED = 1.2  # a segment is needed if the joint residual without it is larger by at least this factor
_DEEPEST = 9  # largest number of segments of a path, with the base
_LEVELS = 12  # largest number of bodies into which the markers are sorted


@dataclass(frozen=True)
class _Path:
    """Chain before it is shortened to the allowed length."""

    chain: tuple[RigidBody, ...]
    joints: tuple[PairJoint, ...]
    cost: float


def find_hypotheses(problem: SegmentationProblem) -> Iterator[Hypothesis]:
    """Yield the best chain of every level, then the best chains of all other lengths, each chain once."""
    known: set[tuple[tuple[int, ...], ...]] = set()
    sorted_before: set[tuple[tuple[int, ...], ...]] = set()
    others: list[Hypothesis] = []
    for level in range(1, min(_LEVELS, len(problem.moving) // 2) + 1):
        bodies = _find_bodies(problem, level)
        if _key(bodies) in sorted_before:
            continue
        sorted_before.add(_key(bodies))
        for hypothesis in _search_level(problem, level, bodies):
            if not hypothesis.best_of_level:
                others.append(hypothesis)
            elif _key(hypothesis.chain) not in known:
                known.add(_key(hypothesis.chain))
                yield hypothesis
    for other in others:
        if _key(other.chain) not in known:
            known.add(_key(other.chain))
            yield other


def _key(bodies: Sequence[RigidBody]) -> tuple[tuple[int, ...], ...]:
    """Return the columns of all bodies' markers, to compare chains."""
    return tuple(tuple(int(marker) for marker in body.markers) for body in bodies)


def _find_bodies(problem: SegmentationProblem, level: int) -> list[RigidBody]:
    """Return the bodies of a level, merged where one fits as well as two; no bodies if the constraints forbid one."""
    bodies = problem.clusters.bodies_at(level)
    if not all(problem.constraints.allow(body.markers) for body in bodies):
        return []
    return problem.clusters.merge(bodies, problem.rules.min_arc, problem.rules.merge_tolerance)


def _search_level(problem: SegmentationProblem, level: int, bodies: list[RigidBody]) -> Iterator[Hypothesis]:
    """Yield the best chain of a level, shortened if too long, then the best chain of every other allowed length."""
    rules = problem.rules
    paths = _best_chains(problem, bodies)
    if not paths:
        return
    longest = rules.longest - 1
    best = min(paths, key=lambda path: path.cost)
    first = _build_hypothesis(problem, level, bodies, _Path(best.chain[:longest], best.joints[:longest], best.cost))
    yield first
    for path in paths:
        if path is not best and len(path.chain) <= longest:
            yield _build_hypothesis(problem, level, bodies, path, first.cost - best.cost)


def _build_hypothesis(
    problem: SegmentationProblem, level: int, bodies: list[RigidBody], path: _Path, cut: float | None = None
) -> Hypothesis:
    """Return a path as a hypothesis, with the bodies that it leaves out.

    ``cut`` is added to its cost: the increase of the cost when the best path of the level was shortened. None marks
    this best path.
    """
    on_chain = np.concatenate([link.markers for link in path.chain])
    left_out = tuple(body for body in bodies if not np.isin(body.markers, on_chain).all())
    predicted = _predict_residuals(problem, path.chain, path.joints)
    cost = _cost(problem, predicted, len(path.chain)) + (cut or 0.0)
    return Hypothesis(level, path.chain, path.joints, left_out, predicted, cost, cut is None, cut or 0.0)


def _best_chains(problem: SegmentationProblem, bodies: list[RigidBody]) -> list[_Path]:
    """Return the path with the lowest cost, from the base over real joints, for each number of segments.

    All paths are tried.
    """
    rules = problem.rules
    links: list[RigidBody] = [problem.ground, *(body for body in bodies if body.residual <= rules.max_body_residual)]
    pairs = [(i, j) for i in range(len(links)) for j in range(1, len(links)) if i != j]
    joints = {(i, j): problem.clusters.joint(links[i], links[j]) for i, j in pairs}
    real = {pair for pair, joint in joints.items() if rules.is_joint(joint)}
    real -= _find_paired_limbs(real, joints, np.array([np.nanmean(problem.lateral[body.markers]) for body in links]))
    real = {(i, j) for i, j in real if i == 0 or not _is_pair_of_limbs(problem.lateral, links[j], links[i])}
    if rules.count is not None:
        for tip, below in list(merge_tips(links, real, problem.clusters.join, rules.max_residual)):
            joints |= {(k, len(links)): problem.clusters.joint(link, tip) for k, link in enumerate(links)}
            of_tip = {k for k in below if not _is_pair_of_limbs(problem.lateral, tip, links[k])}
            real |= {(k, len(links)) for k in of_tip if rules.is_joint(joints[k, len(links)])}
            links.append(tip)
    best: dict[int, _Path] = {}
    for path in _extend_path((0,), real, len(links), rules):
        chain = tuple(links[i] for i in path[1:])
        markers = np.concatenate([body.markers for body in chain])
        repeated = len(np.unique(markers)) < len(markers)  # a merged tip may contain a body of the chain
        triples = zip(path, path[1:], path[2:], strict=False)
        needless = any(joints[a, c].residual < _NEEDED * joints[a, b].residual for a, b, c in triples)
        if repeated or needless:
            continue
        path_joints = tuple(joints[pair] for pair in pairwise(path))
        cost = _cost(problem, _predict_residuals(problem, chain, path_joints), len(chain))
        if len(path) not in best or cost < best[len(path)].cost:
            best[len(path)] = _Path(chain, path_joints, cost)
    return list(best.values())


def _find_paired_limbs(
    real: set[tuple[int, int]], joints: dict[tuple[int, int], PairJoint], lateral: FloatArray
) -> set[tuple[int, int]]:
    """Return the joints to pairs of limbs, one on each side of a body; a serial chain cannot contain these joints."""
    aside = {(i, j): lateral[j] - lateral[i] for i, j in real}
    return {
        (i, j)
        for i, j in real
        for k in range(len(lateral))
        if (i, k) in real
        and min(abs(aside[i, j]), abs(aside[i, k])) > _ASIDE
        and aside[i, j] * aside[i, k] < 0
        and abs(joints[i, j].in_parent - joints[i, k].in_parent) < _SAME_PLACE
    }


def _is_pair_of_limbs(lateral: FloatArray, child: RigidBody, parent: RigidBody) -> bool:
    """Return whether a body consists of two limbs that move alike on both sides of their parent, such as arms.

    Two legs that move alike do not count, because their neighbours (feet, pelvis) also have markers on both sides.
    """
    across = np.sort(lateral[child.markers])
    between = int(np.argmax(np.diff(across)))
    low, high = across[between], across[between + 1]
    from_middle = np.abs(lateral[parent.markers] - (low + high) / 2)
    return bool(high - low > _APART and (from_middle < _MIDDLE).any())


def _extend_path(
    path: tuple[int, ...], real: set[tuple[int, int]], count: int, rules: SegmentationRules
) -> Iterator[tuple[int, ...]]:
    """Yield every path over real joints that begins with ``path``; only with ``rules.count`` segments if given."""
    if len(path) > 1 and rules.count in (None, len(path)):
        yield path
    if len(path) < (rules.count or _DEEPEST):
        for following in range(1, count):
            if following not in path and (path[-1], following) in real:
                yield from _extend_path((*path, following), real, count, rules)


def _predict_residuals(
    problem: SegmentationProblem, chain: tuple[RigidBody, ...], joints: tuple[PairJoint, ...]
) -> FloatArray:
    """Return the residuals (M,), m, of the chain's markers predicted through their joints; for others, the scatter."""
    floor = max(problem.base.noise, FLOOR)
    residual = np.maximum(problem.base.scatter, floor)
    for body, joint in zip(chain, joints, strict=True):
        residual[body.markers] = np.sqrt(body.residual**2 + joint.residual**2 + floor**2)
    return residual


def _cost(problem: SegmentationProblem, predicted: FloatArray, segments: int) -> float:
    """Return the cost of a chain: summed log residual of the moving markers, plus a penalty for each segment."""
    return float(np.sum(np.log(predicted[problem.moving]))) + problem.rules.split_gain * segments


def merge_tips(
    links: Sequence[RigidBody],
    real: set[tuple[int, int]],
    joined: Callable[[RigidBody, RigidBody], RigidBody | None],
    limit: float,
) -> Iterator[tuple[RigidBody, set[int]]]:
    """Yield, for every two bodies with a real joint between them, their merged body and the links below it.

    A chain with a given number of segments may end at a body that carries another one, such as a pelvis with a trunk.
    Without a merged tip, the markers of the other body would be on no segment, and a model based on the chain would add
    their mass to the pelvis. ``joined`` returns two bodies as one, or None if they may not be merged. ``limit`` is the
    largest residual of the merged body, m.
    """
    for i, j in sorted({(min(pair), max(pair)) for pair in real if 0 not in pair}):
        tip = joined(links[i], links[j])
        if tip is not None and tip.residual <= limit:
            yield tip, {below for below, above in real if above in {i, j}} - {i, j}
