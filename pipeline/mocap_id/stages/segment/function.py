"""Function of the stage segment: sorts the markers into a base and the segments of a chain."""

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
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.segment import SegmentSettings
from mocap_id.stages.segment.bad_markers import (
    SegmentedMarkers,
    bad_marker_notes,
    left_out_words,
    segment_without_bad,
)
from mocap_id.stages.segment.hints import UNSURE, given_names, marker_constraints, search_rules
from mocap_id.stages.segment.known_names import contradicted_names
from mocap_id.stages.segment.lifted_heel import foot_moves, lift_of_good_markers, lift_reasons, with_foot
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_NOT_OF_SPACE = ("no-motion", "too-few-frames")  # refusals that another space does not help


def segment(context: Context) -> Outputs:
    """Return segments.parquet."""
    settings: SegmentSettings = context.settings
    trial = context.trial
    recorded = Trajectories(context.long("planar.parquet"))
    rules = search_rules(settings, LONGEST[trial.protocol])
    labels = recorded.labels
    out = list(find_markers(labels, settings.ignore, "segment: ignore"))
    constraints = marker_constraints(labels, settings)

    def segmented(count: int | None) -> SegmentedMarkers:
        counted = replace(rules, count=count, longest=max(count or 0, rules.longest))
        return segment_without_bad(
            recorded,
            settings.frames,
            np.setdiff1d(np.arange(len(labels)), out),
            lambda points: _sorted(_plane(points, out), _lateral(points), counted, constraints, settings),
        )

    try:
        done = segmented(settings.count)
    except Refused as refused:
        planarity = recorded.planar.facts["plane"]["planarity"]
        if planarity <= settings.planarity_caution or refused.code in _NOT_OF_SPACE:
            raise
        raise _with_hint_at_space(refused, planarity) from refused
    lift = lift_of_good_markers(recorded.planar.facts.get("heel_lift"), done.view.bad)
    if settings.count is None:
        done = with_foot(done, lift, labels, segmented)
    found, view, points = done.found, done.view, done.points
    asymmetries = np.degrees(measure_asymmetry(_plane(points, out), _lateral(points), found.segment))
    planarity = _planarity(points[:, found.segment > 0])
    not_planar = _not_planar(planarity, settings)
    foot = foot_moves(lift, labels, found)
    usual, joint_names = name_bodies(trial.protocol, found.count, foot_turns=foot)
    names = usual if settings.names is None else given_names(settings.names, found.count)
    facts = {
        "count": found.count,
        "names": list(names),
        "joint_names": list(joint_names),
        "joint_markers": _found_joint_markers(labels, found, joint_names)
        | _joint_markers(labels, settings.joint_markers, joint_names),
        "links": _links(labels, found),
        "bad_stretches": list(view.bad),
        "confidence": found.confidence.value,
        "against": dict(found.confidence.against),
        "planarity": planarity,
        "joint_confidences": list(found.confidence.joints),
        "joint_ratios": list(found.ratios),
        "asymmetry_deg": [float(a) if np.isfinite(a) else None for a in asymmetries],
        "noise_floor_m": found.base.noise,
        "static_gap": found.base.gap if np.isfinite(found.base.gap) else None,
        "hypotheses": [_hypothesis(h, found.hypotheses[0], labels) for h in found.hypotheses],
    }
    doubts = _doubts(found, joint_names) + _asymmetric(asymmetries, names, settings.asymmetry_deg)
    doubts += contradicted_names(labels, found.segment, usual, found.confidence.value)
    doubts += _upside_down(points, found.segment)
    reasons = (*_bursts(recorded), *bad_marker_notes(view.bad), *lift_reasons(lift, moves=foot), *not_planar, *doubts)
    return (Table(SEGMENTS, _columns(done, labels, out, names), facts, reasons),)


