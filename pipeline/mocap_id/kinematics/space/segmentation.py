"""Number, order and markers of the segments of a chain in space, from the motion alone.

The markers are divided into rigid bodies (:mod:`.division`). The bodies are ordered along real joints, from the body
that moves least (:mod:`.chain_search`). Leftover markers are assigned to the segment that fits them best.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.geometry import so3
from mocap_id.kinematics.confidence import Confidence
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.frame_sampling import frames_along_motion
from mocap_id.kinematics.hypotheses import SegmentationRules
from mocap_id.kinematics.space.bodies import LEAST, SpatialBodies, distance_deviation, fit_pair_joint
from mocap_id.kinematics.space.chain_search import (
    CHANCE,
    SpatialBodyChain,
    SpatialSearch,
    fit_joints_along,
    measure_scatter,
    search_best_chain,
    search_chain,
)
from mocap_id.kinematics.space.confidence import assess_spatial_confidence
from mocap_id.kinematics.space.rigid_body import mean_rotation

_SEARCH_FRAMES = 120
_STEPS = 60  # rotations are compared over 1/60 of the frames, to reduce the effect of noise
_SEEN = 0.05  # least fraction of the frames in which a marker is visible
_RIGID = 3e-3  # m; least standard deviation of a distance if a joint moves
_PARTNER = 1.5  # largest standard deviation of a distance within a body, relative to the largest body residual
_FOREIGN = 6.0  # largest residual of a marker on its segment, relative to the median residual there
_ROUNDS = 4


@dataclass(frozen=True)
class SpatialHypothesis:
    """Division of a body into two, which was made or refused."""

    parts: tuple[IntArray, IntArray]  # columns of the markers of the two parts
    evidence: float  # evidence for two bodies relative to the required one; 1 or more if they were divided
    gain: float  # summed log gain of the markers' residuals by the division
    chosen: bool  # whether the body was divided


@dataclass(frozen=True)
class SpatialSegmentation:
    """Markers sorted into the segments of a chain in space."""

    segment: IntArray  # (M,) 0 = base, 1 … n from base to tip, -1 = none
    parents: tuple[int, ...]  # parent of segments 1 … n
    residual: FloatArray  # (M,) rms distance of each marker from its position on its segment, m; NaN for none
    reasons: tuple[str, ...]  # reason for the assignment of each marker
    count: int  # number of segments with the base
    confidence: Confidence
    ratios: tuple[float, ...]  # motion without each joint, divided by the residual of the joint
    joint_residuals: tuple[float, ...]  # rms distance between the two segments' points at each joint, m
    arcs: tuple[float, ...]  # range of each joint's rotation about its main axis, rad
    moving_base: bool  # whether the base moves in the lab
    planarity: float  # fraction of the rotation that is not about one axis; 0 if planar, 2/3 for equal rotations
    hypotheses: tuple[SpatialHypothesis, ...] = field(repr=False)  # divisions made and refused, the largest gain first
    branches: tuple[IntArray, ...] = field(default=(), repr=False)  # columns of the bodies that were left out


def segment_in_space(
    points: FloatArray,
    rules: SegmentationRules | None = None,
    constraints: Constraints | None = None,
    frames: int = 400,
) -> SpatialSegmentation:
    """Sort markers into the segments of a chain in space, whose base may move.

    Parameters
    ----------
    points : (F, M, 3) array
        Trajectories in the lab, m; NaN where missing, and for markers that the user ignores.
    rules : SegmentationRules, optional
        Limits. Only ``min_arc``, ``max_residual``, ``max_body_residual``, ``still_limit`` (of a base that does not
        move), ``count`` and ``longest`` are used.
    constraints : Constraints, optional
    frames : int, optional
        Largest number of frames, chosen along the motion.

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
    _require_motion(len(markers), deviation[np.ix_(seen, seen)])
    searched = points[frames_along_motion(points, min(frames, _SEARCH_FRAMES))]
    search = _search_with_count(SpatialBodies(searched, markers, constraints), rules)
    return _assemble(search, points, seen, rules, constraints)


