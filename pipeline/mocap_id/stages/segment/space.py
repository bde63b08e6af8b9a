"""Function of the stage segment for a trial in space: sorts the markers into the segments of a chain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.anatomy.landmark_names import SEGMENTS as LANDMARK_SEGMENTS
from mocap_id.anatomy.landmark_names import find_landmarks
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics import Constraints
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.kinematics.space.segmentation import SpatialSegmentation, segment_in_space
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import read_chain
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings
from mocap_id.stages.segment.bad_markers import bad_marker_notes, without_repeats
from mocap_id.stages.segment.hints import UNSURE, given_names, marker_constraints, search_rules
from mocap_id.stages.segment.known_segments import facts_without_search, skeleton_segments
from mocap_id.stages.trial_keys import get_landmark_labels
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.spatial_views import is_skeleton
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_LONGEST = 9
_ARM = ("thorax", "girdle", "upper_arm", "forearm", "hand")
_ARM_JOINTS = {"girdle": "clavicle", "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
_SHOWS = {name: segment for name, segment in LANDMARK_SEGMENTS.items() if name != "GH"} | dict.fromkeys(
    ("AC", "AA", "AI", "TS", "PC"), "girdle"
)
"""Segment that a landmark shows: the acromion and the scapula move with the thorax, or are a girdle of their own."""
_WHY = {
    "weakest": "two neighbouring segments could nearly be one",
    "runner-up": "one of the segments could nearly be two",
    "hidden-tip": "the last segment may be two that hardly move against each other",
    "joint": "two neighbouring segments hardly share a point",
    "base": "both ends of the chain move about as much, so either could be the base",
    "not-rigid": "the markers of a segment move against each other",
    "left-out": "many markers are on no segment",
    "one-joint": "only one joint turns, and segments that do not move against each other count as one. Name a trial in "
    "which all joints move as `calibration:`",
}


def segment_bodies(context: Context) -> Outputs:
    """Return segments.parquet of a trial in space."""
    settings: SegmentSettings = context.settings
    view = Trajectories(context.long("planar.parquet"))
    skeleton = is_skeleton(view.planar.facts)
    if skeleton and context.trial.calibration is None:
        return (skeleton_segments(view),)
    view = view if skeleton else without_repeats(view)
    if context.trial.calibration is not None:
        return (_calibrated(context, view),)
    labels = view.labels
    out = list(find_markers(labels, settings.ignore, "segment: ignore"))
    points = view.read_positions(np.arange(len(labels)))
    points[:, out] = np.nan
    hints = marker_constraints(labels, settings)
    rules = search_rules(settings, _LONGEST)

    def search(hints: Constraints) -> tuple[SpatialSegmentation, tuple[str, ...]]:
        found = segment_in_space(points, rules, hints, settings.frames)
        return found, _names(context, labels, found)

    found, names = search(hints)
    before = _before_the_arm(names, found)
    if len(before):
        points[:, before] = np.nan
        found, names = search(hints)
    strayed = _strayed_wrist(context, points, labels, found, names)
    if not hints.allow(np.array(strayed, dtype=np.int64)):  # the user puts them apart
        strayed = []
    if strayed:
        found, names = search(marker_constraints(labels, settings, [strayed]))
    if settings.names:
        names = given_names(settings.names, found.count)
    joint_names = _joint_names(names)
    why = list(found.reasons)
    for marker in strayed[1:]:
        why[marker] = f"on the segment of {labels[strayed[0]]}, as its name says; {why[marker]}"
    for marker in before:
        why[marker] = "on a body before the thorax: not on the chain of the arm"
    for marker in out:
        why[marker] = "left out by `segment: ignore`"
    columns = {
        "marker": np.array(labels, dtype=object),
        "segment": found.segment,
        "residual": found.residual,
        "reason": np.array(why, dtype=object),
    }
    facts = _facts(found, names, joint_names, labels) | {"bad_stretches": list(view.bad)}
    doubts = _unsure(found) or _without_forearm(names)
    return (Table(SEGMENTS, columns, facts, (*doubts, *_branches(found, labels), *bad_marker_notes(view.bad))),)


def _strayed_wrist(
    context: Context, points: FloatArray, labels: Sequence[str], found: SpatialSegmentation, names: Sequence[str]
) -> list[int]:
    """Return a marker of the forearm and the wrist's landmarks that were assigned to the hand; or nothing.

    If the wrist hardly turns, only their names show that they belong to the forearm.
    """
    if context.settings.names or not _splits_arm(names):
        return []
    tip = names.index("forearm")
    named = find_landmarks(labels, get_landmark_labels(context.trial), context.trial.side).markers
    wrist = [m for name, m in named.items() if _SHOWS.get(name) == "forearm" and found.segment[m] == tip]
    before = np.flatnonzero(found.segment == tip - 1)
    away = np.linalg.norm(points[:, before] - points[:, wrist].mean(axis=1, keepdims=True), axis=2)
    return [int(before[np.argmax(np.nan_to_num(np.nanmedian(away, axis=0), nan=-1.0))]), *wrist]


def _splits_arm(names: Sequence[str]) -> bool:
    """Return whether a segment is between upper arm and forearm."""
    return {"upper_arm", "forearm"} <= set(names) and names.index("forearm") > names.index("upper_arm") + 1


def _without_forearm(names: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution if a segment without landmarks is between upper arm and forearm."""
    if not _splits_arm(names):
        return ()
    return (
        Reason(
            "segments-unsure",
            "the segments are doubtful: a segment without landmarks is between those of the elbow and those of the "
            "wrist. Check the skeleton and the names of the landmarks; if the segments are wrong, set `segment: "
            "{count: …}`, or name markers that are `together` or `apart`, or markers to `ignore`.",
        ),
    )


