"""Hypotheses of a segmentation, and the search for chains from the base to a tip at every number of bodies.

A joint is real if its two bodies rotate far enough about a point that is fixed in both
(``SegmentationRules.is_joint``). The best chain of each number of segments is kept for the report. Only the best chain
of a level can be chosen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.clusters import Base, Constraints, MarkerClusters
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
    clusters: MarkerClusters  # rigid bodies of the moving markers


@dataclass(frozen=True)
class Hypothesis:
    """One segmentation of the recording: bodies in order from base to tip, and its cost."""

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
        on both, the number of segments, and the shortening of the chain. First come the terms that raise the cost.
        """
        if self is best:
            return "chosen"

        def compare(markers: IntArray) -> float:
            """Return the summed log residual of some markers, minus the same sum in the best hypothesis."""
            return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))

        def count(number: int, what: str) -> str:
            return f"{number} {what}" if number == 1 else f"{number} {what}s"

        own, other = self.markers, best.markers
        out, extra = np.setdiff1d(other, own), np.setdiff1d(own, other)
        fit = compare(np.intersect1d(own, other))
        terms = {
            f"leaves out {count(len(out), 'marker')} of the chosen segments": compare(out),
            f"includes {count(len(extra), 'marker')} more": compare(extra),
            f"fits {'the other' if len(out) + len(extra) else 'the'} markers {'worse' if fit > 0 else 'better'}": fit,
            "a longer chain was better, and was shortened afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain times the difference in the number of segments
        terms = {f"has {count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms}
        reported = sorted((each for each in terms.items() if abs(each[1]) >= _REPORTED), key=lambda each: -abs(each[1]))
        against = ", ".join(f"{words} (+{value:.1f})" for words, value in reported if value > 0)
        in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in reported if value < 0)
        text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
        return f"{text}; but {in_favour}" if in_favour else text


_APART = 0.2  # m; least distance between two limbs on either side of their parent
_MIDDLE = 0.03  # m; largest distance of their parent from the middle between two limbs
_ASIDE = 0.05  # m; least distance of a limb to one side of its parent
_SAME_PLACE = 0.15  # m; largest distance between the joints of a pair of limbs in the side view
_NEEDED = 1.2  # a segment is needed if the joint residual without it is larger by at least this factor
_DEEPEST = 9  # largest number of segments of a path, with the base
_LEVELS = 12  # largest number of bodies into which the markers are sorted


def find_hypotheses(problem: SegmentationProblem) -> Iterator[Hypothesis]:
    """Yield the best chain of every level, then the best chains of all other lengths, each chain once."""

    def key(bodies: Sequence[RigidBody]) -> tuple[tuple[int, ...], ...]:
        """Return the columns of all bodies' markers, to compare chains."""
        return tuple(tuple(int(marker) for marker in body.markers) for body in bodies)

    known: set[tuple[tuple[int, ...], ...]] = set()
    sorted_before: set[tuple[tuple[int, ...], ...]] = set()
    others: list[Hypothesis] = []
    for level in range(1, min(_LEVELS, len(problem.moving) // 2) + 1):
        # bodies are merged where one fits as well as two; there are none if the constraints forbid one
        bodies = problem.clusters.bodies_at(level)
        allowed = all(problem.constraints.allow(body.markers) for body in bodies)
        bodies = problem.clusters.merge(bodies, problem.rules.min_arc, problem.rules.merge_tolerance) if allowed else []
        if key(bodies) in sorted_before:
            continue
        sorted_before.add(key(bodies))
        for hypothesis in _search_level(problem, bodies):
            if not hypothesis.best_of_level:
                others.append(hypothesis)
            elif key(hypothesis.chain) not in known:
                known.add(key(hypothesis.chain))
                yield hypothesis
    for other in others:
        if key(other.chain) not in known:
            known.add(key(other.chain))
            yield other


_Path: TypeAlias = tuple[float, tuple[RigidBody, ...], tuple[PairJoint, ...]]  # cost, segments and joints


def _search_level(problem: SegmentationProblem, bodies: list[RigidBody]) -> Iterator[Hypothesis]:
    """Yield the best chain of a level, shortened if too long, then the best chain of every other allowed length."""
    paths = _best_chains(problem, bodies)
    best = min(paths, key=lambda path: path[0], default=None)
    if best is None:
        return
    longest, cut = problem.rules.longest - 1, 0.0
    for path in (best, *(path for path in paths if path is not best and len(path[1]) <= longest)):
        chain, joints = path[1][:longest], path[2][:longest]
        on_chain = np.concatenate([link.markers for link in chain])
        left_out = tuple(body for body in bodies if not np.isin(body.markers, on_chain).all())
        predicted, cost = _rate_chain(problem, chain, joints)
        if path is best:
            yield Hypothesis(chain, joints, left_out, predicted, cost, best_of_level=True, cut=0.0)
            cut = cost - best[0]
        else:
            yield Hypothesis(chain, joints, left_out, predicted, cost + cut, best_of_level=False, cut=cut)


def _best_chains(problem: SegmentationProblem, bodies: list[RigidBody]) -> list[_Path]:
    """Return the path with the lowest cost, from the base over real joints, for each number of segments.

    All paths are tried.
    """
    rules, clusters, lateral = problem.rules, problem.clusters, problem.lateral
    links: list[RigidBody] = [problem.ground, *(body for body in bodies if body.residual <= rules.max_body_residual)]
    pairs = [(i, j) for i in range(len(links)) for j in range(1, len(links)) if i != j]
    joints = {(i, j): clusters.joint(links[i], links[j]) for i, j in pairs}
    real = {pair for pair, joint in joints.items() if rules.is_joint(joint)}
    # a serial chain contains no joints to pairs of limbs, one on each side of a body, and no joints from such a pair
    side = np.array([np.nanmean(lateral[body.markers]) for body in links])
    aside = {(i, j): side[j] - side[i] for i, j in real}
    real -= {
        (i, j)
        for i, j in real
        for k in range(len(links))
        if (i, k) in real
        and min(abs(aside[i, j]), abs(aside[i, k])) > _ASIDE
        and aside[i, j] * aside[i, k] < 0
        and abs(joints[i, j].in_parent - joints[i, k].in_parent) < _SAME_PLACE
    }
    real = {(i, j) for i, j in real if i == 0 or not _is_pair_of_limbs(lateral, links[j], links[i])}
    if rules.count is not None:
        # A chain with a given number of segments may end at a body that carries another one, such as a pelvis with a
        # trunk: the two bodies with a joint between them are merged to a tip. Else the markers of the other body would
        # be on no segment, and a model based on the chain would add their mass to the pelvis.
        for i, j in sorted({(min(pair), max(pair)) for pair in real if 0 not in pair}):
            tip = clusters.join(links[i], links[j])
            if tip is None or tip.residual > rules.max_residual:
                continue
            new = len(links)
            joints |= {(k, new): clusters.joint(link, tip) for k, link in enumerate(links)}
            below = {k for k, above in real if above in {i, j}} - {i, j}
            of_tip = {k for k in below if not _is_pair_of_limbs(lateral, tip, links[k])}
            real |= {(k, new) for k in of_tip if rules.is_joint(joints[k, new])}
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
        _, cost = _rate_chain(problem, chain, path_joints)
        if len(path) not in best or cost < best[len(path)][0]:
            best[len(path)] = cost, chain, path_joints
    return list(best.values())


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


def _rate_chain(
    problem: SegmentationProblem, chain: tuple[RigidBody, ...], joints: tuple[PairJoint, ...]
) -> tuple[FloatArray, float]:
    """Return the residuals (M,), m, of the chain's markers predicted through their joints, and the cost of the chain.

    For other markers, the residual is the scatter. The cost is the summed log residual of the moving markers, plus a
    penalty for each segment.
    """
    floor = max(problem.base.noise, FLOOR)
    residual = np.maximum(problem.base.scatter, floor)
    for body, joint in zip(chain, joints, strict=True):
        residual[body.markers] = np.sqrt(body.residual**2 + joint.residual**2 + floor**2)
    return residual, float(np.sum(np.log(residual[problem.moving]))) + problem.rules.split_gain * len(chain)
