"""Function of the stage segment in the plane: segments, bad stretches of markers, and feet whose heels lift."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, as_xy
from mocap_id.errors import ConfigError, Refused
from mocap_id.kinematics import (
    Constraints,
    Hypothesis,
    Segmentation,
    SegmentationRules,
    frames_over_time,
    measure_asymmetry,
    segment_markers,
)
from mocap_id.kinematics.marker_faults import BadStretch, RecordedMarkers, find_bad_stretches, find_repeats, sample_rows
from mocap_id.protocols.body_names import LONGEST, name_chain
from mocap_id.protocols.kind_of_movement import ELSEWHERE, recognise_movement
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings
from mocap_id.stages.segment.hints import (
    UNSURE,
    check_marker_names,
    check_names,
    explain_doubt,
    make_columns,
    make_constraints,
    make_rules,
)
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.views import Trajectories
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
    out = list(find_markers(labels, settings.ignore, "segment: ignore"))
    if trial.protocol == "sit-to-stand":
        _check_unit(np.delete(recorded.read_positions(axes="y")[..., 0], out, axis=1))
    done, lift = _find_segments(recorded, settings, LONGEST[trial.protocol], out)
    found, view, points = done.found, done.view, done.points
    if trial.protocol == "sit-to-stand":
        _check_extent(points[..., 1])
    asymmetries = np.degrees(measure_asymmetry(_plane(points, out), _lateral(points), found.segment))
    planarity = _measure_planarity(points[:, found.segment > 0])
    not_planar = _check_planarity(planarity, settings)
    foot = is_foot_a_segment(lift, labels, found)
    usual, joint_names = name_chain(trial.protocol, found.count, foot_turns=foot)
    names = usual if settings.names is None else check_names(settings.names, found.count)
    doubts = _explain_doubts(found, joint_names)
    counted = settings.count is not None and settings.count_alone is None  # by the user, not by a study
    given = counted or settings.names is not None or settings.together or settings.apart
    if found.confidence.value < _WRONG and not given:
        text = f"{doubts[0].message} With a confidence of {found.confidence.value:.1g}, nothing is computed from them."
        raise Refused("segments-unsure", text, found.confidence.value, _WRONG)
    facts = {
        "count": found.count,
        "names": list(names),
        "joint_names": list(joint_names),
        "joint_markers": _find_markers_at_joints(labels, found, joint_names)
        | _read_joint_markers(labels, settings.joint_markers, joint_names),
        "links": _make_links(labels, found),
        "bad_stretches": list(view.bad),
        "confidence": found.confidence.value,
        "against": dict(found.confidence.against),
        "planarity": planarity,
        "joint_confidences": list(found.confidence.joints),
        "joint_ratios": list(found.ratios),
        "asymmetry_deg": [float(a) if np.isfinite(a) else None for a in asymmetries],
        "noise_floor_m": found.base.noise,
        "static_gap": found.base.gap if np.isfinite(found.base.gap) else None,
        "hypotheses": [_describe_hypothesis(h, found.hypotheses[0], labels) for h in found.hypotheses],
    }
    reasons = (
        *_explain_bursts(recorded),
        *explain_bad_markers(view.bad),
        *explain_lift(lift, moves=foot),
        *not_planar,
        *doubts,
        *_explain_asymmetry(asymmetries, names, settings.asymmetry_deg),
        *check_marker_names(labels, found.segment, usual, found.confidence.value),
        *_check_height(points, found.segment),
        *_explain_count(settings),
    )
    why = [
        "left out by `segment: ignore`"
        if marker in out
        else _explain_segment(found, marker, names) + describe_bad_stretches(label, view.bad)
        for marker, label in enumerate(labels)
    ]
    return (Table(SEGMENTS, make_columns(labels, found.segment, found.residual, why), facts, reasons),)


def _find_segments(
    recorded: Trajectories, settings: SegmentSettings, longest: int, out: list[int]
) -> tuple[SegmentedMarkers, Mapping[str, Any] | None]:
    """Return the segments, found without bad stretches and the markers ``out``, and the fact ``heel_lift`` or None.

    ``longest`` is the largest number of segments.
    """
    labels = recorded.labels
    rules = make_rules(settings, longest)
    constraints = make_constraints(labels, settings)

    def segment_into(count: int | None) -> SegmentedMarkers:
        counted = replace(rules, count=count, longest=max(count or 0, rules.longest))
        return segment_without_bad_markers(
            recorded,
            settings.frames,
            np.setdiff1d(np.arange(len(labels)), out),
            lambda points: _segment_plane(_plane(points, out), _lateral(points), counted, constraints, settings),
        )

    try:
        done = segment_into(settings.count)
    except Refused as refused:
        seen = recognise_movement(labels, recorded.read_positions(axes="zxy"), recorded.rate)  # the plane's y is up
        if longest != LONGEST["robot-joint"] and seen.kind in ELSEWHERE:
            hint = f"This looks like {seen.kind}: {seen.evidence}. {ELSEWHERE[seen.kind]}"
            raise Refused(refused.code, f"{refused} {hint}", refused.value, refused.limit) from refused
        planarity = recorded.planar.facts["plane"]["planarity"]
        if planarity <= settings.planarity_caution or refused.code in _NOT_OF_SPACE:
            raise
        hint = (
            f"{100 * planarity:.0f} % of the markers' motion leaves the plane: for an arm, or another chain whose "
            "joints rotate about several axes, set `space: 3d`."
        )
        raise Refused(refused.code, f"{refused} {hint}", refused.value, refused.limit) from refused
    lift = check_lift(recorded.planar.facts.get("heel_lift"), done.view.bad)
    if settings.count is None:
        done = add_foot(done, lift, labels, segment_into)
    return done, lift


def _plane(points: FloatArray, out: list[int]) -> ComplexArray:
    """Return the markers (f, M) in the plane as x + iy, m; NaN for the markers ``out``, which the user leaves out."""
    plane = np.asarray(points[..., 0] + 1j * points[..., 1])
    plane[:, out] = np.nan
    return plane


def _check_unit(heights: FloatArray) -> None:
    """Raise Refused if most markers, with heights (F, M), m, are far too close together or too far apart for a person.

    This is done before the search for segments, which takes minutes with lengths in a wrong unit. Single markers
    elsewhere have no influence.
    """
    usual = np.nanmedian(heights[:, np.isfinite(heights).any(axis=0)], axis=0)
    extent = float(np.ptp(np.percentile(usual, [10, 90]))) if len(usual) else np.nan
    if extent < 0.25 * _EXTENT[0] or extent > 2.0 * _EXTENT[1]:
        _check_extent(heights)


def _check_extent(heights: FloatArray) -> None:
    """Raise Refused if the markers of a person, with heights (F, M), m, span a height that no person has."""
    low, high = np.nanpercentile(heights, [0.5, 99.5])
    extent = float(high - low)
    if not _EXTENT[0] <= extent <= _EXTENT[1]:
        text = (
            f"the markers span {extent:.2f} m in height; expected {_EXTENT[0]:g} to {_EXTENT[1]:g} m for a person who "
            "stands up or squats. The file declares a wrong unit of length: set `planarise: {units: …}`. For another "
            "chain, set `protocol: free`."
        )
        raise Refused("size-impossible", text, extent, _EXTENT[extent > _EXTENT[1]])


def _measure_planarity(points: FloatArray) -> float:
    """Return the share of the motion of points (F, K, 3) that is out of the plane."""
    visible = np.isfinite(points)
    counts = np.maximum(visible.sum(axis=0), 1)
    mean = np.where(visible, points, 0).sum(axis=0) / counts
    motion = np.where(visible, (points - mean) ** 2, 0).sum(axis=(0, 1))
    return float(motion[2] / motion.sum())


def _check_planarity(planarity: float, settings: SegmentSettings) -> tuple[Reason, ...]:
    """Return a caution if ``planarity`` is above `planarity_caution`; raise Refused above `planarity_limit`."""
    observation = f"{100 * planarity:.1f} % of the chain's motion leaves the plane"
    limit, caution = settings.planarity_limit, settings.planarity_caution
    if planarity > limit:
        text = (
            f"{observation}: too much for a planar chain (limit {100 * limit:.0f} %). If the joints rotate about "
            "several axes, set `space: 3d`."
        )
        raise Refused("not-planar", text, planarity, limit)
    if planarity <= caution:
        return ()
    text = f"{observation} (usually at most {100 * caution:.0f} %): angles and lengths are those of its projection."
    return (Reason("not-planar", text, planarity, caution),)


def _lateral(points: FloatArray) -> FloatArray:
    """Return the mean out-of-plane coordinate of each marker (M,), m; NaN for a marker that is never visible."""
    z = points[..., 2]
    visible = np.isfinite(z)
    counts = visible.sum(axis=0)
    return np.where(counts > 0, np.where(visible, z, 0).sum(axis=0) / np.maximum(counts, 1), np.nan)


def _explain_bursts(view: Trajectories) -> tuple[Reason, ...]:
    """Return a note about samples that jump away and back, and the marker with the most such samples."""
    visible = np.asarray(view.planar.values["visible"], dtype=np.bool_)
    counts = np.count_nonzero(view.bursts & visible, axis=0)
    if not counts.any():
        return ()
    worst = int(np.argmax(counts))
    first = view.time[np.argmax(view.bursts[:, worst])]
    text = (
        f"{int(counts.sum())} samples jump away and back; segments and joint fit do not use these samples. "
        f"{view.labels[worst]} has the most, the first at {first:.2f} s."
    )
    return (Reason("bursts", text, float(counts.sum() / np.count_nonzero(visible)), level="ok"),)


def _segment_plane(
    plane: ComplexArray,
    lateral: FloatArray,
    rules: SegmentationRules,
    constraints: Constraints,
    settings: SegmentSettings,
) -> Segmentation:
    """Return the segments; a refusal mentions the user's hints if there are any."""
    try:
        return segment_markers(plane, lateral, rules, constraints)
    except Refused as refused:
        if not (settings.together or settings.apart or settings.ignore):
            raise
        text = f"{refused} The settings `together`, `apart` and `ignore` were applied."
        raise Refused(refused.code, text, refused.value, refused.limit) from refused


