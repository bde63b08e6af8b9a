"""Number, order and markers of the segments, from the motion alone (3.2.1, 3.2.4).

The thesis finds segments one by one from base to tip, by circles in the frame of the previous segment. Circles are a
weak test, because a marker two links away also moves on a circle if the joint between hardly moves. Here, rigid bodies
are found first, at several levels of detail. Each level gives a hypothesis, a chain from the base to a tip over real
joints. The hypothesis that best predicts the markers for its number of segments is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics.axis_markers import find_axis_markers
from mocap_id.kinematics.chain_search import find_hypotheses
from mocap_id.kinematics.clusters import Base, Clusters, find_base
from mocap_id.kinematics.confidence import Confidence, assess_confidence, assess_links, explained_share
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.hypotheses import FLOOR, Hypothesis, SegmentationProblem, SegmentationRules
from mocap_id.kinematics.joint import PairJoint, fit_joint
from mocap_id.kinematics.link_fit import SEGMENT_PRICE, LinkFit, log_cost
from mocap_id.kinematics.link_search import find_best_links
from mocap_id.kinematics.rigid_body import RigidBody, marker_residuals, still_body

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

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where missing. A few hundred frames along the motion are enough.
    lateral : (M,) array
        Mean out-of-plane coordinate of every marker, m. It distinguishes a pair of limbs from the trunk between them.
    rules : SegmentationRules
    constraints : Constraints, optional

    Raises
    ------
    Refused
        ``no-fixed-base``, ``no-motion`` or ``no-chain``.
    """
    constraints = constraints or Constraints.of(points.shape[1])
    base = find_base(points, rules.still_limit, constraints)
    _require_base_and_motion(base, points, rules)
    moving = np.setdiff1d(np.flatnonzero(np.isfinite(base.scatter)), base.markers)
    clusters = Clusters(points, moving, constraints)
    problem = SegmentationProblem(
        points, lateral, base, still_body(points, base.markers), moving, rules, constraints, clusters
    )
    considered = tuple(sorted(find_hypotheses(problem), key=lambda hypothesis: hypothesis.cost))
    rigid = _assign(problem, considered) if considered else None
    if rigid is None or rigid.confidence.value < _SURE or rigid.confidence.against["left-out"] > 0:
        links = find_best_links(problem)
        if links is not None:
            longer = rigid is None or len(links.state.centres) >= rigid.count
            if longer and (rigid is None or links.cost < _rigid_cost(problem, rigid) - _BETTER):
                return _build_from_links(problem, considered, links)
    if rigid is None:
        raise _explain_missing_chain(problem)
    return rigid


def _rigid_cost(problem: SegmentationProblem, segmentation: Segmentation) -> float:
    """Return the cost of a chain of rigid bodies, computed as in :mod:`.link_fit`."""
    seen = np.isfinite(problem.base.scatter)
    gaps = np.array([0.0, *(joint.residual for joint in segmentation.hypotheses[0].joints)])
    on_segment = np.where(np.isfinite(segmentation.residual), segmentation.residual, np.inf)
    residual = np.hypot(on_segment, gaps[np.maximum(segmentation.segment, 0)])
    return float(log_cost(residual[seen]).sum()) + SEGMENT_PRICE * (segmentation.count - 1)


def _build_from_links(problem: SegmentationProblem, considered: tuple[Hypothesis, ...], links: LinkFit) -> Segmentation:
    """Return the segmentation of a chain with single-marker segments."""
    explained = explained_share(links.segment, problem.lateral, problem.moving)
    return Segmentation(
        links.segment,
        links.residual,
        len(links.state.centres) + 1,
        assess_links(links, explained, problem.base.gap),
        links.ratios(problem.points),
        problem.base,
        considered,
        links,
    )


def _require_base_and_motion(base: Base, points: ComplexArray, rules: SegmentationRules) -> None:
    """Refuse a trial with fewer than two base markers or fewer than two moving markers."""
    markers, seen = points.shape[1], np.isfinite(base.scatter)
    extent = float(np.ptp(points.imag[np.isfinite(points)])) if seen.any() else 0.0
    least = float(np.min(base.scatter, initial=np.inf))
    if len(base.markers) < 2:
        raise Refused(
            "no-fixed-base",
            f"{len(base.markers)} of {markers} markers stand still (the stillest moves by "
            f"{1e3 * least:.0f} mm rms); a chain needs a base of at least 2 markers that stay within "
            f"{1e3 * rules.still_limit:.0f} mm. Set a `window:` in which the feet stand still, or record again."
            + _hint_at_unit(extent),
            least if np.isfinite(least) else None,
            rules.still_limit,
        )
    if len(base.markers) >= seen.sum() - 1:
        largest = float(np.max(base.scatter[seen]))
        raise Refused(
            "no-motion",
            f"no joint moves: {len(base.markers)} of {int(seen.sum())} markers stay within "
            f"{1e3 * rules.still_limit:.0f} mm, so no segment can be found. Record a movement of the joints.",
            largest,
            rules.still_limit,
        )


def _hint_at_unit(extent: float) -> str:
    """Return a hint at a wrong unit if the markers are higher than any body; otherwise an empty text."""
    if extent <= _TALLEST:
        return ""
    return f" The markers span {extent:.0f} m in height: is the unit of length right (`planarise: {{units: …}}`)?"


def _assign(problem: SegmentationProblem, considered: tuple[Hypothesis, ...]) -> Segmentation:
    """Return the segmentation of the best hypothesis. Leftover and axis markers are added."""
    points, best = problem.points, considered[0]
    links = (problem.ground, *best.chain)
    residuals = np.stack([marker_residuals(body, points) for body in links])
    own = np.array([body.residual for body in links])
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(links):
        segment[body.markers] = k
    _assign_leftovers(problem.constraints, segment, residuals / (_ADOPT * own)[:, None])
    residual = residuals[segment, np.arange(points.shape[1])]
    axis = find_axis_markers(problem, best.chain[0], np.flatnonzero(segment == 1))
    for marker, on_segment in axis.residual.items():
        segment[marker], residual[marker] = 1, on_segment
    ratios = _compute_ratios(points, links, best.joints)
    explained = explained_share(segment, problem.lateral, problem.moving)
    return Segmentation(
        segment,
        np.where(segment >= 0, residual, np.nan),
        len(links),
        assess_confidence(considered, ratios, explained, axis.margin, problem.base.gap),
        ratios,
        problem.base,
        considered,
    )


def _assign_leftovers(constraints: Constraints, segment: IntArray, cost: FloatArray) -> None:
    """Assign leftover markers (-1 in ``segment``, in place) to the segments that fit them, the most certain first.

    ``cost`` (n + 1, M) is the residual of every marker on every segment, divided by the largest allowed one. Markers
    that must be together get the same segment.
    """
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


def _compute_ratios(
    points: ComplexArray, links: tuple[RigidBody, ...], joints: tuple[PairJoint, ...]
) -> tuple[float, ...]:
    """Return, for each joint, the residual without its segment divided by the residual with it.

    For the last joint, the segment is fixed to its parent instead.
    """
    skipped = [
        fit_joint(links[i], links[i + 2]).residual / max(joints[i].residual, FLOOR) for i in range(len(joints) - 1)
    ]
    parent, last = links[-2:]
    fixed = np.sqrt(np.mean(marker_residuals(parent, points[:, last.markers]) ** 2))
    return (*skipped, float(fixed / max(np.hypot(joints[-1].residual, last.residual), FLOOR)))


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
