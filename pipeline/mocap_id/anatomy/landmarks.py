"""Landmarks by the names of markers, and in the frames of clusters, from a still pose or from pointer trials."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.anatomy.frames import PALPATION
from mocap_id.arrays import FloatArray, find_runs
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
    readings = [(marker, *reading) for marker, label in enumerate(labels) for reading in _read_label(label)]
    reasons: list[Reason] = []

    # the arm
    counts: dict[Side, int] = {each: len({name for _, name, own, _ in readings if own == each}) for each, _ in _SIDES}
    chosen = side
    if side is not None:
        other: Side = "left" if side == "right" else "right"
        if counts[side] == 0 and counts[other] > 0:
            names = ", ".join(labels[marker] for marker, _, own, _ in readings if own == other)
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
        fitting = [
            (rank, own is None and chosen is not None, marker)
            for marker, landmark, own, rank in readings
            if landmark == name and (name in MIDDLE or own in (chosen, None))
        ]
        if not fitting:
            continue
        order = min(fitting)[:2]
        best = [marker for *each, marker in fitting if tuple(each) == order]
        names = " and ".join(labels[marker] for marker in best)
        if len(best) > 1:
            message = (
                f"the marker names {names} all fit the landmark {name}, so none was used. Name one of them, such as "
                f"`landmarks: {{{name}: {labels[best[0]]}}}`"
            )
            reasons.append(Reason("landmark-ambiguous", message))
            continue
        if order[0] == 2:
            message = (
                f"the marker {names} was used as the landmark {name}, but this name is also used for other points. "
                f"Write landmarks: {{{name}: {names}}} to confirm it, or give the correct marker"
            )
            reasons.append(Reason("landmark-doubtful", message))
        markers[name] = best[0]
    return NamedLandmarks(markers, chosen, tuple(reasons))


def _read_label(label: str) -> list[tuple[str, Side | None, int]]:
    """Return all interpretations of a marker's name: landmark, side and rank.

    The rank is 0 for a name used by the ISB, 1 for another spelling, and 2 for a doubtful spelling.
    """
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
            return [(name, own if name in SIDED else None, rank) for name, rank in hits]
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


_SPAN = 0.2  # s; time over which a speed is measured
_QUIET = 0.02  # m/s; postural sway is slower
_SHORTEST = 0.3  # s; shortest still pose
_SHARE = 0.9  # fraction of the visible markers that must be quiet; one shaking marker is ignored
_HOLES = 0.1  # s; shorter gaps between quiet frames are closed
_LOOSE = 0.01  # m; a landmark with a larger rms spread does not follow its cluster


@dataclass(frozen=True)
class StillPose:
    """Frames in which the body stands still."""

    frames: slice
    speed: float  # 90th percentile of the markers' speeds in these frames, m/s
    reasons: tuple[Reason, ...]  # empty if the pose is still


@dataclass(frozen=True)
class LandmarkPosition:
    """Position of a landmark in the frame of a cluster."""

    local: FloatArray  # (3,) mean over the frames, m
    sd: float  # standard deviation along each axis, including palpation, m
    spread: float  # rms distance from the mean in the frames used, m


def find_still_pose(points: FloatArray, rate: float, given: tuple[float, float] | None = None) -> StillPose:
    """Return the longest interval in which the markers hardly move.

    A marker's speed is its displacement over 0.2 s. A frame is quiet if 90 % of the visible markers move at 20 mm/s or
    less, which is the sway of a standing person. If no interval of 0.3 s is quiet, the quietest 0.3 s are returned. If
    ``given`` (start and end in s from the first frame), that interval is returned. The caution ``no-still-pose`` is
    added if the markers move faster than 30 mm/s. Marker positions (F, M, 3) are in m, NaN where missing; ``rate`` is
    in frames per second. A RecordingError is raised if the given interval is outside the recording, or if the recording
    is too short or has no visible marker.
    """
    # speed (F,) that 90 % of the visible markers do not exceed, m/s; NaN where no marker is visible
    half = max(round(_SPAN * rate / 2), 1)
    count = len(points)
    late, early = np.minimum(np.arange(count) + half, count - 1), np.maximum(np.arange(count) - half, 0)
    steps = np.linalg.norm(points[late] - points[early], axis=-1) * rate / np.maximum(late - early, 1)[:, None]
    rank = np.maximum(np.ceil(_SHARE * np.isfinite(steps).sum(axis=1)).astype(np.int64) - 1, 0)
    speed = np.take_along_axis(np.sort(steps, axis=1), rank[:, None], axis=1)[:, 0]

    shortest = max(round(_SHORTEST * rate), 2)
    if given is not None:
        frames = slice(max(round(given[0] * rate), 0), min(round(given[1] * rate) + 1, count))
        if frames.stop - frames.start < 2:
            end = (count - 1) / rate
            raise RecordingError(f"static: {given[0]:g} to {given[1]:g} s is outside the recording, 0 to {end:.2f} s")
    elif count < shortest + 2 or not np.isfinite(speed).any():
        raise RecordingError(f"the recording has {count} frames, too few for a still pose; record at least 0.5 s")
    else:
        quiet = np.nan_to_num(speed, nan=np.inf) <= _QUIET
        for hole in find_runs(~quiet):
            if hole.start > 0 and hole.stop < count and hole.stop - hole.start <= int(_HOLES * rate):
                quiet[hole] = True
        runs = [run for run in find_runs(quiet) if run.stop - run.start >= shortest]
        if runs:
            frames = max(runs, key=lambda run: run.stop - run.start)
        else:
            filled = np.where(np.isfinite(speed), speed, np.nanmax(speed))
            start = int(np.argmin(np.convolve(filled, np.ones(shortest) / shortest, mode="valid")))
            frames = slice(start, start + shortest)
    inside = speed[frames]
    value = float(np.nanpercentile(inside, 90)) if np.isfinite(inside).any() else np.inf
    if value <= 1.5 * _QUIET:
        return StillPose(frames, value, ())
    message = (
        f"no pose is still: the markers move at {1000 * value:.0f} mm/s, expected at most {1000 * _QUIET:.0f} mm/s, so "
        "landmarks are located while the skin moves. Record one second of rest, or give a still interval in `static:`"
    )
    return StillPose(frames, value, (Reason("no-still-pose", message, value, _QUIET),))


def locate_landmarks(
    points: Mapping[str, FloatArray],
    segment: Mapping[str, int],
    rotations: FloatArray,
    origins: FloatArray,
    *,
    frames: slice,
    palpation: float = PALPATION,
) -> tuple[dict[str, LandmarkPosition], tuple[Reason, ...]]:
    """Return the positions of landmarks in the frames of their segments, averaged over the still pose.

    Landmarks that are never visible together with their cluster are left out, with a reason. A landmark that is hidden
    in the still pose is averaged over the whole recording. Because the skin moves during the recording, the larger
    spread is included in the landmark's standard deviation. Trajectories (F, 3) of landmarks and origins (F, S, 3) of
    clusters are in m, rotations (F, S, 3, 3) are cluster to trial, NaN where missing. ``palpation`` is the standard
    deviation of each landmark along each axis, m.
    """
    places: dict[str, LandmarkPosition] = {}
    reasons: list[Reason] = []
    for name, track in points.items():
        k = segment[name]
        local = np.einsum("fji,fj->fi", rotations[:, k], track - origins[:, k])
        still = _average_positions(local[frames], palpation, 0.0)
        place = still or _average_positions(local, palpation, 1.0)
        if place is None:
            message = f"the landmark {name} was left out, because it is never visible together with its segment"
            reasons.append(Reason("landmark-hidden", message))
            continue
        if still is None:
            message = (
                f"the landmark {name} is hidden in the still pose, so its mean position over the recording was used"
            )
            reasons.append(Reason("landmark-hidden", message, place.spread, level="ok"))
        elif place.spread > _LOOSE:
            message = (
                f"{name} moves by {1000 * place.spread:.0f} mm rms in its segment in the still pose, expected "
                f"below {1000 * _LOOSE:.0f} mm; check the name of its marker, and `static:`"
            )
            reasons.append(Reason("landmark-loose", message, place.spread, _LOOSE))
        places[name] = place
    return places, tuple(reasons)


def _average_positions(local: FloatArray, palpation: float, skin: float) -> LandmarkPosition | None:
    """Return the mean of positions (K, 3), m; None if all are missing. The part ``skin`` of their spread is lasting."""
    seen = np.isfinite(local).all(axis=1)
    count = int(seen.sum())
    if count == 0:
        return None
    mean = local[seen].mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((local[seen] - mean) ** 2, axis=1))))
    lasting = (skin * spread) ** 2 / 3
    return LandmarkPosition(mean, float(np.sqrt(palpation**2 + lasting + spread**2 / 3 / count)), spread)


_SD_TIP = 0.005  # m; largest usable standard deviation of the tip
_BEND = 0.005  # m; largest rms distance of the markers from the rod
_LASTING = 50.0  # frames over which the error of skin and hand is practically constant
_MOVES = 0.005  # m; largest rms motion of the tip in the cluster's frame


def find_pointer_markers(trial: Sequence[str], pointer_trials: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names of the markers that every pointer trial has and the trial itself does not have.

    Examples
    --------
    >>> find_pointer_markers(["UA1", "UA2"], [["UA1", "UA2", "P1", "P2"], ["P1", "P2", "UA1"]])
    ('P1', 'P2')
    """
    first, *others = pointer_trials
    return tuple(name for name in first if name not in set(trial) and all(name in other for other in others))


