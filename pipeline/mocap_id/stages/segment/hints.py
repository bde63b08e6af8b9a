"""Segments that are known or constrained: settings, names of marker sets, skeletons, calibration."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from mocap_id.anatomy.landmarks import ARM, TRUNK, find_roles
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import ConfigError
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.protocols.body_names import GROUND
from mocap_id.stages.base import Context, Findings, Outputs, find_markers
from mocap_id.stages.calibration_trial import get_calibration, read_chain
from mocap_id.stages.segment import SegmentSettings
from mocap_id.store import Table
from mocap_id.store.artefacts import Trajectories
from mocap_id.store.provenance import SEGMENTS

UNSURE = 0.5
"""Confidence below which there is a caution."""


def limit_search(settings: SegmentSettings, longest: int) -> SegmentationRules:
    """Return the limits of the search for segments; ``longest`` is the largest number of segments of the protocol."""
    return SegmentationRules(
        still_limit=settings.still_limit_m,
        min_arc=float(np.radians(settings.min_arc_deg)),
        max_residual=settings.max_joint_residual_m,
        max_body_residual=settings.max_body_residual_m,
        count=settings.count,
        longest=settings.count or longest,
    )


def make_constraints(
    labels: tuple[str, ...], settings: SegmentSettings, known: Sequence[list[int]] = ()
) -> Constraints:
    """Return the hints `together` and `apart` with marker indices; each group in ``known`` is also on one segment."""
    together = [*(find_markers(labels, group, "segment: together") for group in settings.together), *known]
    apart = [find_markers(labels, group, "segment: apart") for group in settings.apart]
    constraints = Constraints.of(len(labels), together, apart)
    if constraints.contradictory.any():
        marker = labels[int(np.argmax(constraints.contradictory))]
        raise ConfigError(
            f"segment: `together` and `apart` contradict each other: one joins {marker} to a marker, the other "
            "separates these two"
        )
    return constraints


def check_names(names: tuple[str, ...], count: int) -> tuple[str, ...]:
    """Return the user's names, which must be as many as the segments."""
    if len(names) != count:
        raise ConfigError(
            f"segment: names: there are {len(names)} names for {count} segments ({', '.join(names)}); "
            "give one name for each segment, base first, or also set `segment: {count: …}`"
        )
    return names


def describe_doubt(why: str) -> str:
    """Return the caution that the segments are doubtful; ``why`` is the strongest evidence against them."""
    return (
        f"the segments are doubtful: {why}. Check the skeleton; if it is wrong, set `segment: {{count: …}}`, or "
        "name markers that are `together` or `apart`, or markers to `ignore`."
    )


_TRUNK = ("pelvis", "torso", "trunk")
# names in Plug-in Gait and usual synonyms, without the side, by the segments on which such a marker may be
_PLUG_IN_GAIT = {
    ("foot",): ("HEE", "HEEL", "TOE", "TOES", "MT1", "MT2", "MT5", "CAL", "CALC"),
    ("foot", "shank"): ("ANK", "ANKLE", "MED", "MMA", "LMA"),
    ("shank",): ("TIB", "SHA", "SHANK"),
    ("shank", "thigh"): ("KNE", "KNEE", "MKN", "KNM"),
    ("thigh",): ("THI", "THIGH"),
    ("thigh", *_TRUNK): ("GTR", "TROCH"),
    _TRUNK: ("ASI", "ASIS", "PSI", "PSIS", "SACR", "SHO", "SHOULDER", "C7", "T10", "CLAV", "STRN", "RBAK"),
}
_SEGMENTS_OF = {name: segments for segments, names in _PLUG_IN_GAIT.items() for name in names}
_SIDES = re.compile(r"^(LEFT|RIGHT|L|R)[_. ]?|[_. ](LEFT|RIGHT|L|R)$")
_LEAST = 5  # smallest number of different known names that indicates a known marker set
_SURE = 0.8  # confidence above which a contradiction is only a note
_LISTED = 6  # largest number of markers named in the message