def _read_joint_markers(
    labels: tuple[str, ...], given: Mapping[str, tuple[str, ...]], joint_names: Sequence[str]
) -> dict[str, list[str]]:
    """Return the labels of the markers that the settings ``given`` name for each joint, by joint."""
    unknown = [name for name in given if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"segment: joint_markers: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    return {
        name: [labels[i] for i in find_markers(labels, patterns, f"segment: joint_markers: {name}")]
        for name, patterns in given.items()
    }


def _find_markers_at_joints(
    labels: tuple[str, ...], found: Segmentation, joint_names: Sequence[str]
) -> dict[str, list[str]]:
    """Return the labels of the markers that are at a joint according to the motion, by joint."""
    pins = () if found.links is None else found.links.pins
    return {joint_names[pin.joint]: [labels[m] for m in pin.unit] for pin in pins}


def _make_links(labels: tuple[str, ...], found: Segmentation) -> dict[str, Any] | None:
    """Return joint centres and marker positions, m, to start the joint fit; None without single-marker segments."""
    if found.links is None:
        return None
    state, assigned = found.links.state, np.flatnonzero(found.segment >= 0)
    return {
        "centres": as_xy(state.centres).tolist(),
        "local": {labels[m]: as_xy(state.local[m]).tolist() for m in assigned},
    }