def _names(context: Context, labels: Sequence[str], found: SpatialSegmentation) -> tuple[str, ...]:
    """Return names of the segments: those of an arm where its landmarks are, in the arm's order."""
    named = find_landmarks(labels, get_landmark_labels(context.trial), context.trial.side)
    counts: Counter[tuple[str, int]] = Counter()
    for landmark, marker in named.markers.items():
        if found.segment[marker] >= 0 and landmark in _SHOWS:
            counts[_SHOWS[landmark], int(found.segment[marker])] += 1
    place: dict[str, int] = {}
    for (name, k), _ in counts.most_common():
        if name not in place and k not in place.values():
            place[name] = k
    if "forearm" in place and "hand" not in place and place["forearm"] == found.count - 2:
        place["hand"] = found.count - 1
    order = [place[name] for name in _ARM if name in place]
    if not {"thorax", "upper_arm"} <= place.keys() or order != sorted(order):
        place = {}
    names = {k: name for name, k in place.items()}
    return tuple(names.get(k, "base" if k == 0 else f"segment_{k}") for k in range(found.count))


def _before_the_arm(names: Sequence[str], found: SpatialSegmentation) -> IntArray:
    """Return the markers of bodies before the thorax, such as a chair, which are no segments of the arm."""
    first = names.index("thorax") if "thorax" in names else 0
    return np.flatnonzero((found.segment >= 0) & (found.segment < first))


def _joint_names(names: Sequence[str]) -> list[str]:
    """Return names of the joints; joint k leads to segment k."""
    return [_ARM_JOINTS.get(name, f"joint {k}") for k, name in enumerate(names[1:], start=1)]


def _facts(
    found: SpatialSegmentation, names: Sequence[str], joint_names: Sequence[str], labels: Sequence[str]
) -> dict[str, Any]:
    """Return the facts of segments.parquet; those of the plane alone are empty."""
    return {
        "count": found.count,
        "names": list(names),
        "joint_names": list(joint_names),
        "parents": list(found.parents),
        "joint_markers": {},
        "links": None,
        "bad_stretches": [],
        "confidence": found.confidence.value,
        "against": dict(found.confidence.against),
        "planarity": found.planarity,
        "moving_base": found.moving_base,
        "joint_confidences": list(found.confidence.joints),
        "joint_ratios": list(found.ratios),
        "joint_residuals_m": list(found.joint_residuals),
        "asymmetry_deg": [],
        "noise_floor_m": None,
        "static_gap": None,
        "hypotheses": [],
        "divisions": [
            {
                "parts": [[labels[m] for m in part] for part in each.parts],
                "evidence": each.evidence,
                "gain": each.gain,
                "chosen": each.chosen,
            }
            for each in found.hypotheses
        ],
    }


def _unsure(found: SpatialSegmentation) -> tuple[Reason, ...]:
    """Return a caution if the segments are more likely wrong than right, with the strongest evidence against them."""
    confidence = found.confidence
    if confidence.value >= UNSURE:
        return ()
    gravest = max(confidence.against, key=lambda evidence: confidence.against[evidence])
    return (
        Reason(
            "segments-unsure",
            f"the segments are doubtful: {_WHY[gravest]}. Check the skeleton; if it is wrong, set `segment: {{count: "
            "…}`, or name markers that are `together` or `apart`, or markers to `ignore`.",
            confidence.value,
            UNSURE,
        ),
    )


