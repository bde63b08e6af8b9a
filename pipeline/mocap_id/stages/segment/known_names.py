"""Names of known marker sets, compared with the segments that the motion shows. The motion decides."""

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
"""Segments on which a marker may be, by the names of Plug-in Gait and usual synonyms, without the side."""
_SEGMENTS_OF = {name: segments for segments, names in _PLUG_IN_GAIT.items() for name in names}
_SIDES = re.compile(r"^(LEFT|RIGHT|L|R)[_. ]?|[_. ](LEFT|RIGHT|L|R)$")
_LEAST = 5  # different names by which a set is known
_SURE = 0.8  # confidence from which a contradiction is a note
_LISTED = 6


def contradicted_names(
    labels: Sequence[str], segment: IntArray, names: Sequence[str], confidence: float
) -> tuple[Reason, ...]:
    """Return a note, or a caution if the segments are not sure, about markers on another segment than their names say.

    Parameters
    ----------
    labels : sequence of str, length M
    segment : (M,) int array
        Segment of each marker by the motion; -1 = none.
    names : sequence of str
        Names of the segments by the protocol.
    confidence : float
        Probability that the segments are right.
    """
    places = [[name for name in _segments_of(label) if name in names] for label in labels]
    known = {_plain(label) for label in labels if _segments_of(label)}
    if len(known) < _LEAST or "shank" not in names:
        return ()
    wrong = [
        f"{label} is on the {names[k]}, its name says {' or '.join(place)}"
        for label, place, k in zip(labels, places, segment, strict=True)
        if k >= 0 and place and names[k] not in (*place, GROUND)
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


def _segments_of(label: str) -> tuple[str, ...]:
    return _SEGMENTS_OF.get(label.upper(), _SEGMENTS_OF.get(_plain(label), ()))


def _plain(label: str) -> str:
    """Return a name without its side, in capitals."""
    return _SIDES.sub("", label.upper())
