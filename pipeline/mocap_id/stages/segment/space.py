"""Function of the stage segment in space, which assigns the markers to the segments of a chain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mocap_id.anatomy.landmarks import SEGMENTS as LANDMARK_SEGMENTS
from mocap_id.anatomy.landmarks import find_landmarks
from mocap_id.arrays import FloatArray
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.kinematics.space.segmentation import SpatialSegmentation, segment_in_space
from mocap_id.stages.base import Context, Findings, Outputs, find_markers
from mocap_id.stages.calibration_trial import read_chain
from mocap_id.stages.segment import SegmentSettings, hints
from mocap_id.stages.segment.plane import explain_bad_markers, remove_repeats
from mocap_id.stages.trial_keys import Calibration, get_landmark_labels
from mocap_id.store import Table
from mocap_id.store.artefacts import Trajectories, is_skeleton

_LONGEST = 9  # largest number of segments
_ARM = ("thorax", "girdle", "upper_arm", "forearm", "hand")
_ARM_JOINTS = {"girdle": "clavicle", "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
# segment on which each landmark is, if the acromion and the scapula do not move with the thorax
_SHOWS = {name: segment for name, segment in LANDMARK_SEGMENTS.items() if name != "GH"} | dict.fromkeys(
    ("AC", "AA", "AI", "TS", "PC"), "girdle"
)
# texts about evidence against the segments, by kind
_WHY = {
    "weakest": "two neighbouring segments could nearly be one",
    "runner-up": "one of the segments could nearly be two",
    "hidden-tip": "the last segment may be two that hardly move against each other",
    "joint": "two neighbouring segments have no point in common that could be their joint",
    "base": "both ends of the chain move about as much, so either could be the base",
    "not-rigid": "the markers of a segment move against each other",
    "left-out": "many markers are on no segment",
    "one-joint": "only one joint rotates, and segments that do not move against each other count as one. Name a trial "
    "in which all joints move as `calibration:`",
}
# largest rms distance of a marker from its position in the calibration, m; beyond it, this is another marker
_MOVED = 0.02


def segment_bodies(context: Context) -> Outputs:
    """Return segments.parquet of a trial in space."""
    settings: SegmentSettings = context.settings
    view = Trajectories(context.long("planar.parquet"))
    skeleton, calibration = is_skeleton(view.planar.facts), context.trial.calibration
    if skeleton and calibration is None:
        return (hints.assign_skeleton(view),)
    view = view if skeleton else remove_repeats(view)
    if calibration is not None:
        return (_use_calibration(calibration, settings, view),)
    labels = view.labels
    left_out = list(find_markers(labels, settings.ignore, "segment: ignore"))
    points = view.read_positions(np.arange(len(labels)))
    points[:, left_out] = np.nan
    constraints = hints.make_constraints(labels, settings)
    rules = hints.limit_search(settings, _LONGEST)

    def search(constraints: Constraints) -> tuple[SpatialSegmentation, tuple[str, ...]]:
        found = segment_in_space(points, rules, constraints, settings.frames)
        return found, _name_segments(context, labels, found)

    found, names = search(constraints)
    first = names.index("thorax") if "thorax" in names else 0
    before = np.flatnonzero((found.segment >= 0) & (found.segment < first))  # for example a chair
    if len(before):
        points[:, before] = np.nan
        found, names = search(constraints)
    strayed = _find_strayed_wrist(context, points, labels, found, names)
    if not constraints.allow(np.array(strayed, dtype=np.int64)):  # the hint `apart` separates them
        strayed = []
    if strayed:
        found, names = search(hints.make_constraints(labels, settings, [strayed]))
    if settings.names:
        names = hints.check_names(settings.names, found.count)
    why = list(found.reasons)
    for marker in strayed[1:]:
        why[marker] = f"on the segment of {labels[strayed[0]]}, because of its name; {why[marker]}"
    for marker in before.tolist():
        why[marker] = "on a body before the thorax: not on the chain of the arm"
    for marker in left_out:
        why[marker] = "left out by `segment: ignore`"
    out, confidence = hints.describe_chain(names, _name_joints(names), range(found.count - 1)), found.confidence
    out.fact(
        confidence=confidence.value,
        against=dict(confidence.against),
        planarity=found.planarity,
        moving_base=found.moving_base,
        joint_confidences=list(confidence.joints),
        joint_ratios=[joint.ratio for joint in found.joints],
        joint_residuals_m=[joint.residual for joint in found.joints],
        divisions=[
            {
                "parts": [[labels[m] for m in part.markers] for part in each.parts],
                "evidence": each.evidence,
                "gain": each.gain,
                "chosen": made,
            }
            for each, made in found.divisions
        ],
        bad_stretches=list(view.bad),
    )
    _explain_doubts(out, found, names)
    if found.branches:
        groups = "; ".join(", ".join(labels[m] for m in branch) for branch in found.branches)
        text = f"{len(found.branches)} rigid bodies were left out, because the chain cannot have branches: {groups}."
        out.say("branches-left-out", text, float(len(found.branches)), level="ok")
    explain_bad_markers(out, view.bad)
    return (hints.make_table(out, labels, found.segment, found.residual, why),)


def _find_strayed_wrist(
    context: Context, points: FloatArray, labels: Sequence[str], found: SpatialSegmentation, names: Sequence[str]
) -> list[int]:
    """Return a marker of a segment that separates elbow and wrist, and the wrist's landmarks; an empty list without it.

    If the wrist hardly rotates, only the names of these landmarks indicate that all these markers are on the forearm.
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


