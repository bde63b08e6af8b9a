"""Function of the stage segment in the plane, which assigns the markers to a base and the segments of a chain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, as_xy
from mocap_id.errors import ConfigError, Refused
from mocap_id.kinematics import (
    Constraints,
    Hypothesis,
    Segmentation,
    SegmentationRules,
    measure_asymmetry,
    segment_markers,
)
from mocap_id.protocols.body_names import LONGEST, name_bodies
from mocap_id.protocols.kind_of_movement import ELSEWHERE, recognise_movement
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings
from mocap_id.stages.segment.bad_markers import (
    SegmentedMarkers,
    describe_bad_stretches,
    explain_bad_markers,
    segment_without_bad_markers,
)
from mocap_id.stages.segment.hints import UNSURE, check_names, explain_doubt, make_constraints, make_rules
from mocap_id.stages.segment.known_names import check_marker_names
from mocap_id.stages.segment.known_segments import make_columns
from mocap_id.stages.segment.lifted_heel import add_foot, check_lift, explain_lift, is_foot_a_segment
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
    usual, joint_names = name_bodies(trial.protocol, found.count, foot_turns=foot)
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
