"""Comparison of the segments found from the motion with the marker names of known marker sets."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mocap_id.arrays import IntArray
from mocap_id.protocols.body_names import GROUND
from mocap_id.verdict import Reason

_TRUNK = ("pelvis", "torso", "trunk")
_PLUG_IN_GAIT = {
    ("foot",): ("HEE", "HEEL", "TOE", "TOES", "MT1", "MT2", "MT5", "CAL", "CALC"),
    ("foot", "shank"): ("ANK", "ANKLE", "MED", "MMA", "LMA"),
    ("shank",): ("TIB", "SHA", "SHANK"),
    ("shank", "thigh"): ("KNE", "KNEE", "MKN", "KNM"),
    ("thigh",): ("THI", "THIGH"),
    ("thigh", *_TRUNK): ("GTR", "TROCH"),
    _TRUNK: ("ASI", "ASIS", "PSI", "PSIS", "SACR", "SHO", "SHOULDER", "C7", "T10", "CLAV", "STRN", "RBAK"),
}
"""Names in Plug-in Gait and usual synonyms, without the side, by the segments on which such a marker may be."""
_SEGMENTS_OF = {name: segments for segments, names in _PLUG_IN_GAIT.items() for name in names}
_SIDES = re.compile(r"^(LEFT|RIGHT|L|R)[_. ]?|[_. ](LEFT|RIGHT|L|R)$")
_LEAST = 5  # smallest number of different known names that indicates a known marker set
_SURE = 0.8  # confidence above which a contradiction is only a note
_LISTED = 6  # largest number of markers named in the message


def check_marker_names(
    labels: Sequence[str], segment: IntArray, names: Sequence[str], confidence: float
) -> tuple[Reason, ...]:
    """Return a note, or a caution if the segments are not certain, about markers whose names belong to other segments.

    Parameters
    ----------
    labels : sequence of str, length M
        Labels of the markers.
    segment : (M,) int array
        Segment of each marker, found from the motion; -1 if it is on no segment.
    names : sequence of str
        Names of the segments in the protocol.
    confidence : float
        Probability that the segments are right.
    """
    expected = [[name for name in _find_segments(label) if name in names] for label in labels]
    known = {_remove_side(label) for label in labels if _find_segments(label)}
    if len(known) < _LEAST or "shank" not in names:
        return ()
    wrong = [
        f"{label} is on the {names[k]}, but by its name on the {' or '.join(segments)}"
        for label, segments, k in zip(labels, expected, segment, strict=True)
        if k >= 0 and segments and names[k] not in (*segments, GROUND)
    ]
    if not wrong:
        return ()
    rest = f"; and {len(wrong) - _LISTED} more" if len(wrong) > _LISTED else ""
    return (
        Reason(
            "names-contradict",
            f"the names of a known marker set contradict the motion: {'; '.join(wrong[:_LISTED])}{rest}. The motion "
            "was used. Check the labels in the camera software; if the segments are wrong, set `segment: {count: …}`.",
            float(len(wrong)),
            level="ok" if confidence >= _SURE else "caution",
        ),
    )


def _find_segments(label: str) -> tuple[str, ...]:
    """Return the segments on which a marker with this label may be; empty for an unknown label."""
    return _SEGMENTS_OF.get(label.upper(), _SEGMENTS_OF.get(_remove_side(label), ()))


def _remove_side(label: str) -> str:
    """Return a label without its side, in capitals."""
    return _SIDES.sub("", label.upper())