def _require_motion(count: int, deviation: FloatArray) -> None:
    """Refuse a trial in which no distance between markers changes, or fewer than two bodies can be formed."""
    largest = float(deviation.max(initial=0.0))
    if largest < _RIGID and count:
        raise Refused(
            "no-motion",
            f"no joint moves: all distances between markers stay constant within {1e3 * largest:.1f} mm rms (at a "
            f"joint, some change by more than {1e3 * _RIGID:.0f} mm). Record a movement of the joints.",
            largest,
            _RIGID,
        )
    if count < 2 * LEAST:
        raise Refused(
            "no-chain",
            f"{count} of {len(deviation)} markers move rigidly with two others, but two segments in space need at "
            f"least {2 * LEAST} markers, three each. Add markers, so that each segment has three.",
            float(count),
            float(2 * LEAST),
        )


def _search_with_count(sorter: SpatialBodies, rules: SegmentationRules) -> SpatialSearch:
    """Return the search whose chain has the requested number of segments; refuse the trial if there is none."""
    search = search_best_chain(sorter, rules)
    lengths = set()
    for _ in range(_ROUNDS):
        length = 0 if search.chain is None else len(search.chain.bodies)
        lengths.add(length)
        sizes = [each.evidence for each in (search.refused if length < (rules.count or 0) else search.made)]
        if rules.count is None or length == rules.count or not sizes:
            break
        search = search_chain(sorter, rules, max(sizes) if length < rules.count else min(sizes) * (1 + 1e-9))
    length = 0 if search.chain is None else len(search.chain.bodies)
    if search.chain is not None and rules.count in (None, length):
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
    raise _explain_missing_chain(search, sorter, rules)


def _explain_missing_chain(search: SpatialSearch, sorter: SpatialBodies, rules: SegmentationRules) -> Refused:
    """Return the refusal: no two bodies rotate about a common point."""
    bodies = sum(len(body.markers) >= LEAST for body in search.bodies)
    if bodies < 2:
        return Refused(
            "no-chain",
            f"the {len(sorter.markers)} markers are one body (residual {1e3 * search.bodies[0].rms_residual:.0f} mm "
            "rms), so there is no joint. Record a larger movement of the joints, with at least three markers on each "
            "segment, or take the chain from another trial (`calibration:`).",
            float(bodies),
            2.0,
        )
    joints = [fit_pair_joint(first, second) for first, second in combinations(search.bodies, 2)]
    best = min(joints, key=lambda joint: joint.residual / max(joint.free, 1e-6))
    return Refused(
        "no-chain",
        f"none of {bodies} rigid bodies rotates about a point of another body: the best pair keeps a common point "
        f"within {1e3 * best.residual:.0f} mm (limit {1e3 * min(rules.max_residual, CHANCE * best.free):.0f} mm) over "
        f"an arc of {np.degrees(best.arc):.1f}° (at least {np.degrees(rules.min_arc):.1f}°). Record a larger movement "
        "of the joints, with at least three markers on each segment.",
        best.residual,
        rules.max_residual,
    )


def _assemble(
    search: SpatialSearch, points: FloatArray, seen: BoolArray, rules: SegmentationRules, constraints: Constraints
) -> SpatialSegmentation:
    """Return the result, with the bodies fitted to all chosen frames, and with the leftover markers assigned."""
    assert search.chain is not None
    sorter = SpatialBodies(points, np.flatnonzero(seen), constraints)
    bodies = [sorter.body(body.markers) for body in search.chain.bodies]
    chain = SpatialBodyChain(tuple(bodies), fit_joints_along(bodies), search.chain.branches, search.chain.joined)
    residuals = np.stack([body.residual for body in bodies])
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(bodies):
        segment[body.markers] = k
    branched = np.isin(np.arange(len(segment)), [marker for body in chain.branches for marker in body.markers])
    _assign_leftovers(segment, residuals, seen & ~branched, rules, constraints)
    residual = np.where(segment >= 0, residuals[segment, np.arange(len(segment))], np.nan)
    motion = measure_scatter(points)
    base, tip = (float(np.median(motion[segment == k])) for k in (0, len(bodies) - 1))
    beside = [branch for branch, joined in zip(chain.branches, chain.joined, strict=True) if joined]
    explained = int(np.sum(segment >= 0)) + sum(len(branch.markers) for branch in beside)
    confidence = assess_spatial_confidence(
        chain,
        search.made,
        search.refused,
        motion=tip / max(base, 1e-6),
        second_arc=_measure_second_arc(chain),
        left_out=1 - explained / max(int(seen.sum()), 1),
    )
    return SpatialSegmentation(
        segment=segment,
        parents=tuple(range(len(bodies) - 1)),
        residual=residual,
        reasons=tuple(_explain_assignment(m, segment, residuals, chain, seen) for m in range(len(segment))),
        count=len(bodies),
        confidence=confidence,
        ratios=tuple(joint.free / max(joint.residual, 1e-6) for joint in chain.joints),
        joint_residuals=tuple(joint.residual for joint in chain.joints),
        arcs=tuple(joint.arc for joint in chain.joints),
        moving_base=base > rules.still_limit,
        planarity=_measure_planarity(chain),
        hypotheses=_list_hypotheses(search),
        branches=tuple(branch.markers for branch in chain.branches),
    )


