"""Readings of a recording: at every level of detail, the best chain from the base to a tip over real joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.bodies import Base, cluster, merge_rigid_pairs
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.joint import PairJoint, fit_joint
from mocap_id.kinematics.rigid import Body

FLOOR = 3e-4
"""No camera system resolves less (m), so fitting better than this is worth nothing."""

_APART = 0.2  # m; what lies wider apart on either side of its parent is two limbs
_MIDDLE = 0.03  # m; this near to the middle between two limbs lies what they hang on
_ASIDE = 0.05  # m; a limb is this far to one side of its parent
_SAME_PLACE = 0.15  # m; joints of a pair of limbs are this near to each other as seen from the side
_NEEDED = 1.2  # a segment between two others is real if leaving it out fits this much worse
_DEEPEST = 9  # segments with the base that the search goes through
_LEVELS = 12  # levels of detail that are tried


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
    """

    points: ComplexArray
    lateral: FloatArray
    base: Base
    ground: Body
    moving: IntArray
    rules: SegmentationRules
    constraints: Constraints


@dataclass(frozen=True)
class Hypothesis:
    """One reading of the recording: bodies in order from base to tip, and what it costs.

    ``cost`` is the summed log of the markers' predicted residuals plus ``split_gain`` a segment; lower is better.
    """

    level: int
    chain: tuple[Body, ...]
    joints: tuple[PairJoint, ...]
    left_out: tuple[Body, ...]
    cost: float


def hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    """A hypothesis for every level of detail that gives a chain not seen before."""
    rules = scene.rules
    known: set[tuple[tuple[int, ...], ...]] = set()
    for level in range(1, min(_LEVELS, len(scene.moving) // 2) + 1):
        bodies = cluster(scene.points, scene.moving, level, scene.constraints)
        if not all(scene.constraints.allow(body.markers) for body in bodies):
            continue
        bodies = merge_rigid_pairs(scene.points, bodies, rules.min_arc, rules.merge_tolerance, scene.constraints)
        best = _best_chain(scene, bodies)
        if best is None:
            continue
        chain, joints = best
        key = tuple(tuple(int(marker) for marker in body.markers) for body in chain)
        if key not in known:
            known.add(key)
            left_out = tuple(body for body in bodies if not any(body is link for link in chain))
            yield Hypothesis(level, chain, joints, left_out, _cost(scene, chain, joints))


def _best_chain(scene: Scene, bodies: list[Body]) -> tuple[tuple[Body, ...], tuple[PairJoint, ...]] | None:
    """The cheapest path from the base over real joints, by exhaustive search, cut where the chain may be no longer."""
    rules = scene.rules
    links = [scene.ground, *(body for body in bodies if body.residual <= rules.max_body_residual)]
    joints = {(i, j): fit_joint(links[i], links[j]) for i in range(len(links)) for j in range(1, len(links)) if i != j}
    real = {
        pair for pair, joint in joints.items() if joint.residual <= rules.max_residual and joint.arc >= rules.min_arc
    }
    real -= _paired(real, joints, np.array([np.nanmean(scene.lateral[body.markers]) for body in links]))
    real = {(i, j) for i, j in real if i == 0 or not _straddles(scene.lateral, links[j], links[i])}
    best: tuple[float, tuple[Body, ...], tuple[PairJoint, ...]] | None = None
    for path in _paths((0,), real, len(links), rules):
        if _skips_as_well(path, joints):
            continue
        chain = tuple(links[i] for i in path[1:])
        found = tuple(joints[pair] for pair in pairwise(path))
        cost = _cost(scene, chain, found)
        if best is None or cost < best[0]:
            best = cost, chain, found
    return None if best is None else (best[1][: rules.longest - 1], best[2][: rules.longest - 1])


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


def _cost(scene: Scene, chain: tuple[Body, ...], joints: tuple[PairJoint, ...]) -> float:
    """Summed log of the markers' residuals, as predicted through their joint; those left out cost their scatter."""
    floor = max(scene.base.noise, FLOOR)
    residual = np.maximum(scene.base.scatter, floor)
    for body, joint in zip(chain, joints, strict=True):
        residual[body.markers] = np.sqrt(body.residual**2 + joint.residual**2 + floor**2)
    return float(np.sum(np.log(residual[scene.moving]))) + scene.rules.split_gain * len(chain)