def _explain_segment(found: Segmentation, marker: int, names: tuple[str, ...]) -> str:
    """Return a text that says why a marker is on its segment."""
    k = int(found.segment[marker])
    scatter = found.base.scatter[marker]
    if k < 0:
        if not np.isfinite(scatter):
            return "visible in too few frames"
        return "on no segment of the chain: on a branch, or not rigid with any segment"
    if k == 0:
        return f"still: moves by {1e3 * scatter:.1f} mm rms"
    if marker in found.base.markers:
        return f"nearly still, on the axis of joint 1: fits {names[1]} as well as the base"
    return f"rigid with {names[k]} within {1e3 * found.residual[marker]:.1f} mm rms"


def _describe_hypothesis(hypothesis: Hypothesis, best: Hypothesis, labels: tuple[str, ...]) -> dict[str, Any]:
    """Return a hypothesis about the segments as a dictionary for JSON, for the summary and the report."""
    return {
        "segments": len(hypothesis.chain) + 1,
        "cost": hypothesis.cost,
        "why": hypothesis.explain_cost(best),
        "joint_residual_m": [joint.residual for joint in hypothesis.joints],
        "arc_deg": [float(np.degrees(joint.arc)) for joint in hypothesis.joints],
        "markers": [[labels[m] for m in body.markers] for body in hypothesis.chain],
        "left_out": [[labels[m] for m in body.markers] for body in hypothesis.left_out],
    }


