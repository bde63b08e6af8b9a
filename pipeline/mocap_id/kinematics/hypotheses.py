"""Readings of a recording: at every level of detail, chains from the base to a tip over real joints.

The best chain of each number of segments is kept, so that one can read why the others lost; only the best of all the
chains of a level can win.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.bodies import Base, Clusters
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.joint import PairJoint
from mocap_id.kinematics.rigid import Body
from mocap_id.kinematics.tips import whole_tips

FLOOR = 3e-4
"""No camera system resolves less (m), so fitting better than this is worth nothing."""

_APART = 0.2  # m; what lies wider apart on either side of its parent is two limbs
_MIDDLE = 0.03  # m; this near to the middle between two limbs lies what they hang on
_ASIDE = 0.05  # m; a limb is this far to one side of its parent
_SAME_PLACE = 0.15  # m; joints of a pair of limbs are this near to each other as seen from the side
_NEEDED = 1.2  # a segment between two others is real if leaving it out fits this much worse
_DEEPEST = 9  # segments with the base that the search goes through
_LEVELS = 12  # levels of detail that are tried
_TOLD = 0.05  # a difference in cost below this is not told
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class SegmentationRules:
    """What counts as still, as turning and as a joint.

    Parameters
    ----------
    still_limit : float
        Largest scatter of a base marker, m.
    min_arc : float
        A joint turns by at least this, rad.
    max_residual : float
        The two bodies' points at a joint stay this close, rms, m.
    max_body_residual : float
        Markers of one body stay this close to their place on it, rms, m.
    merge_tolerance : float
        Two bodies that hardly turn are one where the merged residual stays under this multiple of their own.
    split_gain : float
        Gain in summed log residual that one more segment must bring.
    count : int or None
        Number of segments with the base, where it is known.
    longest : int
        Largest number of segments with the base; what a longer chain holds beyond is a branch and left out.
    """

    still_limit: float = 0.015
    min_arc: float = float(np.radians(6.0))
    max_residual: float = 0.05
    max_body_residual: float = 0.015
    merge_tolerance: float = 3.0
    split_gain: float = 4.0
    count: int | None = None
    longest: int = 6

    def is_joint(self, joint: PairJoint) -> bool:
        """Whether two bodies turn about each other: enough, and about a point that stays where it is."""
        return joint.residual <= self.max_residual and joint.arc >= self.min_arc


@dataclass(frozen=True)
class Scene:
    """What every hypothesis is about.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    lateral : (M,) array
        Mean out-of-plane coordinate of every marker, m.
    base : Base
        The still markers.
    ground : Body
        They as a body.
    moving : int array
        The markers that are not still.
    rules : SegmentationRules
    constraints : Constraints
    clusters : Clusters
        Of the moving markers.
    """

    points: ComplexArray
    lateral: FloatArray
    base: Base
    ground: Body
    moving: IntArray
    rules: SegmentationRules
    constraints: Constraints
    clusters: Clusters


@dataclass(frozen=True)
class Hypothesis:
    """One reading of the recording: bodies in order from base to tip, and what it costs.

    Parameters
    ----------
    level : int
        Level of detail: the number of bodies that were sought.
    chain : tuple of Body
        The moving segments.
    joints : tuple of PairJoint
        Each segment's joint with the one before.
    left_out : tuple of Body
        Bodies of the level that the chain does not hold.
    predicted : (M,) array
        Residual of every marker as predicted through its joint, its scatter where it is on no moving segment, m.
    cost : float
        Summed log of the moving markers' ``predicted`` plus ``split_gain`` a segment plus ``cut``; lower is better.
    best_of_level : bool
        Whether it is the best chain of its level, of whatever number of segments; the others cannot win.
    cut : float
        0 for the best of a level. For the others what the best lost where it was cut to the longest that is allowed:
        they lost to the whole of it.
    """

    level: int
    chain: tuple[Body, ...]
    joints: tuple[PairJoint, ...]
    left_out: tuple[Body, ...]
    predicted: FloatArray
    cost: float
    best_of_level: bool
    cut: float

    @property
    def markers(self) -> IntArray:
        """Columns of the markers on the moving segments, sorted."""
        return np.sort(np.concatenate([body.markers for body in self.chain]))

    def lost_to(self, best: Hypothesis) -> str:
        """Why the best one was chosen instead, in terms that add up to the difference in cost; ``chosen`` for itself.

        ``cost`` is a sum over markers, segments and ``cut``, so the difference parts into the markers that only the
        best carries, those that only this one carries, those on both, the number of segments and the cut.
        """
        if self is best:
            return "chosen"
        mine, its = self.markers, best.markers
        out, extra, both = np.setdiff1d(its, mine), np.setdiff1d(mine, its), np.intersect1d(mine, its)
        fit = self._worse(best, both)
        terms = {
            f"leaves out {_count(len(out), 'marker')} of the chosen segments": self._worse(best, out),
            f"carries {_count(len(extra), 'marker')} more": self._worse(best, extra),
            f"fits {'the others' if len(out) + len(extra) else 'the markers'} {'worse' if fit > 0 else 'better'}": fit,
            "lost to a longer chain that was cut afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain for each segment more or fewer
        return _account({f"has {_count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms})

    def _worse(self, best: Hypothesis, markers: IntArray) -> float:
        """Difference in the summed log residual of some markers."""
        return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))


def _account(terms: Mapping[str, float]) -> str:
    """A difference in cost, with what speaks against the dearer hypothesis and what for it, the gravest first."""
    told = sorted((each for each in terms.items() if abs(each[1]) >= _TOLD), key=lambda each: -abs(each[1]))
    against = ", ".join(f"{words} (+{value:.1f})" for words, value in told if value > 0)
    in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in told if value < 0)
    text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
    return f"{text}; but {in_favour}" if in_favour else text


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


@dataclass(frozen=True)
class _Path:
    """A chain as the search finds it, before it is cut."""

    chain: tuple[Body, ...]
    joints: tuple[PairJoint, ...]
    cost: float


def hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    """The best chain of every level of detail; then, of each level, the best of every other number of segments.

    No chain comes twice.
    """
    known: set[tuple[tuple[int, ...], ...]] = set()
    sorted_before: set[tuple[tuple[int, ...], ...]] = set()
    others: list[Hypothesis] = []
    for level in range(1, min(_LEVELS, len(scene.moving) // 2) + 1):
        bodies = _bodies(scene, level)
        if _key(bodies) in sorted_before:
            continue
        sorted_before.add(_key(bodies))
        for hypothesis in _of_level(scene, level, bodies):
            if not hypothesis.best_of_level:
                others.append(hypothesis)
            elif _key(hypothesis.chain) not in known:
                known.add(_key(hypothesis.chain))
                yield hypothesis
    for other in others:
        if _key(other.chain) not in known:
            known.add(_key(other.chain))
            yield other


def _key(bodies: Sequence[Body]) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(int(marker) for marker in body.markers) for body in bodies)


def _bodies(scene: Scene, level: int) -> list[Body]:
    """The rigid bodies of a level; none where they cannot be as the user wants them."""
    bodies = scene.clusters.at(level)
    if not all(scene.constraints.allow(body.markers) for body in bodies):
        return []
    return scene.clusters.merged(bodies, scene.rules.min_arc, scene.rules.merge_tolerance)


def _of_level(scene: Scene, level: int, bodies: list[Body]) -> Iterator[Hypothesis]:
    """The best chain of a level, cut where it may be no longer; then the best of each other length that is allowed."""
    rules = scene.rules
    found = _best_chains(scene, bodies)
    if not found:
        return
    longest = rules.longest - 1
    best = min(found, key=lambda path: path.cost)
    first = _hypothesis(scene, level, bodies, _Path(best.chain[:longest], best.joints[:longest], best.cost))
    yield first
    for path in found:
        if path is not best and len(path.chain) <= longest:
            yield _hypothesis(scene, level, bodies, path, first.cost - best.cost)


def _hypothesis(scene: Scene, level: int, bodies: list[Body], path: _Path, cut: float | None = None) -> Hypothesis:
    """A path with what it leaves out; the best of its level where nothing is said of a cut."""
    carried = np.concatenate([link.markers for link in path.chain])
    left_out = tuple(body for body in bodies if not np.isin(body.markers, carried).all())
    predicted = _predicted(scene, path.chain, path.joints)
    cost = _cost(scene, predicted, len(path.chain)) + (cut or 0.0)
    return Hypothesis(level, path.chain, path.joints, left_out, predicted, cost, cut is None, cut or 0.0)


def _best_chains(scene: Scene, bodies: list[Body]) -> list[_Path]:
    """The cheapest path from the base over real joints for each number of segments, by exhaustive search."""
    rules = scene.rules
    links: list[Body] = [scene.ground, *(body for body in bodies if body.residual <= rules.max_body_residual)]
    pairs = [(i, j) for i in range(len(links)) for j in range(1, len(links)) if i != j]
    joints = {(i, j): scene.clusters.joint(links[i], links[j]) for i, j in pairs}
    real = {pair for pair, joint in joints.items() if rules.is_joint(joint)}
    real -= _paired(real, joints, np.array([np.nanmean(scene.lateral[body.markers]) for body in links]))
    real = {(i, j) for i, j in real if i == 0 or not _straddles(scene.lateral, links[j], links[i])}
    if rules.count is not None:
        for tip, below in list(whole_tips(links, real, scene.clusters.joined, rules.max_residual)):
            joints |= {(k, len(links)): scene.clusters.joint(link, tip) for k, link in enumerate(links)}
            of_tip = {k for k in below if not _straddles(scene.lateral, tip, links[k])}
            real |= {(k, len(links)) for k in of_tip if rules.is_joint(joints[k, len(links)])}
            links.append(tip)
    best: dict[int, _Path] = {}
    for path in _paths((0,), real, len(links), rules):
        chain = tuple(links[i] for i in path[1:])
        if not _disjoint(chain) or _skips_as_well(path, joints):
            continue
        found = tuple(joints[pair] for pair in pairwise(path))
        cost = _cost(scene, _predicted(scene, chain, found), len(chain))
        if len(path) not in best or cost < best[len(path)].cost:
            best[len(path)] = _Path(chain, found, cost)
    return list(best.values())


def _disjoint(chain: tuple[Body, ...]) -> bool:
    """Whether no marker is on two segments: a last segment may be two bodies of which the chain holds one already."""
    markers = np.concatenate([body.markers for body in chain])
    return len(np.unique(markers)) == len(markers)


def _skips_as_well(path: tuple[int, ...], joints: dict[tuple[int, int], PairJoint]) -> bool:
    """Whether some segment of the path could be left out at little cost: then it is not between its neighbours."""
    triples = zip(path, path[1:], path[2:], strict=False)
    return any(joints[a, c].residual < _NEEDED * joints[a, b].residual for a, b, c in triples)


def _paired(
    real: set[tuple[int, int]], joints: dict[tuple[int, int], PairJoint], lateral: FloatArray
) -> set[tuple[int, int]]:
    """Joints to one of two limbs on either side of the same place: a serial chain cannot go on through one of them."""
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


def _straddles(lateral: FloatArray, child: Body, parent: Body) -> bool:
    """Whether a body is two limbs that move alike, on either side of a parent between them: arms on a trunk.

    Legs are no such limbs: what they stand on and hang from is as two-sided as they are, up to the pelvis.
    """
    across = np.sort(lateral[child.markers])
    between = int(np.argmax(np.diff(across)))
    low, high = across[between], across[between + 1]
    from_middle = np.abs(lateral[parent.markers] - (low + high) / 2)
    return bool(high - low > _APART and (from_middle < _MIDDLE).any())


def _paths(
    path: tuple[int, ...], real: set[tuple[int, int]], count: int, rules: SegmentationRules
) -> Iterator[tuple[int, ...]]:
    """Every path from the base over real joints, of the number of segments asked for."""
    if len(path) > 1 and rules.count in (None, len(path)):
        yield path
    if len(path) < (rules.count or _DEEPEST):
        for following in range(1, count):
            if following not in path and (path[-1], following) in real:
                yield from _paths((*path, following), real, count, rules)


def _predicted(scene: Scene, chain: tuple[Body, ...], joints: tuple[PairJoint, ...]) -> FloatArray:
    """(M,) residuals of the markers as predicted through their joint, m; those left out keep their scatter."""
    floor = max(scene.base.noise, FLOOR)
    residual = np.maximum(scene.base.scatter, floor)
    for body, joint in zip(chain, joints, strict=True):
        residual[body.markers] = np.sqrt(body.residual**2 + joint.residual**2 + floor**2)
    return residual


def _cost(scene: Scene, predicted: FloatArray, segments: int) -> float:
    """Summed log of the moving markers' residuals, and the price of the segments."""
    return float(np.sum(np.log(predicted[scene.moving]))) + scene.rules.split_gain * segments
