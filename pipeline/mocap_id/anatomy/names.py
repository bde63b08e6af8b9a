"""Recognition of landmarks of the upper limb and of skeleton joints by their names.

Separators, capitals and the name of a subject are ignored. A landmark of an arm has its side before or after its name:
``REL``, ``EL_R``, ``Subject:right lateral epicondyle``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from mocap_id.errors import RecordingError
from mocap_id.verdict import Reason

Side: TypeAlias = Literal["right", "left"]

MIDDLE = {
    "IJ": "ij clav clavicle sternumnotch sternalnotch jugularnotch incisurajugularis suprasternale suprasternalnotch"
    " manubrium",
    "PX": "px xiph xiphoid xiphoidprocess xyph xyphoid xpro xp processusxiphoideus",
    "C7": "c7 cv7 vertebrac7 c7spinalprocess c7sp",
    "T8": "t8 th8 tv8 vertebrat8 t8spinalprocess t8sp",
}
"""Spellings of landmarks of the thorax that have no side."""

SIDED = {
    "AC": "ac acj acr acrom acromion acromium acromioclavicular sho acromionedge",
    "EL": "el lel hle elb elbl elblat elbowlat elbowlateral lateralelbow latelbow latepi latepicondyle"
    " lateralepicondyle epl epicondyluslateralis armlatepicondyle lee lhum elbowouter outerelbow",
    "EM": "em mel hme elbm elbmed elbowmed elbowmedial medialelbow medelbow medepi medepicondyle medialepicondyle epm"
    " epicondylusmedialis armmedepicondyle mee mhum elbowinner innerelbow",
    "RS": "rs rsp wra wrr wrl wristrad wristradius wristradial radialstyloid radial radius radstyl rad styloidradius"
    " wristlat wristlateral latwrist lw thumbwrist",
    "US": "us usp wrb wru wrm wristuln wristulna wristulnar ulnarstyloid ulnar ulna ulnstyl uln styloidulna wristmed"
    " wristmedial medwrist mw",
    "GH": "gh ghjc glenohumeral shoulderjointcentre shoulderjointcenter gu",
    "AA": "aa angulusacromialis acromialangle scapaa",
    "AI": "ai angulusinferior inferiorangle scapai",
    "TS": "ts trigonumspinae trigonumscapulae scapts",
    "PC": "pc processuscoracoideus coracoid",
    "MC3": "mc3 metacarpal3",
    "MCP2": "mcp2 mc2 hmc2 hm2 hmcp2 metacarpal2 knuckle2",
    "MCP3": "mcp3 hm3 hmcp3 knuckle3",
    "MCP5": "mcp5 mc5 hm5 hmc5 hmcp5 metacarpal5 knuckle5",
}
"""Spellings of landmarks of one arm, without the side."""

_DOUBTFUL = {
    "IJ": "sternum sternumtop ster",
    "PX": "strn sternumlow lowersternum",
    "T8": "t10 th10",
    "AC": "shoulder",
    "EL": "elbow",
}
"""Spellings that labs use for more than one landmark. They are accepted, with a caution, if no better name is found."""

SEGMENTS = {
    **dict.fromkeys(("IJ", "PX", "C7", "T8", "AC", "AA", "AI", "TS", "PC"), "thorax"),
    **dict.fromkeys(("EL", "EM", "GH"), "upper_arm"),
    **dict.fromkeys(("RS", "US"), "forearm"),
    **dict.fromkeys(("MC3", "MCP2", "MCP3", "MCP5"), "hand"),
}
"""Segment of each landmark. The acromion and the scapula are on the shoulder girdle, which follows the thorax."""

_SIDES: tuple[tuple[Side, tuple[str, ...]], ...] = (("right", ("right", "rt", "r")), ("left", ("left", "lt", "l")))


@dataclass(frozen=True)
class NamedLandmarks:
    """Landmarks that were recognised by the names of markers."""

    markers: dict[str, int]  # landmark to the number of its marker
    side: Side | None  # arm of the landmarks; None if no name has a side
    reasons: tuple[Reason, ...]  # cautions for doubtful names


def find_landmarks(
    labels: Sequence[str], given: Mapping[str, str] | None = None, side: Side | None = None
) -> NamedLandmarks:
    """Find the landmarks among the names of all markers of a recording.

    ``given`` are the marker names of landmarks that the user has set; they have priority over recognised names.
    ``side`` is the arm to use: by default the arm with more landmarks, and the right one if both have the same number.
    A RecordingError is raised if a given landmark or marker does not exist, or if all landmarks of an arm are on the
    arm that ``side`` excludes.

    Examples
    --------
    >>> find_landmarks(["Anna:CLAV", "Anna:RELB", "Anna:RELBM", "Anna:RUPA"]).markers
    {'IJ': 0, 'EL': 1, 'EM': 2}
    """
    readings = [reading for marker, label in enumerate(labels) for reading in _read_label(label, marker)]
    reasons: list[Reason] = []

    # the arm
    counts: dict[Side, int] = {each: len({r.landmark for r in readings if r.side == each}) for each, _ in _SIDES}
    chosen = side
    if side is not None:
        other: Side = "left" if side == "right" else "right"
        if counts[side] == 0 and counts[other] > 0:
            names = ", ".join(labels[r.marker] for r in readings if r.side == other)
            raise RecordingError(
                f"side: {side}, but the landmarks of the recording are of the {other} arm ({names}); "
                f"write side: {other}, or name the landmarks under `landmarks:`"
            )
    elif any(counts.values()):
        chosen = "left" if counts["left"] > counts["right"] else "right"
        if min(counts.values()) > 1:
            message = (
                f"the recording names landmarks of both arms ({counts['right']} of the right, {counts['left']} of the "
                f"left); the {chosen} arm was used. Write `side: right` or `side: left` to choose"
            )
            reasons.append(Reason("two-arms", message))

    # the landmarks that the user has set
    plain = [label.rsplit(":", 1)[-1] for label in labels]
    fixed: dict[str, int] = {}
    for name, label in (given or {}).items():
        if name not in SEGMENTS:
            raise RecordingError(f"landmarks: {name} is not a landmark; expected one of {', '.join(SEGMENTS)}")
        hits = [i for i, (full, part) in enumerate(zip(labels, plain, strict=True)) if label in (full, part)]
        if len(hits) != 1:
            what = "several markers are called" if hits else "no marker is called"
            raise RecordingError(f"landmarks: {name}: {what} {label!r}; the markers are {', '.join(labels)}")
        fixed[name] = hits[0]

    # all other landmarks, by the best name
    markers: dict[str, int] = {}
    for name in (*MIDDLE, *SIDED):
        if name in fixed:
            markers[name] = fixed[name]
            continue
        fitting = [r for r in readings if r.landmark == name and (name in MIDDLE or r.side in (chosen, None))]
        if not fitting:
            continue
        order = min((r.rank, r.side is None and chosen is not None) for r in fitting)
        best = [r for r in fitting if (r.rank, r.side is None and chosen is not None) == order]
        names = " and ".join(labels[r.marker] for r in best)
        if len(best) > 1:
            message = (
                f"the marker names {names} all fit the landmark {name}, so none was used. Name one of them, such as "
                f"`landmarks: {{{name}: {labels[best[0].marker]}}}`"
            )
            reasons.append(Reason("landmark-ambiguous", message))
            continue
        if best[0].rank == 2:
            message = (
                f"the marker {names} was used as the landmark {name}, but this name is also used for other points. "
                f"Write landmarks: {{{name}: {names}}} to confirm it, or give the correct marker"
            )
            reasons.append(Reason("landmark-doubtful", message))
        markers[name] = best[0].marker
    return NamedLandmarks(markers, chosen, tuple(reasons))


@dataclass(frozen=True)
class _Reading:
    """Interpretation of a marker's name as a landmark."""

    landmark: str
    side: Side | None
    marker: int
    rank: int  # 0: name used by the ISB, 1: another spelling, 2: doubtful spelling