def _explain_count(settings: SegmentSettings) -> tuple[Reason, ...]:
    """Return a note if the number of segments is not that of this trial alone."""
    if settings.count_alone is None or settings.count_alone == settings.count:
        return ()
    text = (
        f"the number of segments, {settings.count}, was chosen by `mocap-id study` from all trials of the person; this "
        f"trial alone has {settings.count_alone}."
    )
    return (Reason("segments-together", text, float(settings.count_alone), level="ok"),)


def _check_height(points: FloatArray, segment: IntArray) -> tuple[Reason, ...]:
    """Return a caution if the last segment is below the base, which is impossible for a standing person."""
    height = np.array([np.nanmean(points[:, segment == k, 1]) for k in (0, int(segment.max()))])
    if height[1] >= height[0]:
        return ()
    text = (
        f"the chain is {height[0] - height[1]:.2f} m below its base: for a standing person the vertical axis is wrong "
        "(`planarise: {vertical: …}`)."
    )
    return (Reason("upside-down", text, float(height[0] - height[1]), 0.0),)


def _explain_doubts(found: Segmentation, joint_names: tuple[str, ...]) -> tuple[Reason, ...]:
    """Return a caution if the segments are more likely wrong than right, with the strongest evidence against them."""
    confidence = found.confidence
    if confidence.value >= UNSURE:
        return ()
    weakest = int(np.argmin(confidence.joints))
    left_out = int(np.sum(found.segment < 0))
    gravest = max(confidence.against, key=lambda evidence: confidence.against[evidence])
    loose = " and the ".join(joint_names[joint] for joint in (found.links.loose if found.links else ()))
    why = {
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
    return explain_doubt(why, confidence.value)


def _explain_asymmetry(asymmetries: FloatArray, names: tuple[str, ...], limit: float) -> tuple[Reason, ...]:
    """Return a caution if left and right side do not move together, because one segment represents both."""
    apart = np.flatnonzero(asymmetries > limit)
    if not len(apart):
        return ()
    worst = int(apart[np.argmax(asymmetries[apart])])
    text = (
        f"left and right do not move together: the rotations of the two sides of the {names[worst + 1]} differ by "
        f"{asymmetries[worst]:.1f}° rms. One segment represents both; its angle is their mean."
    )
    return (Reason("segments-unsure", text, float(asymmetries[worst]), limit),)


_ROUNDS = 3  # largest number of searches
_CLOSE = 0.1  # s: smaller differences of times are ignored
_UNSURE = 0.5  # confidence below which the segments are doubtful
_LISTED = 5  # largest number of stretches named in a note

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
"""Incomplete note by the kind of a bad stretch; its message is an observation with the probable cause."""


@dataclass(frozen=True)
class SegmentedMarkers:
    """Segments that were found without the samples in bad stretches."""

    found: Segmentation  # segments of the markers
    view: Trajectories  # markers without the bad stretches
    points: FloatArray  # (f, M, 3) markers in the frames used for the segmentation, m


def segment_without_bad_markers(
    recorded: Trajectories, frames: int, examined: IntArray, segment: Callable[[FloatArray], Segmentation]
) -> SegmentedMarkers:
    """Return the segments found without the bad stretches of the markers.

    The markers are segmented, then bad stretches are found; both are repeated until the stretches no longer change.

    Parameters
    ----------
    frames : int
        Number of frames used for the segmentation.
    examined : int array
        Indices of the markers in which bad stretches are searched.
    segment : callable
        Function that returns the segments for the positions (f, M, 3) of the markers, m.

    Raises
    ------
    Refused
        The markers as recorded do not form a chain.
    """
    swapped = _find_swapped_stretches(recorded)
    rows = sample_rows(len(recorded.frames), recorded.rate)
    markers = RecordedMarkers(recorded.read_positions(frames=rows), rows, recorded.read_track, recorded.rate)
    done = _segment(Trajectories(recorded.planar, swapped), frames, segment)
    bad: tuple[dict[str, Any], ...] = ()
    for _ in range(_ROUNDS):
        plane = done.points[..., 0] + 1j * done.points[..., 1]
        before = bad
        bad = tuple(
            _make_facts(recorded, stretch, swapped)
            for stretch in find_bad_stretches(markers, done.found, plane, examined)
        )
        bad_labels = {each["marker"] for each in bad}  # their times are more certain than those of swaps
        others = (each for each in swapped if each["marker"] not in bad_labels)
        view = Trajectories(recorded.planar, (*others, *bad))
        if _are_same(bad, before):
            return replace(done, view=view)
        try:
            other = _segment(view, frames, segment)
        except Refused:  # the other markers do not form a chain
            break
        if other.found.confidence.value < _UNSURE <= done.found.confidence.value:  # more certain with the bad samples
            return replace(done, view=view, points=other.points)
        done = other
    return done


def remove_repeats(recorded: Trajectories) -> Trajectories:
    """Return the markers of a trial in space without the stretches in which a marker has exactly the same position."""
    points = recorded.read_positions(np.arange(len(recorded.labels)))
    repeats = find_repeats(points, recorded.rate)
    return Trajectories(recorded.planar, [_make_facts(recorded, each, ()) for each in repeats])


def _segment(view: Trajectories, frames: int, segment: Callable[[FloatArray], Segmentation]) -> SegmentedMarkers:
    points = view.read_positions(frames=frames_over_time(view.read_plane(), frames))
    return SegmentedMarkers(segment(points), view, points)


def _make_facts(view: Trajectories, stretch: BadStretch, swapped: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return marker, times and kind of a stretch; "elsewhere" becomes "swapped" in one of the stretches ``swapped``."""
    marker, first, last = view.labels[stretch.marker], view.time[stretch.first], view.time[stretch.last]
    known = any(each["marker"] == marker and each["first_s"] < last and first < each["last_s"] for each in swapped)
    how = "swapped" if known and stretch.how == "elsewhere" else stretch.how
    return {"marker": marker, "first_s": float(first), "last_s": float(last), "how": how}


def _are_same(bad: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether two searches found the same stretches, with times that differ by less than 0.1 s."""
    return len(bad) == len(before) and all(
        one["marker"] == other["marker"]
        and abs(one["first_s"] - other["first_s"]) < _CLOSE
        and abs(one["last_s"] - other["last_s"]) < _CLOSE
        for one, other in zip(bad, before, strict=True)
    )


def _find_swapped_stretches(view: Trajectories) -> tuple[dict[str, Any], ...]:
    """Return the stretches in which two markers have exchanged labels that planarise has not repaired."""
    return tuple(
        {"marker": label, "first_s": swap["first_s"], "last_s": swap["last_s"], "how": "swapped"}
        for swap in view.planar.facts.get("swaps", ())
        if not swap["repaired"]
        for label in swap["labels"]
    )


def explain_bad_markers(bad: Sequence[Mapping[str, Any]]) -> Iterator[Reason]:
    """Yield a note for each kind of bad stretch that occurs, with the markers and times."""
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
        yield replace(cause, message=text, value=seconds)


def describe_bad_stretches(label: str, bad: Sequence[Mapping[str, Any]]) -> str:
    """Return a text with the times and kinds of the bad stretches of a marker; an empty text if it has none."""
    own = [each for each in bad if each["marker"] == label]
    return "".join(f"; left out from {each['first_s']:.2f} to {each['last_s']:.2f} s: {each['how']}" for each in own)


_SURE = 0.5  # smallest confidence of a chain with the foot
_FEWEST = 5  # smallest number of segments: ground, foot, shank, thigh and torso


def check_lift(lift: Mapping[str, Any] | None, bad: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the fact ``lift`` unchanged, or None if one of its markers has one of the stretches ``bad``."""
    if lift is None or {each["marker"] for each in bad} & {lift["marker"], lift["about"]}:
        return None
    return lift


def is_foot_a_segment(lift: Mapping[str, Any] | None, labels: Sequence[str], found: Segmentation) -> bool:
    """Return whether the first moving segment is the foot, decided by the two markers of the fact ``heel_lift``.

    At least one of these markers must be on the first segment; the other one may be on the next, near the ankle.
    """
    if lift is None or found.count < _FEWEST:
        return False
    segments = {int(found.segment[labels.index(lift[which])]) for which in ("marker", "about")}
    return segments in ({1}, {1, 2})


def add_foot(
    done: SegmentedMarkers,
    lift: Mapping[str, Any] | None,
    labels: Sequence[str],
    segment: Callable[[int], SegmentedMarkers],
) -> SegmentedMarkers:
    """Return the segments with the foot as an additional segment; unchanged if it is not certain that the foot rotates.

    Parameters
    ----------
    lift : mapping or None
        Fact ``heel_lift`` of planar.parquet.
    labels : sequence of str
        Labels of the markers.
    segment : callable
        Function that segments the markers into a given number of segments.
    """
    if lift is None or is_foot_a_segment(lift, labels, done.found):
        return done
    try:
        other = segment(done.found.count + 1)
    except Refused:
        return done
    sure = other.found.confidence.value >= _SURE
    return other if sure and is_foot_a_segment(lift, labels, other.found) else done


def explain_lift(lift: Mapping[str, Any] | None, *, moves: bool) -> tuple[Reason, ...]:
    """Return a note about a lift of the heels if the foot is a segment (``moves``), or else a caution."""
    if lift is None:
        return ()
    observation = (
        f"a foot rotates by {lift['turn_deg']:.0f}° and {lift['marker']} rises by {100 * lift['height_m']:.1f} cm, "
        f"first at {lift['time_s']:.1f} s"
    )
    if moves:
        text = f"{observation}: the foot is a segment of the chain, which rotates about the toes on the ground"
        return (Reason("heel-lifts", text, float(lift["turn_deg"]), level="ok"),)
    text = (
        f"{observation}: the base of the chain and the ankle move, but there are too few markers to make the foot a "
        "segment. The ankle's torque is wrong by the weight on the feet times this displacement; angles of knee and "
        "hip may be wrong by some degrees. Record again with the heels on the ground, for example from a higher chair"
    )
    return (Reason("heel-lifts", text, float(lift["turn_deg"])),)