def _name_segments(context: Context, labels: Sequence[str], found: SpatialSegmentation) -> tuple[str, ...]:
    """Return the names of the segments: anatomical if the landmarks follow the order of an arm, else numbered."""
    named = find_landmarks(labels, get_landmark_labels(context.trial), context.trial.side)
    counts: Counter[tuple[str, int]] = Counter()
    for landmark, marker in named.markers.items():
        if found.segment[marker] >= 0 and landmark in _SHOWS:
            counts[_SHOWS[landmark], int(found.segment[marker])] += 1
    number: dict[str, int] = {}
    for (name, k), _ in counts.most_common():
        if name not in number and k not in number.values():
            number[name] = k
    if "forearm" in number and "hand" not in number and number["forearm"] == found.count - 2:
        number["hand"] = found.count - 1
    order = [number[name] for name in _ARM if name in number]
    if not {"thorax", "upper_arm"} <= number.keys() or order != sorted(order):
        number = {}
    names = {k: name for name, k in number.items()}
    return tuple(names.get(k, "base" if k == 0 else f"segment_{k}") for k in range(found.count))


def _name_joints(names: Sequence[str]) -> list[str]:
    """Return the name of the joint before each segment except the base; ``names`` are the names of the segments."""
    return [_ARM_JOINTS.get(name, f"joint {k}") for k, name in enumerate(names[1:], start=1)]


def _explain_doubts(out: Findings, found: SpatialSegmentation, names: Sequence[str]) -> None:
    """Add a caution if the segments are more likely wrong than right, or if a segment splits the arm."""
    confidence = found.confidence
    if confidence.value < hints.UNSURE:
        gravest = max(confidence.against, key=lambda evidence: confidence.against[evidence])
        out.say("segments-unsure", hints.describe_doubt(_WHY[gravest]), confidence.value, hints.UNSURE)
    elif _splits_arm(names):
        why = "a segment without landmarks is between the landmarks of elbow and wrist"
        out.say("segments-unsure", hints.describe_doubt(why))


def _use_calibration(calibration: Calibration, settings: SegmentSettings, view: Trajectories) -> Table:
    """Return segments.parquet with the segments of the calibration, for the markers of this trial."""
    tree, labels = read_chain(calibration), view.labels
    local, owner = tree.numbers("markers/local", (-1, 3)), tree.integers("markers/segment")
    index = {label: k for k, label in enumerate(tree.texts("markers/name"))}
    ignored = find_markers(labels, settings.ignore, "segment: ignore")
    known = np.array([m for m, label in enumerate(labels) if label in index and m not in ignored], dtype=np.int64)
    of_calibration = [index[labels[m]] for m in known]
    segment = np.full(len(labels), -1, dtype=np.int64)
    segment[known] = owner[of_calibration]
    # rms distance of every marker from its position on the body; unknown with fewer than three markers
    residual = np.full(len(labels), np.nan)
    points, own = view.read_positions(known), local[of_calibration]
    for k in range(int(owner.max()) + 1):
        here = segment[known] == k
        if np.count_nonzero(here) >= 3:
            there, fixed = points[:, here], own[here]
            rotation, origin, _ = rigid_poses(there, fixed)
            off = there - origin[:, None] - np.einsum("fij,kj->fki", rotation, fixed)
            square = np.sum(off**2, axis=2)
            seen = np.isfinite(square)
            mean = np.where(seen, square, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
            residual[known[here]] = np.sqrt(mean)
    names = tree.texts("segments/name")
    why = [
        f"as in the calibration: {names[k].replace('_', ' ')}" if k >= 0 else "not in the calibration" for k in segment
    ]
    out = hints.describe_chain(names, _name_joints(names), tree.integers("joints/parent").tolist())
    out.fact(bad_stretches=list(view.bad))
    far = np.flatnonzero(residual > _MOVED)
    if len(far):
        worst = int(far[np.argmax(residual[far])])
        text = (
            f"{', '.join(labels[int(m)] for m in far)} are not at their positions in the calibration ({labels[worst]}: "
            f"{1e3 * residual[worst]:.0f} mm rms away): markers were moved or exchanged between the trials. Use a "
            "calibration with the same markers, or leave them out with `segment: {ignore: …}`."
        )
        out.say("calibration-differs", text, float(residual[worst]), _MOVED)
    few = [name for k, name in enumerate(names) if np.count_nonzero(segment == k) < 3]
    if few:
        text = (
            f"this trial has fewer than three markers on {', '.join(few)} of the calibration; the poses of these "
            "segments are uncertain. Use the same marker labels in both trials."
        )
        out.say("calibration-differs", text)
    explain_bad_markers(out, view.bad)
    return hints.make_table(out, labels, segment, residual, why)