def check_marker_names(
    out: Findings, labels: Sequence[str], segment: IntArray, names: Sequence[str], confidence: float
) -> None:
    """Add a note, or a caution if the segments are not certain, about markers whose names belong to other segments.

    ``segment`` (M,) is the segment of each marker, found from the motion; -1 if it is on no segment. ``names`` are
    those of the segments in the protocol, and ``confidence`` is the probability that the segments are right.
    """
    plain = [_SIDES.sub("", label.upper()) for label in labels]
    # segments on which a marker with this label may be; none for an unknown label
    may_be = [
        _SEGMENTS_OF.get(label.upper(), _SEGMENTS_OF.get(name, ())) for label, name in zip(labels, plain, strict=True)
    ]
    known = {name for name, segments in zip(plain, may_be, strict=True) if segments}
    if len(known) < _LEAST or "shank" not in names:
        return
    wrong = []
    for label, segments, k in zip(labels, may_be, segment, strict=True):
        expected = [name for name in segments if name in names]
        if k >= 0 and expected and names[k] not in (*expected, GROUND):
            wrong.append(f"{label} is on the {names[k]}, but by its name on the {' or '.join(expected)}")
    if wrong:
        rest = f"; and {len(wrong) - _LISTED} more" if len(wrong) > _LISTED else ""
        out.say(
            "names-contradict",
            f"the names of a known marker set contradict the motion: {'; '.join(wrong[:_LISTED])}{rest}. The motion "
            "was used. Check the labels in the camera software; if the segments are wrong, set `segment: {count: …}`.",
            float(len(wrong)),
            level="ok" if confidence >= _SURE else "caution",
        )


_NAMES = ("thorax", "upper_arm", "forearm", "hand")
_JOINTS = ("shoulder", "elbow", "wrist")


def assign_skeleton(view: Trajectories) -> Table:
    """Return segments.parquet for a skeleton: the trunk is the base, and each joint of the arm ends a segment."""
    roles = find_roles(view.labels, view.planar.facts["side"])
    segment = np.full(len(view.labels), -1, dtype=np.int64)
    limbs = [role for role in ARM if role in roles]
    for role in roles.keys() & {*TRUNK, *limbs}:
        segment[roles[role]] = limbs.index(role) + 1 if role in limbs else 0
    why = ["" if k >= 0 else "not a joint of the trunk or of this arm" for k in segment]
    out = describe_chain(_NAMES[: len(limbs) + 1], _JOINTS[: len(limbs)], range(len(limbs)))
    return make_table(out, view.labels, segment, np.where(segment >= 0, 0.0, np.nan), why)


def assign_by_calibration(context: Context) -> Outputs:
    """Return segments.parquet for a trial without markers, with the markers and segments of the calibration."""
    tree = read_chain(get_calibration(context.trial))
    names = tree.texts("segments/name")
    segment = tree.integers("markers/segment")
    why = [f"as in the calibration: {names[k]}" for k in segment]
    out = describe_chain(names, tree.texts("joints/name"), tree.integers("joints/parent").tolist())
    return (make_table(out, tree.texts("markers/name"), segment, np.full(len(segment), np.nan), why),)


def make_table(
    out: Findings, labels: Sequence[str], segment: IntArray, residual: FloatArray, why: Sequence[str]
) -> Table:
    """Return segments.parquet; ``residual``, m, and ``why`` belong to each marker on its segment."""
    columns = {
        "marker": np.array(labels, dtype=object),
        "segment": segment,
        "residual": residual,
        "reason": np.array(why, dtype=object),
    }
    return Table(SEGMENTS, columns, out.facts, tuple(out.reasons))


def describe_chain(names: Sequence[str], joint_names: Sequence[str], parents: Sequence[int]) -> Findings:
    """Return the facts of a chain; those about evidence from a search are empty or None.

    ``parents`` are the numbers of the segments before the joints.
    """
    out = Findings()
    out.fact(
        count=len(names),
        names=list(names),
        joint_names=list(joint_names),
        parents=list(parents),
        joint_markers={},
        links=None,
        bad_stretches=[],
        confidence=None,
        against={},
        planarity=None,
        joint_confidences=[],
        joint_ratios=[],
        asymmetry_deg=[],
        noise_floor_m=None,
        static_gap=None,
        hypotheses=[],
        divisions=[],
    )
    return out