def locate_tip(markers: FloatArray, distances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the tip positions and the residuals of a least-squares line through the pointer's markers in each frame.

    The markers (F, P, 3) are in m, NaN where missing, and ``distances`` (P,) are those from the tip, m. The tip (F, 3),
    m, is NaN where a marker is missing. The residual (F,), m, is the rms distance of the markers from their positions
    on the rod. A RecordingError is raised unless the pointer has one distance for each marker, at least two, and 50 mm
    between the smallest and the largest.
    """
    distances = np.asarray(distances, dtype=np.float64)
    if distances.shape != (markers.shape[1],) or len(distances) < 2 or np.ptp(distances) < 0.05:
        raise RecordingError(
            f"the pointer has {markers.shape[1]} markers and {distances.size} distances from its tip; expected one "
            "distance for each marker, at least two, and 50 mm between the nearest and the farthest"
        )
    centred = distances - distances.mean()
    along = np.einsum("p,fpi->fi", centred, markers)
    length = np.linalg.norm(along, axis=1)
    direction = along / np.where(length > 0, length, np.nan)[:, None]
    tip = markers.mean(axis=1) - distances.mean() * direction
    off = markers - tip[:, None] - distances[None, :, None] * direction[:, None]
    return tip, np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=1))


def locate_pointed_landmark(
    markers: FloatArray,
    rotation: FloatArray,
    origin: FloatArray,
    pointer: tuple[FloatArray, float],
    palpation: float = PALPATION,
) -> tuple[LandmarkPosition, tuple[Reason, ...]]:
    """Return the landmark of a pointer trial in the frame of the segment's cluster, and cautions about the pointer.

    The pointer's markers (F, P, 3) are in m. ``rotation`` (F, 3, 3), cluster to trial, and ``origin`` (F, 3), m, are
    the pose of the cluster. All are NaN where missing. ``pointer`` are the distances (P,) from its tip to its markers,
    m, and the standard deviation of the tip's position along the rod, m. ``palpation`` is the standard deviation of the
    touched position along each axis, m. A RecordingError is raised if pointer and cluster are never visible in the same
    frame.
    """
    distances, tip_sd = pointer
    tip, residual = locate_tip(markers, distances)
    local = np.einsum("fji,fj->fi", rotation, tip - origin)
    seen = np.isfinite(local).all(axis=1)
    if not seen.any():
        raise RecordingError(
            "the pointer and the markers of the landmark's segment are never visible in the same frame"
        )
    mean = np.median(local[seen], axis=0)
    spread = float(np.sqrt(np.mean(np.sum((local[seen] - mean) ** 2, axis=1))))
    bend = float(np.sqrt(np.mean(residual[seen] ** 2)))
    sd = float(np.sqrt(palpation**2 + (spread**2 + bend**2 + tip_sd**2) / 3))
    reasons: list[Reason] = []
    if bend > _BEND:
        message = (
            f"the pointer's markers are {1000 * bend:.1f} mm rms from their positions on a straight rod, expected "
            f"below {1000 * _BEND:.0f} mm; check the distances in `pointer:` and their order"
        )
        reasons.append(Reason("pointer-bent", message, bend, _BEND))
    if spread > _MOVES:
        message = (
            f"the pointer's tip moves by {1000 * spread:.1f} mm rms in the segment, expected below {1000 * _MOVES:.0f} "
            "mm; shorten the trial to the time in which the tip touches the landmark"
        )
        reasons.append(Reason("pointer-moves", message, spread, _MOVES))
    return LandmarkPosition(mean, sd, spread), tuple(reasons)


def calibrate_pointer(trials: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> tuple[FloatArray, float]:
    """Return the distances (P,), m, from a pointer's tip to its markers, and their common standard deviation, m.

    They are estimated from trials in which the pointer rotates about its resting tip.

    The tip p is constant in the frame of the cluster: c(t) - l e(t) = p. Here c is the mean of the markers, e the
    direction of the rod, and l the distance from the tip to c. A least-squares fit gives l, and p of each trial. The
    noise of e is estimated from neighbouring frames and subtracted, because it is not a rotation. The standard
    deviation of l assumes errors that persist for about half a second. Each trial is markers, rotation and origin as in
    :func:`locate_pointed_landmark`, with the markers in the same order in every trial. A RecordingError is raised if
    the pointer rotates too little, so that the standard deviation of the tip is above 5 mm.
    """
    gain, noise, product = 0.0, 0.0, 0.0
    centred, offsets = [], []
    for markers, rotation, origin in trials:
        seen = np.isfinite(markers).all(axis=(1, 2)) & np.isfinite(rotation).all(axis=(1, 2))
        middle = np.einsum("fji,fj->fi", rotation[seen], markers[seen].mean(axis=1) - origin[seen])
        ends = markers[seen, 0] - markers[seen, -1]
        rod = ends / np.linalg.norm(ends, axis=1, keepdims=True)  # direction from the last marker to the first
        about = markers[seen] - markers[seen].mean(axis=1, keepdims=True)
        offsets.append(np.einsum("fpi,fi->fp", about, rod).mean(axis=0))
        direction = np.einsum("fji,fj->fi", rotation[seen], rod)
        middle, direction = middle - middle.mean(axis=0), direction - direction.mean(axis=0)
        gain += float(np.sum(direction**2))
        noise += float(np.mean(np.sum(np.diff(direction, axis=0) ** 2, axis=1)) / 2 * len(direction))
        product += float(np.sum(direction * middle))
        centred.append((middle, direction))
    turn = gain - noise
    length = product / turn if turn > noise else np.nan
    off = np.concatenate([middle - length * direction for middle, direction in centred])
    sd = float(np.sqrt(np.mean(off**2) * _LASTING / turn)) if turn > noise else np.inf
    if not sd < _SD_TIP:
        raise RecordingError(
            f"the pointer rotates too little to locate its tip (± {1000 * sd:.0f} mm along the rod). Give "
            "the distances from the tip to its markers in `pointer:`, or a trial in which it rotates by 45° about its "
            "resting tip"
        )
    offset = np.mean(offsets, axis=0)
    return np.asarray(length + offset if length > 0 else -length - offset), sd