def _branches(found: SpatialSegmentation, labels: Sequence[str]) -> tuple[Reason, ...]:
    """Return a note about bodies that are not on the chain."""
    if not found.branches:
        return ()
    groups = "; ".join(", ".join(labels[m] for m in branch) for branch in found.branches)
    return (
        Reason(
            "branches-left-out",
            f"{len(found.branches)} bodies are on no segment of the chain, which has no branches: {groups}.",
            float(len(found.branches)),
            level="ok",
        ),
    )


def _calibrated(context: Context, view: Trajectories) -> Table:
    """Return the assignment of the calibration, for the markers that this trial has."""
    assert context.trial.calibration is not None
    settings: SegmentSettings = context.settings
    tree = read_chain(context.trial.calibration)
    local, owner = tree.numbers("markers/local", (-1, 3)), tree.integers("markers/segment")
    place = {label: k for k, label in enumerate(tree.texts("markers/name"))}
    out = find_markers(view.labels, settings.ignore, "segment: ignore")
    there = np.array([m for m, label in enumerate(view.labels) if label in place and m not in out], dtype=np.int64)
    segment = np.full(len(view.labels), -1, dtype=np.int64)
    segment[there] = owner[[place[view.labels[m]] for m in there]]
    residual = np.full(len(view.labels), np.nan)
    points, own = view.read_positions(there), local[[place[view.labels[m]] for m in there]]
    for k in range(int(owner.max()) + 1):
        here = segment[there] == k
        residual[there[here]] = _residuals(points[:, here], own[here])
    names = tree.texts("segments/name")
    why = [
        f"as in the calibration: {names[segment[m]].replace('_', ' ')}" if segment[m] >= 0 else "not in the calibration"
        for m in range(len(view.labels))
    ]
    columns = {
        "marker": np.array(view.labels, dtype=object),
        "segment": segment,
        "residual": residual,
        "reason": np.array(why, dtype=object),
    }
    facts = facts_without_search(names, _joint_names(names), tree.integers("joints/parent").tolist())
    doubts = _moved(view.labels, residual) + _few(names, segment)
    return Table(SEGMENTS, columns, facts | {"bad_stretches": list(view.bad)}, (*doubts, *bad_marker_notes(view.bad)))


_MOVED = 0.02
"""rms distance of a marker from its place in the calibration, m, beyond which it counts as another marker."""


def _residuals(points: FloatArray, local: FloatArray) -> FloatArray:
    """Return the rms distance of markers (F, k, 3) from their places on a rigid body (k, 3), m."""
    if points.shape[1] < 3:
        return np.full(points.shape[1], np.nan)
    rotation, origin, _ = rigid_poses(points, local)
    off = points - origin[:, None] - np.einsum("fij,kj->fki", rotation, local)
    square = np.sum(off**2, axis=2)
    seen = np.isfinite(square)
    return np.asarray(np.sqrt(np.where(seen, square, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)))


def _moved(labels: Sequence[str], residual: FloatArray) -> tuple[Reason, ...]:
    """Return a caution for markers that are not where the calibration has them."""
    far = np.flatnonzero(residual > _MOVED)
    if not len(far):
        return ()
    worst = int(far[np.argmax(residual[far])])
    return (
        Reason(
            "calibration-differs",
            f"{', '.join(labels[int(m)] for m in far)} are not where the calibration has them ({labels[worst]}: "
            f"{1e3 * residual[worst]:.0f} mm rms away): markers were moved or exchanged between the trials. Use a "
            "calibration with the same markers, or leave them out with `segment: {ignore: …}`.",
            float(residual[worst]),
            _MOVED,
        ),
    )


def _few(names: Sequence[str], segment: IntArray) -> tuple[Reason, ...]:
    """Return a caution for segments of the calibration with fewer than three markers in this trial."""
    few = [name for k, name in enumerate(names) if np.count_nonzero(segment == k) < 3]
    if not few:
        return ()
    return (
        Reason(
            "calibration-differs",
            f"fewer than three markers of the calibration's {', '.join(few)} are in this trial; the poses of these "
            "segments are uncertain. Use the same marker labels in both trials.",
        ),
    )
