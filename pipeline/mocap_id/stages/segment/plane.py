"""Function of the stage segment in the plane: segments, bad stretches of markers, and feet whose heels lift."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, as_xy
from mocap_id.errors import ConfigError, Refused
from mocap_id.kinematics.bundle import frames_over_time
from mocap_id.kinematics.joint import measure_asymmetry
from mocap_id.kinematics.marker_faults import BadStretch, RecordedMarkers, find_bad_stretches, find_repeats, sample_rows
from mocap_id.kinematics.segmentation import Segmentation, segment_markers
from mocap_id.protocols.body_names import LONGEST, name_chain
from mocap_id.protocols.movement import ELSEWHERE, recognise_movement
from mocap_id.stages.base import Context, Findings, Outputs, find_markers
from mocap_id.stages.segment import SegmentSettings, hints
from mocap_id.store.artefacts import Trajectories
from mocap_id.verdict import Reason

_WRONG = 1e-3  # confidence below which a trial is refused, unless the user gave the segments
_EXTENT = (0.4, 2.7)  # m; least and largest height of the markers of a person who stands up
_NOT_OF_SPACE = ("no-motion", "too-few-frames")  # refusals that `space: 3d` cannot avoid


def segment(context: Context) -> Outputs:
    """Return segments.parquet of a trial in the plane."""
    settings: SegmentSettings = context.settings
    trial = context.trial
    recorded = Trajectories(context.long("planar.parquet"))
    labels = recorded.labels
    left_out = list(find_markers(labels, settings.ignore, "segment: ignore"))
    if trial.protocol == "sit-to-stand":
        _check_extent(np.delete(recorded.read_positions(axes="y")[..., 0], left_out, axis=1), unit_alone=True)

    # segments, without bad stretches and the markers that the user leaves out
    rules = hints.limit_search(settings, LONGEST[trial.protocol])
    constraints = hints.make_constraints(labels, settings)
    examined = np.setdiff1d(np.arange(len(labels)), left_out)

    def segment_into(count: int | None) -> Segmented:
        counted = replace(rules, count=count, longest=max(count or 0, rules.longest))

        def search(points: FloatArray) -> Segmentation:
            try:
                return segment_markers(_plane(points, left_out), _lateral(points), counted, constraints)
            except Refused as refused:
                if not (settings.together or settings.apart or settings.ignore):
                    raise
                text = f"{refused} The settings `together`, `apart` and `ignore` were applied."
                raise Refused(refused.code, text, refused.value, refused.limit) from refused

        return segment_without_bad_markers(recorded, settings.frames, examined, search)

    try:
        found, view, points = segment_into(settings.count)
    except Refused as refused:
        upright = recorded.read_positions(axes="zxy")  # the plane's y is up
        seen, evidence = recognise_movement(labels, upright, recorded.rate)
        if LONGEST[trial.protocol] != LONGEST["robot-joint"] and seen in ELSEWHERE:
            hint = f"This looks like {seen}: {evidence}. {ELSEWHERE[seen]}"
            raise Refused(refused.code, f"{refused} {hint}", refused.value, refused.limit) from refused
        planarity = recorded.planar.facts["plane"]["planarity"]
        if planarity <= settings.planarity_caution or refused.code in _NOT_OF_SPACE:
            raise
        hint = (
            f"{100 * planarity:.0f} % of the markers' motion leaves the plane: for an arm, or another chain whose "
            "joints rotate about several axes, set `space: 3d`."
        )
        raise Refused(refused.code, f"{refused} {hint}", refused.value, refused.limit) from refused
    lift: Mapping[str, Any] | None = recorded.planar.facts.get("heel_lift")
    if lift is not None and {each["marker"] for each in view.bad} & {lift["marker"], lift["about"]}:
        lift = None
    if settings.count is None and lift is not None and not _is_foot_a_segment(lift, labels, found):
        with suppress(Refused):  # the foot as an additional segment, if it is certain that it rotates
            other = segment_into(found.count + 1)
            if other[0].confidence.value >= _SURE and _is_foot_a_segment(lift, labels, other[0]):
                found, view, points = other
    if trial.protocol == "sit-to-stand":
        _check_extent(points[..., 1])
    asymmetries = np.degrees(measure_asymmetry(_plane(points, left_out), _lateral(points), found.segment))
    # share of the motion of the moving segments that is out of the plane
    moving = points[:, found.segment > 0]
    seen_in = np.isfinite(moving)
    mean = np.where(seen_in, moving, 0).sum(axis=0) / np.maximum(seen_in.sum(axis=0), 1)
    motion = np.where(seen_in, (moving - mean) ** 2, 0).sum(axis=(0, 1))
    planarity = float(motion[2] / motion.sum())
    out_of_plane = f"{100 * planarity:.1f} % of the chain's motion leaves the plane"
    limit, caution = settings.planarity_limit, settings.planarity_caution
    if planarity > limit:
        text = (
            f"{out_of_plane}: too much for a planar chain (limit {100 * limit:.0f} %). If the joints rotate about "
            "several axes, set `space: 3d`."
        )
        raise Refused("not-planar", text, planarity, limit)
    foot = _is_foot_a_segment(lift, labels, found)
    usual, joint_names = name_chain(trial.protocol, found.count, foot_turns=foot)
    names = usual if settings.names is None else hints.check_names(settings.names, found.count)
    sure = found.confidence.value
    doubt = "" if sure >= hints.UNSURE else hints.describe_doubt(_find_gravest(found, joint_names))
    counted = settings.count is not None and settings.count_alone is None  # by the user, not by a study
    given = counted or settings.names is not None or settings.together or settings.apart
    if sure < _WRONG and not given:
        text = f"{doubt} With a confidence of {sure:.1g}, nothing is computed from them."
        raise Refused("segments-unsure", text, sure, _WRONG)

    # facts: markers at the joints, by the motion or the settings, and the start of the joint fit
    joint_markers: dict[str, list[str]] = {}
    links = None  # only with segments that have a single marker
    if found.links is not None:
        joint_markers = {joint_names[joint]: [labels[m] for m in own] for joint, own in found.links.pins.items()}
        state = found.links.state
        links = {
            "centres": as_xy(state.centres).tolist(),
            "local": {labels[m]: as_xy(state.local[m]).tolist() for m in np.flatnonzero(found.segment >= 0)},
        }
    unknown = [name for name in settings.joint_markers if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"segment: joint_markers: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    for name, patterns in settings.joint_markers.items():
        joint_markers[name] = [labels[i] for i in find_markers(labels, patterns, f"segment: joint_markers: {name}")]
    out = Findings()
    out.fact(
        count=found.count,
        names=list(names),
        joint_names=list(joint_names),
        joint_markers=joint_markers,
        links=links,
        bad_stretches=list(view.bad),
        confidence=sure,
        against=dict(found.confidence.against),
        planarity=planarity,
        joint_confidences=list(found.confidence.joints),
        joint_ratios=list(found.ratios),
        asymmetry_deg=[float(a) if np.isfinite(a) else None for a in asymmetries],
        noise_floor_m=found.base.noise,
        static_gap=found.base.gap if np.isfinite(found.base.gap) else None,
        hypotheses=[
            {
                "segments": len(each.chain) + 1,
                "cost": each.cost,
                "why": each.explain_cost(found.hypotheses[0]),
                "joint_residual_m": [joint.residual for joint in each.joints],
                "arc_deg": [float(np.degrees(joint.arc)) for joint in each.joints],
                "markers": [[labels[m] for m in body.markers] for body in each.chain],
                "left_out": [[labels[m] for m in body.markers] for body in each.left_out],
            }
            for each in found.hypotheses
        ],
    )

    # reasons
    visible = np.asarray(recorded.planar.values["visible"], dtype=np.bool_)
    bursts = np.count_nonzero(recorded.bursts & visible, axis=0)
    if bursts.any():
        worst = int(np.argmax(bursts))
        first = recorded.time[np.argmax(recorded.bursts[:, worst])]
        text = (
            f"{int(bursts.sum())} samples jump away and back; segments and joint fit do not use these samples. "
            f"{labels[worst]} has the most, the first at {first:.2f} s."
        )
        out.say("bursts", text, float(bursts.sum() / np.count_nonzero(visible)), level="ok")
    explain_bad_markers(out, view.bad)
    if lift is not None:
        rotates = (
            f"a foot rotates by {lift['turn_deg']:.0f}° and {lift['marker']} rises by {100 * lift['height_m']:.1f} cm, "
            f"first at {lift['time_s']:.1f} s"
        )
        text = f"{rotates}: the foot is a segment of the chain, which rotates about the toes on the ground"
        if not foot:
            text = (
                f"{rotates}: the base of the chain and the ankle move, but there are too few markers to make the foot "
                "a segment. The ankle's torque is wrong by the weight on the feet times this displacement; angles of "
                "knee and hip may be wrong by some degrees. Record again with the heels on the ground, for example "
                "from a higher chair"
            )
        out.say("heel-lifts", text, float(lift["turn_deg"]), level="ok" if foot else "caution")
    if planarity > caution:
        text = (
            f"{out_of_plane} (usually at most {100 * caution:.0f} %): angles and lengths are those of its projection."
        )
        out.say("not-planar", text, planarity, caution)
    if doubt:
        out.say("segments-unsure", doubt, sure, hints.UNSURE)
    apart = np.flatnonzero(asymmetries > settings.asymmetry_deg)
    if len(apart):  # one segment represents both sides
        worst = int(apart[np.argmax(asymmetries[apart])])
        text = (
            f"left and right do not move together: the rotations of the two sides of the {names[worst + 1]} differ by "
            f"{asymmetries[worst]:.1f}° rms. One segment represents both; its angle is their mean."
        )
        out.say("segments-unsure", text, float(asymmetries[worst]), settings.asymmetry_deg)
    hints.check_marker_names(out, labels, found.segment, usual, sure)
    base, last = (np.nanmean(points[:, found.segment == k, 1]) for k in (0, int(found.segment.max())))
    if not last >= base:
        text = (
            f"the chain is {base - last:.2f} m below its base: for a standing person the vertical axis is wrong "
            "(`planarise: {vertical: …}`)."
        )
        out.say("upside-down", text, float(base - last), 0.0)
    if settings.count_alone is not None and settings.count_alone != settings.count:
        text = (
            f"the number of segments, {settings.count}, was chosen by `mocap-id study` from all trials of the person; "
            f"this trial alone has {settings.count_alone}."
        )
        out.say("segments-together", text, float(settings.count_alone), level="ok")

    # why each marker is on its segment
    why = []
    for marker, label in enumerate(labels):
        k, scatter = int(found.segment[marker]), found.base.scatter[marker]
        if marker in left_out:
            why.append("left out by `segment: ignore`")
            continue
        if k < 0 and not np.isfinite(scatter):
            text = "visible in too few frames"
        elif k < 0:
            text = "on no segment of the chain: on a branch, or not rigid with any segment"
        elif k == 0:
            text = f"still: moves by {1e3 * scatter:.1f} mm rms"
        elif marker in found.base.markers:
            text = f"nearly still, on the axis of joint 1: fits {names[1]} as well as the base"
        else:
            text = f"rigid with {names[k]} within {1e3 * found.residual[marker]:.1f} mm rms"
        for each in view.bad:
            if each["marker"] == label:
                text += f"; left out from {each['first_s']:.2f} to {each['last_s']:.2f} s: {each['how']}"
        why.append(text)
    return (hints.make_table(out, labels, found.segment, found.residual, why),)


def _plane(points: FloatArray, out: list[int]) -> ComplexArray:
    """Return the markers (f, M) in the plane as x + iy, m; NaN for the markers ``out``, which the user leaves out."""
    plane = np.asarray(points[..., 0] + 1j * points[..., 1])
    plane[:, out] = np.nan
    return plane


def _check_extent(heights: FloatArray, *, unit_alone: bool = False) -> None:
    """Raise Refused if the markers of a person, with heights (F, M), m, span a height that no person has.

    With ``unit_alone``, only if most of them are far too close together or too far apart, which a wrong unit causes:
    the search for segments would take minutes. Single markers elsewhere then have no influence.
    """
    if unit_alone:
        usual = np.nanmedian(heights[:, np.isfinite(heights).any(axis=0)], axis=0)
        middle = float(np.ptp(np.percentile(usual, [10, 90]))) if len(usual) else np.nan
        if not (middle < 0.25 * _EXTENT[0] or middle > 2.0 * _EXTENT[1]):
            return
    low, high = np.nanpercentile(heights, [0.5, 99.5])
    extent = float(high - low)
    if not _EXTENT[0] <= extent <= _EXTENT[1]:
        text = (
            f"the markers span {extent:.2f} m in height; expected {_EXTENT[0]:g} to {_EXTENT[1]:g} m for a person who "
            "stands up or squats. The file declares a wrong unit of length: set `planarise: {units: …}`. For another "
            "chain, set `protocol: free`."
        )
        raise Refused("size-impossible", text, extent, _EXTENT[extent > _EXTENT[1]])


def _lateral(points: FloatArray) -> FloatArray:
    """Return the mean out-of-plane coordinate of each marker (M,), m; NaN for a marker that is never visible."""
    z = points[..., 2]
    visible = np.isfinite(z)
    counts = visible.sum(axis=0)
    return np.where(counts > 0, np.where(visible, z, 0).sum(axis=0) / np.maximum(counts, 1), np.nan)


def _find_gravest(found: Segmentation, joint_names: tuple[str, ...]) -> str:
    """Return the strongest evidence against the segments."""
    confidence = found.confidence
    weakest = int(np.argmin(confidence.joints))
    left_out = int(np.sum(found.segment < 0))
    gravest = max(confidence.against, key=lambda evidence: confidence.against[evidence])
    loose = " and the ".join(joint_names[joint] for joint in (found.links.loose if found.links else ()))
    return {
        "skipped": f"without the segment after the {joint_names[weakest]}, the markers fit only "
        f"{found.ratios[weakest]:.1f} times worse",
        "left-out": f"{left_out} markers are on no segment, and many of them are not on a side limb either",
        "axis": f"a marker near the {joint_names[0]} could also be on the other segment of this joint",
        "first-joint": f"the {joint_names[0]} is not a fixed point: it moves by "
        f"{1e3 * (found.hypotheses[0].joints[0].residual if found.hypotheses else np.nan):.0f} mm",
        "base": f"the marker that moves least moves only {found.base.gap:.1f} times as much as the markers of the base",
        "runner-up": "another number of segments explains the markers about as well",
        "links": f"no marker is at the {loose}; add a marker there",
        "ankle": f"the {joint_names[0]} rotates little and has no marker; add a marker there",
    }[gravest]


_ROUNDS = 3  # largest number of searches
_CLOSE = 0.1  # s: smaller differences of times are ignored
_LISTED = 5  # largest number of stretches named in a note
_SURE = 0.5  # smallest confidence of a chain with the foot
_FEWEST = 5  # smallest number of segments with the foot: ground, foot, shank, thigh and torso
# incomplete note by the kind of a bad stretch; its message is an observation with the probable cause
_CAUSES = {
    "frozen": Reason(
        "marker-frozen",
        "does not move in the laboratory while its segment moves; its last position was repeated",
        level="ok",
    ),
    "moved": Reason(
        "marker-moved",
        "is at another position on its segment; it was probably pushed, or it fell off and was attached again",
        level="ok",
    ),
    "elsewhere": Reason(
        "marker-elsewhere",
        "is away from its position on its segment; it is probably mislabelled, or a reflection",
        level="ok",
    ),
    "ghost": Reason(
        "marker-ghost",
        "is on no segment, and its distance from every other moving marker changes; it is probably not on the body",
        level="ok",
    ),
}


Segmented: TypeAlias = tuple[Segmentation, Trajectories, FloatArray]
"""Segments, the markers without the bad stretches, and their positions (f, M, 3) in the frames that were used, m."""


def segment_without_bad_markers(
    recorded: Trajectories, frames: int, examined: IntArray, segment: Callable[[FloatArray], Segmentation]
) -> Segmented:
    """Return the segments found without the bad stretches of the markers.

    The markers are segmented, then bad stretches are found; both are repeated until the stretches no longer change.
    ``frames`` is the number of frames used for the segmentation, and ``examined`` are the indices of the markers in
    which bad stretches are searched. ``segment`` returns the segments for the positions (f, M, 3) of the markers, m.
    Raises Refused if the markers as recorded do not form a chain.
    """

    def segment_without(bad: Sequence[Mapping[str, Any]]) -> Segmented:
        view = Trajectories(recorded.planar, bad)
        points = view.read_positions(frames=frames_over_time(view.read_plane(), frames))
        return segment(points), view, points

    # stretches in which two markers have exchanged labels that planarise has not repaired
    swapped = tuple(
        {"marker": label, "first_s": swap["first_s"], "last_s": swap["last_s"], "how": "swapped"}
        for swap in recorded.planar.facts.get("swaps", ())
        if not swap["repaired"]
        for label in swap["labels"]
    )
    rows = sample_rows(len(recorded.frames), recorded.rate)
    markers = RecordedMarkers(recorded.read_positions(frames=rows), rows, recorded.read_track, recorded.rate)
    found, view, points = segment_without(swapped)
    bad: tuple[dict[str, Any], ...] = ()
    for _ in range(_ROUNDS):
        plane, before = points[..., 0] + 1j * points[..., 1], bad
        bad = tuple(
            _make_facts(recorded, stretch, swapped) for stretch in find_bad_stretches(markers, found, plane, examined)
        )
        bad_labels = {each["marker"] for each in bad}  # their times are more certain than those of swaps
        every = (*(each for each in swapped if each["marker"] not in bad_labels), *bad)
        if len(bad) == len(before) and all(
            one["marker"] == other["marker"]
            and abs(one["first_s"] - other["first_s"]) < _CLOSE
            and abs(one["last_s"] - other["last_s"]) < _CLOSE
            for one, other in zip(bad, before, strict=True)
        ):
            return found, Trajectories(recorded.planar, every), points
        try:
            other = segment_without(every)
        except Refused:  # the other markers do not form a chain
            break
        if other[0].confidence.value < hints.UNSURE <= found.confidence.value:  # more certain with the bad samples
            return found, *other[1:]
        found, view, points = other
    return found, view, points


def remove_repeats(recorded: Trajectories) -> Trajectories:
    """Return the markers of a trial in space without the stretches in which a marker has exactly the same position."""
    points = recorded.read_positions(np.arange(len(recorded.labels)))
    repeats = find_repeats(points, recorded.rate)
    return Trajectories(recorded.planar, [_make_facts(recorded, each, ()) for each in repeats])


def _make_facts(view: Trajectories, stretch: BadStretch, swapped: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return marker, times and kind of a stretch; "elsewhere" becomes "swapped" in one of the stretches ``swapped``."""
    marker, first, last = view.labels[stretch.marker], view.time[stretch.first], view.time[stretch.last]
    known = any(each["marker"] == marker and each["first_s"] < last and first < each["last_s"] for each in swapped)
    how = "swapped" if known and stretch.how == "elsewhere" else stretch.how
    return {"marker": marker, "first_s": float(first), "last_s": float(last), "how": how}


