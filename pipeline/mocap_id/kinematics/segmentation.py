"""The number of segments, their order and their markers, from the motion alone (3.2.1, 3.2.4).

The thesis peels segments off from base to tip by circles seen in the frame of the previous one. Circles are a weak
test: a marker two links out looks circular whenever the joint between hardly moves. Here rigid bodies are found
first, at several levels of detail; every level gives a hypothesis, a chain from the base to a tip over joints that are
real; and the hypothesis is kept that predicts the markers best for its number of segments.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics.axis_markers import on_first_axis
from mocap_id.kinematics.bodies import Base, Clusters, find_base
from mocap_id.kinematics.confidence import Confidence, explained_share, judge
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.hypotheses import FLOOR, Hypothesis, Scene, SegmentationRules, hypotheses
from mocap_id.kinematics.joint import PairJoint, fit_joint
from mocap_id.kinematics.rigid import Body, marker_residuals, still_body

_ADOPT = 2.0  # a marker left over is adopted by a segment that holds it within this multiple of its own residual
_TALLEST = 5.0  # m


@dataclass(frozen=True)
class Segmentation:
    """Markers sorted into segments.

    Parameters
    ----------
    segment : (M,) int array
        0 = base, 1 … n from base to tip, -1 = none.
    residual : (M,) array
        rms distance of each marker from its place on its segment, m; NaN for none.
    count : int
        Segments with the base.
    confidence : Confidence
        How sure that is.
    ratios : tuple of float
        For each joint, the residual without its segment (skipped, the last one fixed to its parent) over its own.
    base : Base
        The still markers and the noise floor.
    hypotheses : tuple of Hypothesis
        All that were considered, best first.
    """

    segment: IntArray
    residual: FloatArray
    count: int
    confidence: Confidence
    ratios: tuple[float, ...]
    base: Base
    hypotheses: tuple[Hypothesis, ...] = field(repr=False)


def segment_markers(
    points: ComplexArray, lateral: FloatArray, rules: SegmentationRules, constraints: Constraints | None = None
) -> Segmentation:
    """Sort markers into the segments of a serial chain on a fixed base.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen. A few hundred frames that span the motion are enough.
    lateral : (M,) array
        Mean out-of-plane coordinate of every marker, m: tells a pair of limbs from the trunk they hang on.
    constraints : Constraints, optional
        Markers that the user wants together or apart.

    Raises
    ------
    Refused
        ``no-fixed-base``, ``no-motion`` or ``no-chain``, with the numbers.
    """
    constraints = constraints or Constraints.of(points.shape[1])
    base = find_base(points, rules.still_limit, constraints)
    _require_base_and_motion(base, points, rules)
    moving = np.setdiff1d(np.flatnonzero(np.isfinite(base.scatter)), base.markers)
    clusters = Clusters(points, moving, constraints)
    scene = Scene(points, lateral, base, still_body(points, base.markers), moving, rules, constraints, clusters)
    considered = tuple(sorted(hypotheses(scene), key=lambda hypothesis: hypothesis.cost))
    if not considered:
        raise _no_chain(scene)
    return _assign(scene, considered)


def _require_base_and_motion(base: Base, points: ComplexArray, rules: SegmentationRules) -> None:
    markers, seen = points.shape[1], np.isfinite(base.scatter)
    extent = float(np.ptp(points.imag[np.isfinite(points)])) if seen.any() else 0.0
    least = float(np.min(base.scatter, initial=np.inf))
    if len(base.markers) < 2:
        raise Refused(
            "no-fixed-base",
            f"{len(base.markers)} of {markers} markers stay where they are (the stillest moves by "
            f"{1e3 * least:.0f} mm rms); a chain needs a base with at least 2 markers within "
            f"{1e3 * rules.still_limit:.0f} mm. Give a `window:` in which the feet stay put, or record such a part."
            + _unit_doubt(extent),
            least if np.isfinite(least) else None,
            rules.still_limit,
        )
    if len(base.markers) >= seen.sum() - 1:
        largest = float(np.max(base.scatter[seen]))
        raise Refused(
            "no-motion",
            f"no joint moves: {len(base.markers)} of {int(seen.sum())} markers stay within "
            f"{1e3 * rules.still_limit:.0f} mm, so there is no segment to find. Record a movement of the joints.",
            largest,
            rules.still_limit,
        )


def _unit_doubt(extent: float) -> str:
    """A hint where the markers reach higher than any body does."""
    if extent <= _TALLEST:
        return ""
    return f" The markers span {extent:.0f} m in height: is the unit of length right (`planarise: {{units: …}}`)?"


def _assign(scene: Scene, considered: tuple[Hypothesis, ...]) -> Segmentation:
    """Bodies of the best hypothesis keep their markers; those left over, and some still ones, find theirs."""
    points, best = scene.points, considered[0]
    links = (scene.ground, *best.chain)
    residuals = np.stack([marker_residuals(body, points) for body in links])
    own = np.array([body.residual for body in links])
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(links):
        segment[body.markers] = k
    _adopt(scene.constraints, segment, residuals / (_ADOPT * own)[:, None])
    residual = residuals[segment, np.arange(points.shape[1])]
    axis = on_first_axis(scene, best.chain[0], np.flatnonzero(segment == 1))
    for marker, on_segment in axis.residual.items():
        segment[marker], residual[marker] = 1, on_segment
    ratios = _ratios(points, links, best.joints)
    explained = explained_share(segment, scene.lateral, scene.moving)
    return Segmentation(
        segment,
        np.where(segment >= 0, residual, np.nan),
        len(links),
        judge(considered, ratios, explained, axis.margin, scene.base.gap),
        ratios,
        scene.base,
        considered,
    )


def _adopt(constraints: Constraints, segment: IntArray, cost: FloatArray) -> None:
    """Put markers left over on the segments that hold them, the surest first, those that belong together as one.

    Parameters
    ----------
    segment : (M,) int array
        -1 for those left over; changed in place.
    cost : (n + 1, M) array
        Residual of every marker on every segment over what is allowed there.
    """
    seen = np.isfinite(cost).any(axis=0)
    left = np.flatnonzero((segment < 0) & seen)
    units = [np.flatnonzero((constraints.unit == unit) & seen) for unit in np.unique(constraints.unit[left])]
    costs = [np.sqrt(np.mean(cost[:, unit] ** 2, axis=1)) for unit in units]
    for index in np.argsort([np.min(each) for each in costs]):
        unit = units[index]
        if segment[unit].max() >= 0:  # some of them are sorted already
            segment[unit] = segment[unit].max()
            continue
        taken = segment[constraints.barred[unit[0]]]
        open_to = np.where(np.isin(np.arange(len(cost)), taken), np.inf, costs[index])
        if np.min(open_to) <= 1:
            segment[unit] = np.argmin(open_to)


def _ratios(points: ComplexArray, links: tuple[Body, ...], joints: tuple[PairJoint, ...]) -> tuple[float, ...]:
    """How much worse the trial is explained without each joint's segment, as a ratio of residuals.

    A segment between two others is tried by skipping it; the last one by fixing it to its parent.
    """
    skipped = [
        fit_joint(links[i], links[i + 2]).residual / max(joints[i].residual, FLOOR) for i in range(len(joints) - 1)
    ]
    parent, last = links[-2:]
    fixed = np.sqrt(np.mean(marker_residuals(parent, points[:, last.markers]) ** 2))
    return (*skipped, float(fixed / max(np.hypot(joints[-1].residual, last.residual), FLOOR)))


def _no_chain(scene: Scene) -> Refused:
    """Why no body turns about a point fixed to the base, or why none of the chains is as long as was asked."""
    rules = scene.rules
    if rules.count is not None:
        found = sorted({len(other.chain) + 1 for other in hypotheses(replace(scene, rules=replace(rules, count=None)))})
        if found:
            numbers = ", ".join(map(str, found))
            return Refused(
                "no-chain",
                f"no chain of {rules.count} segments, as `segment: {{count: {rules.count}}}` asks: there are chains of "
                f"{numbers}. Take `count` away, or say which markers are `apart`.",
                float(rules.count),
                float(found[-1]),
            )
    bodies = [body for level in (1, 2, 3) for body in scene.clusters.at(level)]
    pairs = [(fit_joint(scene.ground, body), body) for body in bodies]
    joint, body = min(pairs, key=lambda pair: np.hypot(pair[0].residual, pair[1].residual), default=(None, None))
    if joint is None or body is None:
        return Refused(
            "no-motion",
            f"{len(scene.moving)} moving markers do not make a rigid body of two or more, so no joint moves.",
            float(len(scene.moving)),
            2.0,
        )
    return Refused(
        "no-chain",
        f"no body turns about a joint on the fixed base: the best one ({len(body.markers)} markers) holds them to "
        f"{1e3 * body.residual:.0f} mm (limit {1e3 * rules.max_body_residual:.0f}) and its joint to "
        f"{1e3 * joint.residual:.0f} mm (limit {1e3 * rules.max_residual:.0f}) over an arc of "
        f"{np.degrees(joint.arc):.1f}° (at least {np.degrees(rules.min_arc):.1f}). "
        "Does the chain stand on the markers that stay still?",
        joint.residual,
        rules.max_residual,
    )