def _columns(
    done: SegmentedMarkers, labels: tuple[str, ...], out: list[int], names: tuple[str, ...]
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of segments.parquet; the user leaves the markers ``out``."""
    why = [
        "left out by `segment: ignore`"
        if marker in out
        else _reason(done.found, marker, names) + left_out_words(label, done.view.bad)
        for marker, label in enumerate(labels)
    ]
    return {
        "marker": np.array(labels, dtype=object),
        "segment": done.found.segment,
        "residual": done.found.residual,
        "reason": np.array(why, dtype=object),
    }


def _plane(points: FloatArray, out: list[int]) -> ComplexArray:
    """Return the frames (f, M) in the plane, m; NaN for the markers ``out`` that the user leaves out."""
    plane = np.asarray(points[..., 0] + 1j * points[..., 1])
    plane[:, out] = np.nan
    return plane


def _planarity(points: FloatArray) -> float:
    """Return the out-of-plane share of the motion of trajectories (F, K, 3)."""
    visible = np.isfinite(points)
    counts = np.maximum(visible.sum(axis=0), 1)
    mean = np.where(visible, points, 0).sum(axis=0) / counts
    motion = np.where(visible, (points - mean) ** 2, 0).sum(axis=(0, 1))
    return float(motion[2] / motion.sum())


def _not_planar(planarity: float, settings: SegmentSettings) -> tuple[Reason, ...]:
    """Refuse a chain that moves far out of its plane; return a caution for smaller motion."""
    found = f"{100 * planarity:.1f} % of the chain's motion leaves the plane"
    if planarity > settings.planarity_limit:
        raise Refused(
            "not-planar",
            f"{found}: too much for a planar chain (limit {100 * settings.planarity_limit:.0f} %). If the joints turn "
            "about several axes, set `space: 3d`.",
            planarity,
            settings.planarity_limit,
        )
    if planarity <= settings.planarity_caution:
        return ()
    return (
        Reason(
            "not-planar",
            f"{found} (usually at most {100 * settings.planarity_caution:.0f} %): angles and lengths are those of its "
            "projection.",
            planarity,
            settings.planarity_caution,
        ),
    )


def _with_hint_at_space(refused: Refused, planarity: float) -> Refused:
    """Return the refusal with a hint at trials in space."""
    text = (
        f"{refused} {100 * planarity:.0f} % of the markers' motion leaves the plane: for an arm, or another chain "
        "whose joints turn about several axes, set `space: 3d`."
    )
    return Refused(refused.code, text, refused.value, refused.limit)


def _lateral(points: FloatArray) -> FloatArray:
    """Return the mean out-of-plane coordinate of each marker (M,), m; NaN for a marker that is never visible."""
    z = points[..., 2]
    visible = np.isfinite(z)
    counts = visible.sum(axis=0)
    return np.where(counts > 0, np.where(visible, z, 0).sum(axis=0) / np.maximum(counts, 1), np.nan)


def _bursts(view: Trajectories) -> tuple[Reason, ...]:
    """Return a note about the samples in bursts, with the marker that has most of them."""
    visible = np.asarray(view.planar.values["visible"], dtype=np.bool_)
    counts = np.count_nonzero(view.bursts & visible, axis=0)
    if not counts.any():
        return ()
    worst = int(np.argmax(counts))
    first = view.time[np.argmax(view.bursts[:, worst])]
    return (
        Reason(
            "bursts",
            f"{int(counts.sum())} samples jump away and back; they were left out of the segments and the joint fit. "
            f"Most are of {view.labels[worst]}, first at {first:.2f} s.",
            float(counts.sum() / np.count_nonzero(visible)),
            level="ok",
        ),
    )


def _sorted(
    plane: ComplexArray,
    lateral: FloatArray,
    rules: SegmentationRules,
    constraints: Constraints,
    settings: SegmentSettings,
) -> Segmentation:
    """Return the segmentation; a refusal mentions the user's hints if there are any."""
    try:
        return segment_markers(plane, lateral, rules, constraints)
    except Refused as refused:
        if not (settings.together or settings.apart or settings.ignore):
            raise
        text = f"{refused} The settings `together`, `apart` and `ignore` were applied."
        raise Refused(refused.code, text, refused.value, refused.limit) from refused


def _joint_markers(
    labels: tuple[str, ...], given: Mapping[str, tuple[str, ...]], joint_names: Sequence[str]
) -> dict[str, list[str]]:
    """Return the labels of the markers around each joint that has any."""
    unknown = [name for name in given if name not in joint_names]
    if unknown:
        raise ConfigError(
            f"segment: joint_markers: there is no joint {', '.join(unknown)}; expected one of {', '.join(joint_names)}"
        )
    return {
        name: [labels[i] for i in find_markers(labels, patterns, f"segment: joint_markers: {name}")]
        for name, patterns in given.items()
    }


def _found_joint_markers(
    labels: tuple[str, ...], found: Segmentation, joint_names: Sequence[str]
) -> dict[str, list[str]]:
    """Return the labels of the markers that the motion shows to be at a joint."""
    pins = () if found.links is None else found.links.pins
    return {joint_names[pin.joint]: [labels[m] for m in pin.unit] for pin in pins}


def _links(labels: tuple[str, ...], found: Segmentation) -> dict[str, Any] | None:
    """Return the first guess of the joint fit if a segment has a single marker: centres and marker coordinates, m."""
    if found.links is None:
        return None
    state, assigned = found.links.state, np.flatnonzero(found.segment >= 0)
    return {
        "centres": as_xy(state.centres).tolist(),
        "local": {labels[m]: as_xy(state.local[m]).tolist() for m in assigned},
    }


def _reason(found: Segmentation, marker: int, names: tuple[str, ...]) -> str:
    """Return in words why a marker is on its segment."""
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
    return f"rigid with {names[k]} to {1e3 * found.residual[marker]:.1f} mm rms"


def _hypothesis(hypothesis: Hypothesis, best: Hypothesis, labels: tuple[str, ...]) -> dict[str, Any]:
    """Return a hypothesis about the segments, for the summary and the report."""
    return {
        "segments": len(hypothesis.chain) + 1,
        "cost": hypothesis.cost,
        "why": hypothesis.explain_cost(best),
        "joint_residual_m": [joint.residual for joint in hypothesis.joints],
        "arc_deg": [float(np.degrees(joint.arc)) for joint in hypothesis.joints],
        "markers": [[labels[m] for m in body.markers] for body in hypothesis.chain],
        "left_out": [[labels[m] for m in body.markers] for body in hypothesis.left_out],
    }


def _upside_down(points: FloatArray, segment: IntArray) -> tuple[Reason, ...]:
    """Return a caution for a chain that hangs below its base, unlike a person on the ground."""
    height = np.array([np.nanmean(points[:, segment == k, 1]) for k in (0, int(segment.max()))])
    if height[1] >= height[0]:
        return ()
    return (
        Reason(
            "upside-down",
            f"the chain hangs {height[0] - height[1]:.2f} m below its base: for a standing person the vertical "
            "axis is wrong (`planarise: {vertical: …}`).",
            float(height[0] - height[1]),
            0.0,
        ),
    )


def _doubts(found: Segmentation, joint_names: tuple[str, ...]) -> tuple[Reason, ...]:
    """Return a caution if the segments are more likely wrong than right, with the strongest evidence against them."""
    confidence = found.confidence
    if confidence.value >= UNSURE:
        return ()
    weakest = int(np.argmin(confidence.joints))
    on_none = int(np.sum(found.segment < 0))
    gravest = max(confidence.against, key=lambda evidence: confidence.against[evidence])
    why = {
        "skipped": f"without the segment beyond the {joint_names[weakest]} the markers fit only "
        f"{found.ratios[weakest]:.1f} times worse",
        "left-out": f"{on_none} markers are on no segment, and many of them are not on a side limb either",
        "axis": f"a marker near the {joint_names[0]} could also be on the other side of it",
        "first-joint": f"the {joint_names[0]} is not a fixed point: it moves by "
        f"{1e3 * (found.hypotheses[0].joints[0].residual if found.hypotheses else np.nan):.0f} mm",
        "base": f"the first moving marker moves only {found.base.gap:.1f} times as much as the last marker of the base",
        "runner-up": "another number of segments explains the markers about as well",
        "links": f"no marker shows the {_loose(found, joint_names)}; add a marker there",
        "ankle": f"the {joint_names[0]} turns little and no marker is at it; add a marker there",
    }[gravest]
    return (
        Reason(
            "segments-unsure",
            f"the segments are doubtful: {why}. Check the skeleton; if it is wrong, set `segment: {{count: …}}`, or "
            "name markers that are `together` or `apart`, or markers to `ignore`.",
            confidence.value,
            UNSURE,
        ),
    )


def _loose(found: Segmentation, joint_names: tuple[str, ...]) -> str:
    """Return the names of the joints that no marker shows."""
    return " and the ".join(joint_names[joint] for joint in (found.links.loose if found.links else ()))


def _asymmetric(asymmetries: FloatArray, names: tuple[str, ...], limit: float) -> tuple[Reason, ...]:
    """Return a caution for sides that do not move together, since one sagittal segment represents both."""
    apart = np.flatnonzero(asymmetries > limit)
    if not len(apart):
        return ()
    worst = int(apart[np.argmax(asymmetries[apart])])
    return (
        Reason(
            "segments-unsure",
            f"left and right do not move together: the rotations of the two sides of the {names[worst + 1]} differ by "
            f"{asymmetries[worst]:.1f}° rms. One segment represents both; its angle is their mean.",
            float(asymmetries[worst]),
            limit,
        ),
    )