def explain_bad_markers(out: Findings, bad: Sequence[Mapping[str, Any]]) -> None:
    """Add a note for each kind of bad stretch that occurs, with the markers and times."""
    for how, cause in _CAUSES.items():
        stretches = [each for each in bad if each["how"] == how]
        if not stretches:
            continue
        listed = "; ".join(
            each["marker"]
            if how == "ghost"
            else f"{each['marker']} from {each['first_s']:.2f} to {each['last_s']:.2f} s"
            for each in stretches[:_LISTED]
        )
        rest = f"; and {len(stretches) - _LISTED} more" if len(stretches) > _LISTED else ""
        text = (
            f"a marker {cause.message}: {listed}{rest}. These samples were left out; all other samples are used. Check "
            "the marker in the camera software."
        )
        seconds = float(sum(each["last_s"] - each["first_s"] for each in stretches))
        out.reasons.append(replace(cause, message=text, value=seconds))


def _is_foot_a_segment(lift: Mapping[str, Any] | None, labels: Sequence[str], found: Segmentation) -> bool:
    """Return whether the first moving segment is the foot, decided by the two markers of the fact ``heel_lift``.

    At least one of these markers must be on the first segment; the other one may be on the next, near the ankle.
    """
    if lift is None or found.count < _FEWEST:
        return False
    segments = {int(found.segment[labels.index(lift[which])]) for which in ("marker", "about")}
    return segments in ({1}, {1, 2})