def _read_label(label: str, marker: int) -> list[_Reading]:
    """Return all interpretations of a marker's name."""
    text = label.rsplit(":", 1)[-1]
    words = [word for word in re.split(r"[^A-Za-z0-9]+", text) if word]
    if not words:
        return []
    bare = "".join(words).lower()
    # Possible splits into side and rest: side at the start, no side, then side at the end. Some programs write the
    # letter p, for point, before every name.
    before: list[tuple[Side | None, str]] = []
    behind: list[tuple[Side | None, str]] = []
    for side, marks in _SIDES:
        for mark in marks:
            before += [(side, bare[len(lead) :]) for lead in (mark, "p" + mark) if bare.startswith(lead)]
            apart = len(mark) > 2 or text[-1:].isupper() or re.search(rf"[^A-Za-z0-9]{mark}$", text) is not None
            if bare.endswith(mark) and apart:
                behind.append((side, bare[: -len(mark)]))
    for own, rest in [*before, (None, bare), *([(None, bare[1:])] if bare.startswith("p") else []), *behind]:
        hits = [hit for hit in _BY_NAME.get(rest, []) if own is None or hit[0] in SIDED]
        if hits:
            return [_Reading(name, own if name in SIDED else None, marker, rank) for name, rank in hits]
    return []