def _assign_leftovers(
    segment: IntArray, residuals: FloatArray, free: BoolArray, rules: SegmentationRules, constraints: Constraints
) -> None:
    """Remove outliers from ``segment`` (M,), in place, and assign each free marker to the segment that fits it best.

    ``residuals`` (n + 1, M) are residuals of every marker on every segment, m. ``free`` (M,) marks the markers that are
    visible and on no branch.
    """
    for k in range(len(residuals)):
        own = np.flatnonzero(segment == k)
        usual = float(np.median(residuals[k, own]))
        foreign = own[residuals[k, own] > max(_FOREIGN * usual, rules.max_body_residual)]
        if len(own) - len(foreign) >= LEAST:
            segment[foreign] = -1
    for marker in np.flatnonzero(free & (segment < 0)):
        unit = np.flatnonzero((constraints.unit == constraints.unit[marker]) & (segment >= 0))
        taken = segment[constraints.barred[marker]]
        cost = np.where(np.isin(np.arange(len(residuals)), taken), np.inf, residuals[:, marker])
        if len(unit):
            segment[marker] = segment[unit[0]]
        elif cost.min() <= rules.max_body_residual:
            segment[marker] = int(np.argmin(cost))


def _explain_assignment(
    marker: int, segment: IntArray, residuals: FloatArray, chain: SpatialBodyChain, seen: BoolArray
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
    for branch, joined in zip(chain.branches, chain.joined, strict=True):
        if marker in branch.markers:
            with_others = f"rigid with {len(branch.markers) - 1} other markers"
            where = "on a branch beside the chain" if joined else "that no joint connects with the chain"
            return f"{with_others} {where}"
    nearest = int(np.argmin(residuals[:, marker]))
    return (
        f"on no segment: it moves by {1e3 * residuals[nearest, marker]:.0f} mm rms relative to the nearest one "
        f"({'the base' if nearest == 0 else f'segment {nearest}'}), and fewer than three markers move with it"
    )


def _measure_planarity(chain: SpatialBodyChain) -> float:
    """Return the fraction of the segments' squared short-time rotation in the base that is not about one axis."""
    base = chain.bodies[0].rotation
    moment = np.zeros((3, 3))
    for body in chain.bodies[1:]:
        turn = np.swapaxes(base, 1, 2) @ body.rotation
        turn = turn[np.isfinite(turn[:, 0, 0])]
        step = max(1, len(turn) // _STEPS)
        vector = so3.log(turn[step:] @ np.swapaxes(turn[:-step], 1, 2))
        moment += vector.T @ vector
    values = np.linalg.eigvalsh(moment)
    return float(1 - values[2] / values.sum()) if values.sum() > 0 else 0.0


def _measure_second_arc(chain: SpatialBodyChain) -> float:
    """Return the arc of the second independent rotation of the joints, as 4 standard deviations, rad; 0 for one joint.

    The rotation vectors of all joints are split into independent time courses (principal components).
    """
    if len(chain.joints) < 2:
        return 0.0
    turns = [np.swapaxes(a.rotation, 1, 2) @ b.rotation for a, b in pairwise(chain.bodies)]
    together = np.isfinite(np.stack([turn[:, 0, 0] for turn in turns])).all(axis=0)
    if together.sum() < LEAST:
        return 0.0
    vectors = [so3.log(mean_rotation(turn[together]).T @ turn[together]) for turn in turns]
    vector = np.concatenate(vectors, axis=1)
    values = np.linalg.eigvalsh(np.cov(vector.T))
    return float(4 * np.sqrt(max(values[-2], 0.0)))


def _list_hypotheses(search: SpatialSearch) -> tuple[SpatialHypothesis, ...]:
    """Return the divisions made and refused, the largest gain first."""
    every = [(each, True) for each in search.made] + [(each, False) for each in search.refused]
    return tuple(
        SpatialHypothesis((each.parts[0].markers, each.parts[1].markers), each.evidence, each.gain, chosen)
        for each, chosen in sorted(every, key=lambda pair: -pair[0].gain)
    )
