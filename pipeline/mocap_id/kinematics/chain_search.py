"""Hypotheses of a segmentation, and the search for chains from the base to a tip at every number of bodies.

A joint is real if its two bodies rotate far enough about a point that is fixed in both
(``SegmentationRules.is_joint``). The best chain of each number of segments is kept for the report. Only the best chain
of a level can be chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.clusters import Base, Clusters, Constraints
from mocap_id.kinematics.joint import PairJoint, RigidBody

FLOOR = 3e-4
"""Resolution of camera systems, m; smaller residuals do not reduce a cost."""

_REPORTED = 0.05  # smaller differences in cost are not reported
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class SegmentationRules:
    """Limits that define a still marker, a joint and a rigid body."""

    still_limit: float = 0.015  # largest scatter of a base marker, m
    min_arc: float = float(np.radians(6.0))  # smallest arc of a joint, rad
    max_residual: float = 0.05  # largest rms distance between the two bodies' points at a joint, m
    max_body_residual: float = 0.015  # largest rms distance of a body's markers from their positions on it, m
    merge_tolerance: float = 3.0  # largest growth of the residual when bodies that hardly rotate are merged
    split_gain: float = 4.0  # least gain in summed log residual for one more segment
    count: int | None = None  # number of segments with the base, if known
    longest: int = 6  # largest number of segments with the base; the rest of a longer chain is left out as a branch

    def is_joint(self, joint: PairJoint) -> bool:
        """Return whether two bodies rotate far enough about a point that is fixed in both."""
        return joint.residual <= self.max_residual and joint.arc >= self.min_arc


@dataclass(frozen=True)
class SegmentationProblem:
    """Input of every hypothesis: markers, base, rules and constraints."""

    points: ComplexArray  # (F, M) trajectories in the plane, m; NaN where missing
    lateral: FloatArray  # (M,) mean out-of-plane coordinate, m
    base: Base  # still markers
    ground: RigidBody  # base as a rigid body
    moving: IntArray  # columns of the moving markers
    rules: SegmentationRules
    constraints: Constraints
    clusters: Clusters  # rigid bodies of the moving markers


@dataclass(frozen=True)
class Hypothesis:
    """One segmentation of the recording: bodies in order from base to tip, and its cost."""

    level: int  # level of detail: number of bodies requested from the clustering
    chain: tuple[RigidBody, ...]  # moving segments
    joints: tuple[PairJoint, ...]  # joint of each segment with the previous one
    left_out: tuple[RigidBody, ...]  # bodies of the level that are not on the chain
    predicted: FloatArray  # (M,) residual predicted through the joint, m; scatter of markers on no moving segment
    cost: float  # summed log of ``predicted`` + ``split_gain`` for each segment + ``cut``; lower is better
    best_of_level: bool  # whether this is the best chain of its level; only these can be chosen
    cut: float  # increase of the cost when the best chain of the level was shortened to the allowed length

    @property
    def markers(self) -> IntArray:
        """Columns of the markers on the moving segments, sorted."""
        return np.sort(np.concatenate([body.markers for body in self.chain]))

    def explain_cost(self, best: Hypothesis) -> str:
        """Return in words why the best hypothesis was chosen instead; ``chosen`` for the best one itself.

        The terms add up to the difference in cost: markers only on the best chain, markers only on this chain, markers
        on both, the number of segments, and the shortening of the chain.
        """
        if self is best:
            return "chosen"
        own, other = self.markers, best.markers
        out, extra, both = np.setdiff1d(other, own), np.setdiff1d(own, other), np.intersect1d(own, other)
        fit = self._compare_residuals(best, both)
        terms = {
            f"leaves out {_format_count(len(out), 'marker')} of the chosen segments": self._compare_residuals(
                best, out
            ),
            f"includes {_format_count(len(extra), 'marker')} more": self._compare_residuals(best, extra),
            f"fits {'the other' if len(out) + len(extra) else 'the'} markers {'worse' if fit > 0 else 'better'}": fit,
            "a longer chain was better, and was shortened afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain times the difference in the number of segments
        return _describe_cost(
            {f"has {_format_count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms}
        )

    def _compare_residuals(self, best: Hypothesis, markers: IntArray) -> float:
        """Return the summed log residual of some markers, minus the same sum in the best hypothesis."""
        return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))


def _describe_cost(terms: Mapping[str, float]) -> str:
    """Return a difference in cost in words: first the terms that raise it, then the terms that reduce it."""
    reported = sorted((each for each in terms.items() if abs(each[1]) >= _REPORTED), key=lambda each: -abs(each[1]))
    against = ", ".join(f"{words} (+{value:.1f})" for words, value in reported if value > 0)
    in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in reported if value < 0)
    text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
    return f"{text}; but {in_favour}" if in_favour else text


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


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
