"""Number, order and markers of the segments, from the motion alone, and the confidence in them (3.2.1, 3.2.4).

The thesis finds segments one by one from base to tip, by circles in the frame of the previous segment. Circles are a
weak test, because a marker two links away also moves on a circle if the joint between hardly moves. Here, rigid bodies
are found first, at several levels of detail. Each level gives a hypothesis, a chain from the base to a tip over real
joints. The hypothesis that best predicts the markers for its number of segments is chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics.chain_fit import joint_arcs
from mocap_id.kinematics.clusters import Base, Constraints, MarkerClusters, find_base
from mocap_id.kinematics.joint import RigidBody, fit_body, fit_joint, marker_residuals, still_body
from mocap_id.kinematics.link_fit import (
    FLOOR,
    SEGMENT_PRICE,
    Hypothesis,
    LinkFit,
    SegmentationProblem,
    SegmentationRules,
    find_best_links,
    find_hypotheses,
    log_cost,
)

Evidence: TypeAlias = Literal["skipped", "left-out", "axis", "first-joint", "base", "runner-up", "links", "ankle"]
"""Names of the evidence against the segments; the report has a sentence for each."""

_BEST = 3.8  # log odds without evidence against the segments
_SURE_SKIPPED = 3.5  # growth of the residual without a segment; 4.0 for correct segments, 3.0 for wrong ones
_SURE_FIXED = 1.5  # growth of the residual with the last segment fixed to its parent: more than soft tissue causes
_SURE_AXIS = 2.0
_SURE_PIN = 8e-3  # m
_SURE_GAP = 2.0
_SURE_COST = 20.0
_SURE_ANKLE_ARC = float(np.radians(30))
_LEFT_OUT_OF_LINKS = 5.0  # reduction of the log odds
_LOOSE = 5.0  # reduction of the log odds


@dataclass(frozen=True)
class Confidence:
    """Probability that the number of segments and every assignment are right, and the evidence against it."""

    value: float  # probability, 0 … 1
    joints: tuple[float, ...]  # confidence in each joint, 0 … 1
    against: Mapping[str, float]  # reduction of the log odds, 0 or more, by each piece of evidence


def weigh_evidence(best: float, joints: tuple[float, ...], against: Mapping[str, float]) -> Confidence:
    """Return the confidence from the log odds ``best``, which the evidence ``against`` reduces."""
    return Confidence(float(1 / (1 + np.exp(sum(against.values()) - best))), joints, against)


def assess_confidence(
    considered: tuple[Hypothesis, ...], ratios: tuple[float, ...], explained: float, margin: float, gap: float
) -> Confidence:
    """Return the confidence in a chain of rigid bodies.

    Evidence against the segments:

    - ``skipped``: the segment of the weakest joint could be left out at little cost;
    - ``left-out``: moving markers are on no segment and on no limb at the side;
    - ``axis``: a still marker near joint 1 could also belong to the other of its two segments;
    - ``first-joint``: the two bodies' points at joint 1 are more than 8 mm (rms) apart;
    - ``base``: the still markers hardly differ from the moving ones;
    - ``runner-up``: another number of segments explains the trial nearly as well.

    The confidence in a joint is 0.5 if the residual without its segment is 3.5 times as large (last joint: 1.5 times).

    ``considered`` are all hypotheses, best first. ``ratios`` are the residual without the segment of each joint divided
    by the residual with it. ``explained`` is that of :func:`explained_share`, ``margin`` that of
    :func:`find_axis_markers`, and ``gap`` that of :class:`.Base`.
    """
    best = considered[0]
    limits = [_SURE_SKIPPED] * (len(ratios) - 1) + [_SURE_FIXED]
    others = [h.cost - best.cost for h in considered if h.best_of_level and len(h.chain) != len(best.chain)]
    against = {
        "skipped": 2 * log_shortfall(min(ratio / limit for ratio, limit in zip(ratios, limits, strict=True)), 1.0),
        "left-out": 6 * log_shortfall(explained, 1.0),
        "axis": 4 * log_shortfall(margin, _SURE_AXIS),
        "first-joint": 6 * log_shortfall(1 / max(best.joints[0].residual, 1e-9), 1 / _SURE_PIN),
        "base": 2 * log_shortfall(gap, _SURE_GAP),
        "runner-up": 0.4 * log_shortfall(1 + min(others, default=np.inf), 1 + _SURE_COST),
    }
    joints = tuple(ratio / (ratio + limit) for ratio, limit in zip(ratios, limits, strict=True))
    return weigh_evidence(_BEST, joints, against)


def log_shortfall(value: float, enough: float) -> float:
    """Return ln(enough / value), at least 0."""
    return float(max(np.log(max(enough, 1e-3)) - np.log(max(value, 1e-3)), 0.0))


def explained_share(segment: IntArray, lateral: FloatArray, moving: IntArray) -> float:
    """Return the fraction of the moving markers that are on the chain; limbs beside the last segment do not count.

    ``segment`` (M,) is -1 for markers on no segment, ``lateral`` (M,) the mean out-of-plane coordinate, m, and
    ``moving`` the columns of the moving markers.
    """
    on_chain = moving[segment[moving] > 0]
    from_middle = np.abs(lateral - np.median(lateral[on_chain]))
    reach = from_middle[segment == segment.max()].max()
    left_out = moving[segment[moving] < 0]
    if len(left_out) > len(on_chain):  # limbs are never the larger part of a body
        return len(on_chain) / (len(on_chain) + len(left_out))
    unexplained = moving[(segment[moving] < 0) & (from_middle[moving] <= reach)]
    return len(on_chain) / (len(on_chain) + len(unexplained))


_PREFER_MOVING = 1.25  # a still marker stays on the base if its residual on segment 1 is larger by this factor
_PAIR = 0.03  # m; a left and a right marker this close in the side view are a pair
_LEAST_BASE = 2  # markers that stay on the base


def find_axis_markers(
    problem: SegmentationProblem, first: RigidBody, on_segment: IntArray
) -> tuple[dict[int, float], float]:
    """Find still markers that belong to segment 1.

    A marker on the axis of joint 1 hardly moves, so rigidity alone assigns it to the base. If it is assigned to segment
    1, it locates the joint. Segment 1 is fitted again with each candidate, because soft tissue moves the candidate by a
    few degrees relative to a fit without it. The fit includes the markers accepted before: when a malleolus has located
    the axis, a heel marker no longer fits. A left and a right marker at the same position are judged together.
    ``first`` is segment 1, and ``on_segment`` are the columns of all markers on it, also of markers that were not used
    in its fit.

    The results are the rms distance of each reassigned marker (column) from its position on segment 1, m, and the
    margin of the least certain decision: the factor between the threshold and the nearest residual ratio, at least 1;
    inf without candidates.
    """
    points, constraints = problem.points, problem.constraints
    on_base = marker_residuals(problem.ground, points)
    reassigned: dict[int, float] = {}
    margin = np.inf
    # single markers, and pairs: a left and a right marker at the same position in the side view
    alone = np.bincount(constraints.unit)[constraints.unit] == 1
    markers = problem.ground.markers[alone[problem.ground.markers]]
    left: list[tuple[int, ...]] = []
    if len(markers):
        place = np.nanmean(points[:, markers], axis=0)
        side = problem.lateral[markers] - np.median(problem.lateral[problem.moving])
        apart = np.abs(place[:, None] - place)
        apart[(side[:, None] * side) >= 0] = np.inf
        mate = np.argmin(apart, axis=1)
        for i, j in enumerate(mate):
            if not (apart[i, j] < _PAIR and mate[j] == i):
                left.append((int(markers[i]),))
            elif i < j:
                left.append((int(markers[i]), int(markers[j])))
    while left:
        members = np.concatenate([first.markers, np.array(list(reassigned), dtype=np.int64)])
        there = np.concatenate([on_segment, np.array(list(reassigned), dtype=np.int64)])
        left = [unit for unit in left if constraints.allow(np.append(there, unit))]
        spare = len(problem.ground.markers) - len(reassigned) - _LEAST_BASE
        candidates: list[tuple[float, FloatArray, tuple[int, ...]]] = []
        for unit in (unit for unit in left if len(unit) <= spare):
            residual = marker_residuals(fit_body(points, np.append(members, unit)), points[:, list(unit)])
            before = float(np.sqrt(np.mean(on_base[list(unit)] ** 2)))
            after = float(np.sqrt(np.mean(residual**2)))
            candidates.append((after / before if before > 0 else np.inf, residual, unit))
        if not candidates:
            break
        ratio, residual, best = min(candidates, key=lambda each: each[0])
        margin = min(margin, max(ratio / _PREFER_MOVING, _PREFER_MOVING / ratio))
        if ratio > _PREFER_MOVING:
            break
        reassigned.update(zip(best, residual.tolist(), strict=True))
        left.remove(best)
    return reassigned, float(margin)


_ADOPT = 2.0  # largest residual of an adopted marker, relative to the segment's own
_SURE = 0.9  # confidence in a chain of rigid bodies above which no other chain is tried
_BETTER = 2.0  # least advantage in cost of a chain with single-marker segments
_TALLEST = 5.0  # m; largest plausible height of the markers


@dataclass(frozen=True)
class Segmentation:
    """Markers sorted into segments."""

    segment: IntArray  # (M,) 0 = base, 1 … n from base to tip, -1 = none
    residual: FloatArray  # (M,) rms distance of each marker from its position on its segment, m; NaN for none
    count: int  # number of segments with the base
    confidence: Confidence
    ratios: tuple[float, ...]  # residual without the segment of each joint, divided by the residual with it
    base: Base  # still markers
    hypotheses: tuple[Hypothesis, ...] = field(repr=False)  # all hypotheses with rigid bodies only, best first
    links: LinkFit | None = field(default=None, repr=False)  # fit with single-marker segments


def segment_markers(
    points: ComplexArray, lateral: FloatArray, rules: SegmentationRules, constraints: Constraints | None = None
) -> Segmentation:
    """Sort markers into the segments of a serial chain on a fixed base.

    The trajectories ``points`` (F, M) are in the plane, m, NaN where missing; a few hundred frames along the motion are
    enough. ``lateral`` (M,) are the mean out-of-plane coordinates, m, which distinguish a pair of limbs from the trunk
    between them.

    Raises
    ------
    Refused
        ``no-fixed-base``, ``no-motion`` or ``no-chain``.
    """
    constraints = constraints or Constraints.of(points.shape[1])
    base = find_base(points, rules.still_limit, constraints)
    seen = np.isfinite(base.scatter)
    if len(base.markers) < 2:
        extent = float(np.ptp(points.imag[np.isfinite(points)])) if seen.any() else 0.0
        least = float(np.min(base.scatter, initial=np.inf))
        hint = f" The markers span {extent:.0f} m in height: is the unit of length right (`planarise: {{units: …}}`)?"
        raise Refused(
            "no-fixed-base",
            f"{len(base.markers)} of {points.shape[1]} markers stand still (the stillest moves by "
            f"{1e3 * least:.0f} mm rms); a chain needs a base of at least 2 markers that stay within "
            f"{1e3 * rules.still_limit:.0f} mm. Set a `window:` in which the feet stand still, or record again."
            + (hint if extent > _TALLEST else ""),
            least if np.isfinite(least) else None,
            rules.still_limit,
        )
    if len(base.markers) >= seen.sum() - 1:
        raise Refused(
            "no-motion",
            f"no joint moves: {len(base.markers)} of {int(seen.sum())} markers stay within "
            f"{1e3 * rules.still_limit:.0f} mm, so no segment can be found. Record a movement of the joints.",
            float(np.max(base.scatter[seen])),
            rules.still_limit,
        )
    moving = np.setdiff1d(np.flatnonzero(seen), base.markers)
    clusters = MarkerClusters(points, moving, constraints)
    problem = SegmentationProblem(
        points, lateral, base, still_body(points, base.markers), moving, rules, constraints, clusters
    )
    considered = tuple(sorted(find_hypotheses(problem), key=lambda hypothesis: hypothesis.cost))
    rigid = _assign(problem, considered) if considered else None
    if rigid is not None and not rigid.confidence.value < _SURE and rigid.confidence.against["left-out"] <= 0:
        return rigid
    # a chain with single-marker segments is better if its cost is lower and it has more segments
    links = find_best_links(problem)
    if links is not None and rigid is not None:
        gaps = np.array([0.0, *(joint.residual for joint in considered[0].joints)])
        on_segment = np.where(np.isfinite(rigid.residual), rigid.residual, np.inf)
        residual = np.hypot(on_segment, gaps[np.maximum(rigid.segment, 0)])
        cost = float(log_cost(residual[seen]).sum()) + SEGMENT_PRICE * (rigid.count - 1)
        if len(links.state.centres) < rigid.count or not links.cost < cost - _BETTER:
            return rigid
    if links is not None:
        explained = explained_share(links.segment, lateral, moving)
        ankle_marked, arcs = 0 in links.pins, joint_arcs(links.state.angles)
        against = {
            "left-out": _LEFT_OUT_OF_LINKS if explained < 1 else 0.0,
            "base": 0.0 if ankle_marked else 2 * log_shortfall(base.gap, _SURE_GAP),
            # a segment has a single marker, and no marker is at either of its joints
            "links": _LOOSE if links.loose else 0.0,
            # joint 1 rotates little, and no marker is at it
            "ankle": 0.0 if ankle_marked else 4 * log_shortfall(float(arcs[0]), _SURE_ANKLE_ARC),
        }
        confidence, count = weigh_evidence(_BEST, (1.0,) * len(arcs), against), len(links.state.centres) + 1
        ratios = links.ratios(points)
        return Segmentation(links.segment, links.residual, count, confidence, ratios, base, considered, links)
    if rigid is None:
        raise _explain_missing_chain(problem)
    return rigid


def _assign(problem: SegmentationProblem, considered: tuple[Hypothesis, ...]) -> Segmentation:
    """Return the segmentation of the best hypothesis. Leftover and axis markers are added."""
    points, best, constraints = problem.points, considered[0], problem.constraints
    links = (problem.ground, *best.chain)
    residuals = np.stack([marker_residuals(body, points) for body in links])
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(links):
        segment[body.markers] = k

    # leftover markers go to the segments that fit them, the most certain first; those of one unit to the same segment
    cost = residuals / (_ADOPT * np.array([body.residual for body in links]))[:, None]  # 1 is the largest allowed
    seen = np.isfinite(cost).any(axis=0)
    left = np.flatnonzero((segment < 0) & seen)
    units = [np.flatnonzero((constraints.unit == unit) & seen) for unit in np.unique(constraints.unit[left])]
    costs = [np.sqrt(np.mean(cost[:, unit] ** 2, axis=1)) for unit in units]
    for index in np.argsort([np.min(each) for each in costs]):
        unit = units[index]
        if segment[unit].max() >= 0:  # part of the unit is assigned already
            segment[unit] = segment[unit].max()
            continue
        taken = segment[constraints.barred[unit[0]]]
        open_to = np.where(np.isin(np.arange(len(cost)), taken), np.inf, costs[index])
        if np.min(open_to) <= 1:
            segment[unit] = np.argmin(open_to)
    residual = residuals[segment, np.arange(points.shape[1])]
    reassigned, margin = find_axis_markers(problem, best.chain[0], np.flatnonzero(segment == 1))
    for marker, on_segment in reassigned.items():
        segment[marker], residual[marker] = 1, on_segment

    # residual without the segment of each joint over the residual with it; the last segment is fixed to its parent
    joints, (parent, last) = best.joints, links[-2:]
    fixed = np.sqrt(np.mean(marker_residuals(parent, points[:, last.markers]) ** 2))
    ratios = (
        *(fit_joint(links[i], links[i + 2]).residual / max(joints[i].residual, FLOOR) for i in range(len(joints) - 1)),
        float(fixed / max(np.hypot(joints[-1].residual, last.residual), FLOOR)),
    )
    explained = explained_share(segment, problem.lateral, problem.moving)
    confidence = assess_confidence(considered, ratios, explained, margin, problem.base.gap)
    residual = np.where(segment >= 0, residual, np.nan)
    return Segmentation(segment, residual, len(links), confidence, ratios, problem.base, considered)


def _explain_missing_chain(problem: SegmentationProblem) -> Refused:
    """Return the refusal: no body rotates about a point of the base, or no chain has the requested length."""
    rules = problem.rules
    if rules.count is not None:
        counts = sorted(
            {len(other.chain) + 1 for other in find_hypotheses(replace(problem, rules=replace(rules, count=None)))}
        )
        if counts:
            numbers = ", ".join(map(str, counts))
            return Refused(
                "no-chain",
                f"no chain has {rules.count} segments, as requested by `segment: {{count: {rules.count}}}`; chains "
                f"with {numbers} segments exist. Remove `count`, or list markers that are `apart`.",
                float(rules.count),
                float(counts[-1]),
            )
    bodies = [body for level in (1, 2, 3) for body in problem.clusters.bodies_at(level)]
    pairs = [(fit_joint(problem.ground, body), body) for body in bodies]
    joint, body = min(pairs, key=lambda pair: np.hypot(pair[0].residual, pair[1].residual), default=(None, None))
    if joint is None or body is None:
        return Refused(
            "no-motion",
            f"no joint moves: the {len(problem.moving)} moving markers contain no rigid body of two or more markers.",
            float(len(problem.moving)),
            2.0,
        )
    return Refused(
        "no-chain",
        f"no body rotates about a joint on the fixed base: the best one ({len(body.markers)} markers) has a residual "
        f"of {1e3 * body.residual:.0f} mm (limit {1e3 * rules.max_body_residual:.0f} mm). Its joint has a residual of "
        f"{1e3 * joint.residual:.0f} mm (limit {1e3 * rules.max_residual:.0f} mm) over an arc of "
        f"{np.degrees(joint.arc):.1f}° (at least {np.degrees(rules.min_arc):.1f}°). "
        "Check that the chain is fixed to the still markers.",
        joint.residual,
        rules.max_residual,
    )
