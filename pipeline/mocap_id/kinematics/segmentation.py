"""The number of segments, their order and their markers, from the motion alone (3.2.1, 3.2.4).

The thesis peels segments off from base to tip by circles seen in the frame of the previous one. Circles are a weak
test: a marker two links out looks circular whenever the joint between hardly moves. Here rigid bodies are found
first, at several levels of detail; every level gives a hypothesis, a chain from the base to a tip over joints that are
real; and the hypothesis is kept that predicts the markers best for its number of segments.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics.bodies import Base, cluster, find_base
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.hypotheses import FLOOR, Hypothesis, Scene, SegmentationRules, hypotheses
from mocap_id.kinematics.joint import PairJoint, fit_joint
from mocap_id.kinematics.rigid import Body, fit_body, marker_residuals, still_body

_ADOPT = 2.0  # a marker left over is adopted by a segment that holds it within this multiple of its own residual
_PREFER_MOVING = 1.25  # a still marker goes to segment 1 unless that holds it worse than the base by this factor
_SURE_SKIPPED = 3.5  # skipping a segment fits this much worse: between what right (4.0) and wrong ones (3.0) show
_TALLEST = 5.0  # m
_SURE_FIXED = 1.5  # fixing the last segment to its parent fits this much worse: beyond what soft tissue makes of one


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
    confidences : tuple of float
        0 … 1 for each joint, from its ratio: 0.5 where leaving its segment out fits 3.5 times worse, the last 1.5.
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
    confidences: tuple[float, ...]
    ratios: tuple[float, ...]
    base: Base
    hypotheses: tuple[Hypothesis, ...] = field(repr=False)

    @property
    def confidence(self) -> float:
        """That of the weakest joint."""
        return min(self.confidences)


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
    scene = Scene(points, lateral, base, still_body(points, base.markers), moving, rules, constraints)
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
    nearest = np.argmin(residuals, axis=0)
    segment = np.full(points.shape[1], -1)
    for k, body in enumerate(links):
        segment[body.markers] = k
    open_to = scene.constraints.open_to(segment, len(links))
    adopted = (np.min(residuals, axis=0) <= _ADOPT * own[nearest]) & open_to[nearest, np.arange(points.shape[1])]
    segment = np.where((segment < 0) & adopted, nearest, segment)
    residual = residuals[segment, np.arange(points.shape[1])]
    for marker, on_segment in _on_first_axis(scene, best.chain[0]).items():
        segment[marker], residual[marker] = 1, on_segment
    ratios = _ratios(points, links, best.joints)
    sure = [_SURE_SKIPPED] * (len(ratios) - 1) + [_SURE_FIXED]
    return Segmentation(
        segment,
        np.where(segment >= 0, residual, np.nan),
        len(links),
        tuple(ratio / (ratio + limit) for ratio, limit in zip(ratios, sure, strict=True)),
        ratios,
        scene.base,
        considered,
    )


def _on_first_axis(scene: Scene, first: Body) -> dict[int, float]:
    """Still markers that belong to segment 1, with their residual there, the surest first.

    A marker on the axis of joint 1 (a malleolus) hardly moves, so rigidity puts it on the base; on the segment it pins
    the joint. The segment is fitted anew with each one: judged from outside, a few degrees of soft tissue would reject
    it; and with those taken before, so that a heel cannot follow where a malleolus has pinned the axis.
    """
    points, constraints = scene.points, scene.constraints
    held = marker_residuals(scene.ground, points)
    taken: dict[int, float] = {}
    alone = np.bincount(constraints.unit)[constraints.unit] == 1
    left = [int(marker) for marker in scene.ground.markers if alone[marker]]
    while len(scene.ground.markers) - len(taken) > 2:
        members = np.concatenate([first.markers, np.array(list(taken), dtype=np.int64)])
        left = [marker for marker in left if marker not in taken and not constraints.barred[marker, members].any()]
        if not left:
            break
        refitted = {marker: fit_body(points, np.append(members, marker)) for marker in left}
        residual = {m: float(marker_residuals(body, points[:, m : m + 1])[0]) for m, body in refitted.items()}
        best = min(left, key=lambda marker: residual[marker] / held[marker] if held[marker] > 0 else np.inf)
        if residual[best] > _PREFER_MOVING * held[best]:
            break
        taken[best] = residual[best]
    return taken


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
    """Why no body turns about a point fixed to the base."""
    rules = scene.rules
    bodies = [body for level in (1, 2, 3) for body in cluster(scene.points, scene.moving, level, scene.constraints)]
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