_BY_NAME: dict[str, list[tuple[str, int]]] = {}  # landmarks with each spelling, and its rank
for _table, _rank in ((MIDDLE, 1), (SIDED, 1), (_DOUBTFUL, 2)):
    for _name, _spellings in _table.items():
        for _spelling in _spellings.split():
            _BY_NAME.setdefault(_spelling, []).append((_name, 0 if _spelling == _name.lower() else _rank))


_MIDDLE = {
    "pelvis": "spinebase pelvis hip hips midhip cmidhip hipcenter hipcentre",
    "spine": "spinemid spinechest chest spinenaval spinenavel torso",
    "spine_top": "spineshoulder shouldercenter shouldercentre",
    "neck": "neck cneck",
    "head": "head",
}
_SIDED = {
    "shoulder": "shoulder sho shoulderjointcenter shoulderjointcentre",
    "elbow": "elbow elb elbowjointcenter elbowjointcentre",
    "wrist": "wrist wri wristjointcenter wristjointcentre",
    "hand": "hand index middle palm",
    "hip": "hip hipjointcenter hipjointcentre hjc",
    "ankle": "ankle ankleankle",
    "foot": "foot footindex bigtoe toe",
}
_MIDDLE_ROLES = {name: role for role, names in _MIDDLE.items() for name in names.split()}
_SIDED_ROLES = {name: role for role, names in _SIDED.items() for name in names.split()}

TRUNK = ("near_shoulder", "far_shoulder", "near_hip", "far_hip", "pelvis", "spine", "spine_top", "neck")
"""Roles of the joints that determine the pose of the trunk."""
ARM = ("elbow", "wrist", "hand")
"""Roles of the joints of the arm, from the shoulder outwards."""


def find_roles(labels: Sequence[str], side: Side) -> dict[str, int]:
    """Return the number of the joint in each role; roles are relative to the arm ``side``.

    Roles are the names in :data:`TRUNK` and :data:`ARM`, and ``far_ankle``, ``near_foot`` and so on. The prefix
    ``near_`` means the side of the chosen arm, ``far_`` the other side. ``labels`` are the names of the joints in the
    file.

    Examples
    --------
    >>> find_roles(["Neck", "ShoulderLeft", "RElbow", "right_wrist", "LElbow"], "right")
    {'neck': 0, 'far_shoulder': 1, 'elbow': 2, 'wrist': 3, 'far_elbow': 4}
    """
    roles: dict[str, int] = {}
    for number, label in enumerate(labels):
        name = re.sub(r"[^a-z]", "", label.rsplit(":", 1)[-1].lower().replace("_study", ""))
        role = _MIDDLE_ROLES.get(name)
        splits = []  # possible splits of the name into a side and the rest
        for word in ("right", "left", "r", "l"):
            splits += [(word, name[len(word) :])] if name.startswith(word) else []
            splits += [(word, name[: -len(word)])] if name.endswith(word) else []
        own, rest = next((split for split in splits if split[1] in _SIDED_ROLES), ("", ""))
        if role is None and rest:
            near, role = own[0] == side[0], _SIDED_ROLES[rest]
            if not near or role not in ARM:
                role = f"{'near' if near else 'far'}_{role}"
        if role and role not in roles:
            roles[role] = number
    return roles
