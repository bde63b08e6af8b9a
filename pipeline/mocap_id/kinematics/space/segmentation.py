"""Number, order and markers of the segments of a chain in space, from the motion alone.

The markers are divided into rigid bodies (:mod:`.bodies`). The bodies are ordered along real joints, from the body
that moves least (:func:`search_chain`). Leftover markers are assigned to the segment that fits them best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice, pairwise

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.geometry import so3
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.segmentation import Confidence, log_shortfall, weigh_evidence
from mocap_id.kinematics.space.bodies import (
    LEAST,
    NARROW,
    Division,
    SpatialBodies,
    SpatialBody,
    SpatialPairJoint,
    distance_deviation,
    divide,
    exchange_markers,
    mean_rotation,
    spanning_tree,
    subtract_means,
)

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


def find_chain(
    sorter: SpatialBodies, bodies: Sequence[SpatialBody], rules: SegmentationRules, chance: float = CHANCE
) -> tuple[list[SpatialBody], list[SpatialBody], list[bool]]:
    """Return the longest chain of real joints from the body that moves least; empty if there is no real joint.

    The further results are the branches, which are all other bodies, and whether joints connect each with the chain.

    At a real joint, two bodies rotate far enough about a common point. Bodies that hardly move also share a point.
    ``chance`` is therefore the largest residual of the joint, relative to the motion of one body in the other without
    a joint. Each connected group of bodies has its own base. Of equally long chains, the chain whose joints rotate most
    is chosen; the other arm of a person is then a branch.
    """
    joints, count = sorter.joints(bodies), len(bodies)
    near: dict[int, list[int]] = {body: [] for body in range(count)}
    for i, j in spanning_tree(joints, count):
        joint = joints[i, j]
        if joint.residual <= min(rules.max_residual, chance * joint.free) and joint.arc >= rules.min_arc:
            near[i].append(j)
            near[j].append(i)
    groups: list[set[int]] = []  # connected bodies
    for body in near:
        if any(body in group for group in groups):
            continue
        group, open_ends = {body}, [body]
        while open_ends:
            more = [other for other in near[open_ends.pop()] if other not in group]
            group.update(more)
            open_ends += more
        groups.append(group)
    motion = [float(np.median(measure_scatter(sorter.points[:, body.markers]))) for body in bodies]

    def extend(path: list[int]) -> list[list[int]]:
        """Return all paths that begin with ``path`` and continue to a tip."""
        onward = [body for body in near[path[-1]] if body not in path]
        return [longer for body in onward for longer in extend([*path, body])] if onward else [path]

    def summed_arcs(path: list[int]) -> float:
        return sum(joints[min(pair), max(pair)].arc for pair in pairwise(path))

    roots = [min(group, key=lambda body: motion[body]) for group in groups]
    paths = [path[: rules.longest] for root in roots for path in extend([root])]
    best = max(paths, key=lambda path: (len(path), summed_arcs(path)), default=[])
    if len(best) < 2:
        return [], [], []
    reached = next(group for group in groups if best[0] in group)
    rest = [body for body in range(count) if body not in best]
    return [bodies[body] for body in best], [bodies[body] for body in rest], [body in reached for body in rest]


def give_landmarks_to_parents(bodies: Sequence[SpatialBody], sorter: SpatialBodies) -> list[SpatialBody]:
    """Return the bodies of a chain with markers near a joint assigned to the segment before it, if they fit both.

    The motion of a marker near a joint's centre hardly determines its segment, because skin moves the marker more than
    the joint does. Bony landmarks there, such as epicondyles, malleoli and styloid processes, are ends of the segment
    before the joint.
    """
    bodies, constraints = list(bodies), sorter.constraints
    for _ in range(_ROUNDS):
        before = [body.markers for body in bodies]
        for k in range(1, len(bodies)):
            parent, child = bodies[k - 1 : k + 1]
            own = child.markers
            _, place, _ = subtract_means(child.local(sorter.points[:, own]))
            near = np.linalg.norm(place - sorter.joint(parent, child).in_second, axis=1) <= _NEAR_JOINT
            near &= parent.residual[own] <= np.minimum(_AS_RIGID * child.residual[own], _MOST)
            for size in range(min(int(near.sum()), len(own) - LEAST), 0, -1):
                possible = []
                for group in islice(combinations(own[near].tolist(), size), _CHOICES):
                    given = np.array(group)
                    kept, taken = np.setdiff1d(own, given), np.sort(np.concatenate([parent.markers, given]))
                    together = bool(np.isin(constraints.unit[given], constraints.unit[kept]).any())
                    if not together and constraints.allow(taken) and sorter.body(kept).width >= NARROW:
                        possible.append((sorter.body(taken), sorter.body(kept)))
                if possible:
                    bodies[k - 1], bodies[k] = min(possible, key=lambda pair: pair[1].rms_residual)
                    break
        if all(map(np.array_equal, before, [body.markers for body in bodies])):
            break
    return bodies


def measure_scatter(points: FloatArray) -> FloatArray:
    """Return the rms distance (M,) of trajectories (F, M, 3) from their means, m; NaN if never visible."""
    off, _, counts = subtract_means(points)
    return np.where(counts > 0, np.sqrt(np.sum(off**2, axis=(0, 2)) / np.maximum(counts, 1)), np.nan)


@dataclass(frozen=True)
class SpatialSearch:
    """Chain, if there is one, and the divisions that led to it."""

    chain: Sequence[SpatialBody]  # bodies from base to tip; empty if there is no chain
    branches: Sequence[SpatialBody]  # bodies that are not on the chain
    joined: Sequence[bool]  # for each branch, whether joints connect it with the chain
    bodies: Sequence[SpatialBody]  # all rigid bodies
    made: Sequence[Division]  # accepted divisions
    refused: Sequence[Division]  # best division of every body that was not divided


def search_chain(sorter: SpatialBodies, rules: SegmentationRules, needed: float) -> SpatialSearch:
    """Return the longest chain of real joints among rigid bodies, with divisions of at least the evidence ``needed``.

    Landmarks on the wrong side of a joint distort the bodies on both sides. Therefore only clear divisions are made
    first. After the landmarks are reassigned, every body is tested for another division. At the end, bodies exchange
    markers.
    """

    def reassign_landmarks(bodies: Sequence[SpatialBody]) -> list[SpatialBody]:
        chain, branches, _ = find_chain(sorter, bodies, rules, _LENIENT)
        return [*give_landmarks_to_parents(chain, sorter), *branches] if chain else list(bodies)

    start = [sorter.body(sorter.markers)]
    made: list[Division] = []
    for clear in (True, *(False,) * _ROUNDS):
        bodies, new, refused = divide(sorter, start, max(needed, _COARSE) if clear else needed)
        if not new and not clear:
            break
        made += new
        start = reassign_landmarks(bodies)
    for least in (needed, np.inf) if made else ():
        start = reassign_landmarks(exchange_markers(sorter, start))
        bodies, new, refused = divide(sorter, start, least)
        if not new:
            break
        made += new
        start = bodies
    return SpatialSearch(*find_chain(sorter, bodies, rules), bodies, made, refused)


_BEST = 3.3  # log odds without evidence against the segments
_ONE_JOINT = 5.0  # largest reduction of the log odds
_SURE_DIVISION = 1.5  # evidence of the weakest division
_SURE_WHOLE = 0.85  # evidence for dividing a body that was not divided
_SURE_TIP = 0.45  # the same for the last body
_SURE_JOINT = 2.0  # ratio of the motion without a joint to the joint's residual
_SURE_BODY = 0.014  # m; residual of the markers of a segment
_SURE_BASE = 2.0  # ratio of the motions of tip and base
_SURE_SECOND = float(np.radians(16.0))  # arc of the second independent rotation of the joints


def assess_spatial_confidence(
    bodies: Sequence[SpatialBody],
    joints: Sequence[SpatialPairJoint],
    search: SpatialSearch,
    *,
    motion: float,
    left_out: float,
) -> Confidence:
    """Return the confidence in a chain of rigid bodies in space.

    Evidence against the segments:

    - ``weakest``: two of the segments could nearly be one;
    - ``runner-up``: one of the segments could nearly be two;
    - ``hidden-tip``: the last segment may be two segments that hardly move relative to each other;
    - ``joint``: two neighbours hardly share a point;
    - ``base``: both ends of the chain move about equally far (``motion`` is that of the tip, divided by the base's);
    - ``not-rigid``: the markers of a segment move relative to each other;
    - ``left-out``: the fraction ``left_out`` of the markers is on no segment and on no branch of the chain;
    - ``one-joint``: all joints rotate as one, so that segments without relative motion in this trial may be merged.

    The confidence in a joint is 0.5 if its residual is half of the motion without the joint.
    """
    # the rotation vectors of all joints are split into independent time courses (principal components); the arc of the
    # second one is 4 standard deviations, rad, and 0 for one joint
    second_arc = 0.0
    turns = [np.swapaxes(a.rotation, 1, 2) @ b.rotation for a, b in pairwise(bodies)]
    together = np.isfinite(np.stack([turn[:, 0, 0] for turn in turns])).all(axis=0)
    if len(bodies) > 2 and together.sum() >= LEAST:
        vectors = [so3.log(mean_rotation(turn[together]).T @ turn[together]) for turn in turns]
        values = np.linalg.eigvalsh(np.cov(np.concatenate(vectors, axis=1).T))
        second_arc = float(4 * np.sqrt(max(values[-2], 0.0)))
    tip = bodies[-1].markers
    hidden = [each.evidence for each in search.refused if np.array_equal(each.whole.markers, tip)]
    whole = [each.evidence for each in search.refused if not np.array_equal(each.whole.markers, tip)]
    ratios = [joint.ratio for joint in joints]
    against = {
        "weakest": 12 * log_shortfall(min((each.evidence for each in search.made), default=np.inf), _SURE_DIVISION),
        "runner-up": 6 * log_shortfall(_SURE_WHOLE, max(whole, default=0.0)),
        "hidden-tip": 10 * log_shortfall(_SURE_TIP, max(hidden, default=0.0)),
        "joint": 4 * log_shortfall(min(ratios), _SURE_JOINT),
        "base": 3 * log_shortfall(motion, _SURE_BASE),
        "not-rigid": 8 * log_shortfall(_SURE_BODY, max(body.rms_residual for body in bodies)),
        "left-out": 30 * log_shortfall(1 - left_out, 1.0),
        "one-joint": min(10 * log_shortfall(second_arc, _SURE_SECOND), _ONE_JOINT),
    }
    return weigh_evidence(_BEST, tuple(ratio / (ratio + _SURE_JOINT) for ratio in ratios), against)


_SEARCH_FRAMES = 120
_STEPS = 60  # rotations are compared over 1/60 of the frames, to reduce the effect of noise
_SEEN = 0.05  # least fraction of the frames in which a marker is visible
_RIGID = 3e-3  # m; least standard deviation of a distance if a joint moves
_PARTNER = 1.5  # largest standard deviation of a distance within a body, relative to the largest body residual
_FOREIGN = 6.0  # largest residual of a marker on its segment, relative to the median residual there
_COUNT_ROUNDS = 4  # searches for a chain with the requested number of segments


@dataclass(frozen=True)
class SpatialSegmentation:
    """Markers sorted into the segments of a chain in space."""

    segment: IntArray  # (M,) 0 = base, 1 … n from base to tip, -1 = none
    residual: FloatArray  # (M,) rms distance of each marker from its position on its segment, m; NaN for none
    reasons: tuple[str, ...]  # reason for the assignment of each marker
    count: int  # number of segments with the base
    confidence: Confidence
    joints: tuple[SpatialPairJoint, ...]  # joint k - 1 connects segments k - 1 and k
    moving_base: bool  # whether the base moves in the lab
    planarity: float  # fraction of the rotation that is not about one axis; 0 if planar, 2/3 for equal rotations
    # divisions into two bodies, the largest gain first, and whether they were made
    divisions: tuple[tuple[Division, bool], ...] = field(repr=False)
    branches: tuple[IntArray, ...] = field(default=(), repr=False)  # columns of the bodies that were left out


def segment_in_space(
    points: FloatArray,
    rules: SegmentationRules | None = None,
    constraints: Constraints | None = None,
    frames: int = 400,
) -> SpatialSegmentation:
    """Sort markers into the segments of a chain in space, whose base may move.

    The trajectories ``points`` (F, M, 3) are in the lab, m; NaN where missing, and for markers that the user ignores.
    Of the rules, only ``min_arc``, ``max_residual``, ``max_body_residual``, ``still_limit`` (of a base that does not
    move), ``count`` and ``longest`` are used. At most ``frames`` frames are used, chosen along the motion.

    Raises
    ------
    Refused
        ``no-motion`` or ``no-chain``.
    """
    rules = rules or SegmentationRules()
    constraints = constraints or Constraints.of(points.shape[1])
    points = points[frames_along_motion(points, frames)]
    seen = np.isfinite(points[..., 0]).sum(axis=0) >= max(LEAST, _SEEN * len(points))
    deviation = np.full((len(seen), len(seen)), np.inf)
    deviation[np.ix_(seen, seen)] = distance_deviation(points[:, seen])
    partners = np.sum(deviation <= _PARTNER * rules.max_body_residual, axis=1) - 1
    markers = np.flatnonzero(seen & (partners >= LEAST - 1))
    largest = float(deviation[np.ix_(seen, seen)].max(initial=0.0))
    if largest < _RIGID and len(markers):
        raise Refused(
            "no-motion",
            f"no joint moves: all distances between markers stay constant within {1e3 * largest:.1f} mm rms (at a "
            f"joint, some change by more than {1e3 * _RIGID:.0f} mm). Record a movement of the joints.",
            largest,
            _RIGID,
        )
    if len(markers) < 2 * LEAST:
        raise Refused(
            "no-chain",
            f"{len(markers)} of {int(seen.sum())} markers move rigidly with two others, but two segments in space need "
            f"at least {2 * LEAST} markers, three each. Add markers, so that each segment has three.",
            float(len(markers)),
            float(2 * LEAST),
        )
    searched = points[frames_along_motion(points, min(frames, _SEARCH_FRAMES))]
    search = _search_with_count(SpatialBodies(searched, markers, constraints), rules)

    # the bodies are fitted to all chosen frames
    sorter = SpatialBodies(points, np.flatnonzero(seen), constraints)
    bodies = [sorter.body(body.markers) for body in search.chain]
    joints = tuple(sorter.joint(first, second) for first, second in pairwise(bodies))
    residuals = np.stack([body.residual for body in bodies])
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(bodies):
        segment[body.markers] = k

    # outliers are removed, and each visible marker that is on no branch is assigned to the segment that fits it best
    for k in range(len(bodies)):
        own = np.flatnonzero(segment == k)
        usual = float(np.median(residuals[k, own]))
        foreign = own[residuals[k, own] > max(_FOREIGN * usual, rules.max_body_residual)]
        if len(own) - len(foreign) >= LEAST:
            segment[foreign] = -1
    branched = np.isin(np.arange(len(segment)), [marker for body in search.branches for marker in body.markers])
    for marker in np.flatnonzero(seen & ~branched & (segment < 0)):
        unit = np.flatnonzero((constraints.unit == constraints.unit[marker]) & (segment >= 0))
        taken = segment[constraints.barred[marker]]
        cost = np.where(np.isin(np.arange(len(bodies)), taken), np.inf, residuals[:, marker])
        if len(unit):
            segment[marker] = segment[unit[0]]
        elif cost.min() <= rules.max_body_residual:
            segment[marker] = int(np.argmin(cost))

    # part of the segments' squared short-time rotation in the base that is not about one axis
    moment = np.zeros((3, 3))
    for body in bodies[1:]:
        turn = np.swapaxes(bodies[0].rotation, 1, 2) @ body.rotation
        turn = turn[np.isfinite(turn[:, 0, 0])]
        step = max(1, len(turn) // _STEPS)
        vector = so3.log(turn[step:] @ np.swapaxes(turn[:-step], 1, 2))
        moment += vector.T @ vector
    values = np.linalg.eigvalsh(moment)
    planarity = float(1 - values[2] / values.sum()) if values.sum() > 0 else 0.0

    scatter = measure_scatter(points)
    base, tip = (float(np.median(scatter[segment == k])) for k in (0, len(bodies) - 1))
    beside = [branch for branch, joined in zip(search.branches, search.joined, strict=True) if joined]
    explained = int(np.sum(segment >= 0)) + sum(len(branch.markers) for branch in beside)
    left_out = 1 - explained / max(int(seen.sum()), 1)
    divisions = [(each, True) for each in search.made] + [(each, False) for each in search.refused]
    return SpatialSegmentation(
        segment=segment,
        residual=np.where(segment >= 0, residuals[segment, np.arange(len(segment))], np.nan),
        reasons=tuple(_explain_assignment(m, segment, residuals, search, seen) for m in range(len(segment))),
        count=len(bodies),
        confidence=assess_spatial_confidence(bodies, joints, search, motion=tip / max(base, 1e-6), left_out=left_out),
        joints=joints,
        moving_base=base > rules.still_limit,
        planarity=planarity,
        divisions=tuple(sorted(divisions, key=lambda pair: -pair[0].gain)),
        branches=tuple(branch.markers for branch in search.branches),
    )


def _search_with_count(sorter: SpatialBodies, rules: SegmentationRules) -> SpatialSearch:
    """Return the search whose chain has the requested number of segments; refuse the trial if there is none.

    If skin is divided off as a separate body, this body is a branch. Without this division, its markers are on the
    chain. The search therefore begins with the chain that has most markers, with or without weak divisions.
    """
    search = trial = search_chain(sorter, rules, 1.0)
    for _ in range(_ROUNDS):
        weakest = min((each.evidence for each in trial.made), default=np.inf)
        if not search.chain or not search.branches or weakest > _CLEAR:
            break
        trial = search_chain(sorter, rules, weakest * (1 + 1e-9))
        carried, before = (sum(len(body.markers) for body in each.chain) for each in (trial, search))
        if carried > before:
            search = trial
    lengths = set()
    for _ in range(_COUNT_ROUNDS):
        length = len(search.chain)
        lengths.add(length)
        sizes = [each.evidence for each in (search.refused if length < (rules.count or 0) else search.made)]
        if rules.count is None or length == rules.count or not sizes:
            break
        search = search_chain(sorter, rules, max(sizes) if length < rules.count else min(sizes) * (1 + 1e-9))
    if search.chain and rules.count in (None, len(search.chain)):
        return search
    if lengths - {0}:
        raise Refused(
            "no-chain",
            f"no chain has {rules.count} segments, as requested by `segment: {{count: {rules.count}}}`; "
            f"chains with {', '.join(map(str, sorted(lengths - {0})))} segments exist. Remove `count`, or list markers "
            "that are `apart`.",
            float(rules.count or 0),
            float(max(lengths)),
        )
    count = sum(len(body.markers) >= LEAST for body in search.bodies)
    if count < 2:
        raise Refused(
            "no-chain",
            f"the {len(sorter.markers)} markers are one body (residual {1e3 * search.bodies[0].rms_residual:.0f} mm "
            "rms), so there is no joint. Record a larger movement of the joints, with at least three markers on each "
            "segment, or take the chain from another trial (`calibration:`).",
            float(count),
            2.0,
        )
    best = min(sorter.joints(search.bodies).values(), key=lambda joint: joint.residual / max(joint.free, 1e-6))
    raise Refused(
        "no-chain",
        f"none of {count} rigid bodies rotates about a point of another body: the best pair keeps a common point "
        f"within {1e3 * best.residual:.0f} mm (limit {1e3 * min(rules.max_residual, CHANCE * best.free):.0f} mm) over "
        f"an arc of {np.degrees(best.arc):.1f}° (at least {np.degrees(rules.min_arc):.1f}°). Record a larger movement "
        "of the joints, with at least three markers on each segment.",
        best.residual,
        rules.max_residual,
    )


def _explain_assignment(
    marker: int, segment: IntArray, residuals: FloatArray, search: SpatialSearch, seen: BoolArray
) -> str:
    """Return in words why a marker is on its segment, or on none."""
    k = int(segment[marker])
    if k >= 0:
        better = int(np.argmin(residuals[:, marker]))
        own = f"rigid with {'the base' if k == 0 else f'segment {k}'} within {1e3 * residuals[k, marker]:.1f} mm rms"
        if better == k:
            return own
        return f"{own}; at the joint to segment {better}, which it fits within {1e3 * residuals[better, marker]:.1f} mm"
    if not seen[marker]:
        return "visible in too few frames"
    for branch, joined in zip(search.branches, search.joined, strict=True):
        if marker in branch.markers:
            with_others = f"rigid with {len(branch.markers) - 1} other markers"
            where = "on a branch beside the chain" if joined else "that no joint connects with the chain"
            return f"{with_others} {where}"
    nearest = int(np.argmin(residuals[:, marker]))
    return (
        f"on no segment: it moves by {1e3 * residuals[nearest, marker]:.0f} mm rms relative to the nearest one "
        f"({'the base' if nearest == 0 else f'segment {nearest}'}), and fewer than three markers move with it"
    )
