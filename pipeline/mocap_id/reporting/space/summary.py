"""Joints, lengths, angles and landmarks of a trial in space for ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.reporting.numbers import NOT_FINITE, to_number, to_numbers
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import AngleEntry, ImuEntry, LandmarkEntry
from mocap_id.reporting.summary_schema import JointEntry, LengthEntry
from mocap_id.results import join_sentences, why_unknown
from mocap_id.store.spatial_views import MEANINGLESS_AT_POLE, SpatialAngles

AXES = {"ball": 0, "hinge": 1, "two-axis": 2}
"""Number of axes of each kind of joint."""

_HIDDEN = "the motion does not determine the centre of this joint: use `calibration:`, or record a larger motion"


def summarise_joints(data: ReportData) -> list[JointEntry] | None:
    """Return the joints; None if no chain was found."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return None
    weighed = data.facts("chain.h5").get("evidence") or {}
    named = zip(skeleton.joints, skeleton.chain.joints, skeleton.arc, strict=True)
    return [_summarise_joint(name, joint, float(arc), weighed.get(name) or {}) for name, joint, arc in named]


def _summarise_joint(name: str, joint: SpatialJoint, arc: float, weighed: Mapping[str, Any]) -> JointEntry:
    centre, sd = (to_numbers(each) if joint.known else None for each in (joint.centre, _compute_sd(joint.covariance)))
    axes = [to_numbers(axis) for axis in (joint.first_axis, joint.second_axis)[: AXES[joint.kind]]]
    arc_deg = to_number(np.degrees(arc))
    axis = axes[0] if len(axes) == 1 else axes
    why = (
        why_unknown(NOT_FINITE if joint.known else _HIDDEN, centre, sd),
        why_unknown("axis: a ball has no axis" if not axes else "axis: " + NOT_FINITE, *(axes or [None])),
        why_unknown(f"arc_deg: {NOT_FINITE}", arc_deg),
    )
    return JointEntry(
        name=name,
        parent=joint.parent,
        kind=joint.kind,
        centre_m=centre,
        sd_m=sd,
        axis=None if not axes or None in axes else axis,  # type: ignore[arg-type]
        axis_sd_deg=[
            spread for each in joint.axes_covariance[: len(axes)] if (spread := compute_axis_sd(each)) is not None
        ],
        glide_m=_read_glide(joint.glide, joint.glide),
        glide_sd_m=_read_glide(joint.glide, _compute_sd(joint.glide_covariance)),
        arc_deg=arc_deg,
        known=joint.known,
        evidence={str(kind): cost for kind, value in weighed.items() if (cost := to_number(value)) is not None},
        why=join_sentences(why),
    )


def _read_glide(glide: FloatArray, values: FloatArray) -> list[float]:
    """Return ``values`` as a list; empty if ``glide`` is zero, because the joint then has no glide."""
    return (to_numbers(values) or []) if np.any(glide) else []


def _compute_sd(covariance: FloatArray) -> FloatArray:
    variance = np.diagonal(covariance)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def compute_axis_sd(covariance: FloatArray) -> float | None:
    """Return the standard deviation of an axis's direction, degrees, from its covariance (3, 3); None if unknown."""
    return to_number(np.degrees(np.sqrt(np.trace(covariance) / 2)))


def summarise_lengths(data: ReportData) -> dict[str, LengthEntry] | None:
    """Return the lengths of the segments; None if no chain was found."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return None
    why = "the motion does not determine both ends of the segment"
    lengths = skeleton.lengths.items()
    return {name: LengthEntry.explain(why, value=to_number(length), sd=to_number(sd)) for name, (length, sd) in lengths}


def summarise_angles(data: ReportData) -> dict[str, AngleEntry]:
    """Return the statistics of every angle; empty without ``angles.parquet``."""
    found = data.angles
    return {} if found is None else {name: _summarise_angle(found, k) for k, name in enumerate(found.names)}


def _summarise_angle(found: SpatialAngles, k: int) -> AngleEntry:
    """Return the statistics of one angle.

    A constant error of a segment's frame changes an angle by different amounts in different poses. The errors at both
    ends of a range have a correlation of about 0.5, so the range has about the same standard deviation as each end.
    """
    name = found.names[k]
    usable = found.find_usable(name)
    share = float(usable.mean()) if len(usable) else 0.0
    if not usable.any():
        why = "the angle is unknown in every sample"
        if name in MEANINGLESS_AT_POLE and np.isfinite(found.mean[:, k, 0]).any():
            why = "the elevation is within 15° of 0 or 180° in every sample, where this angle has no meaning"
        nothing = dict.fromkeys(("low_deg", "high_deg", "range_deg", "interval_deg", "sd_deg", "constant_sd_deg"))
        return AngleEntry(**nothing, used_share=share, why=why)
    turned = found.mean[usable, k, 0]
    values = np.degrees(shift_to_shortest_arc(turned) if name in MEANINGLESS_AT_POLE else turned)
    sd = np.degrees(found.sd[usable, k, 0])
    ends = [int(values.argmin()), int(values.argmax())]
    low, high = (float(values[end]) for end in ends)
    constant = to_number(np.degrees(np.sqrt(np.mean(np.square(found.constant_sd[usable, k])))))
    spread = None if constant is None else to_number(np.linalg.norm([*sd[ends], constant]))
    interval = None if spread is None else [max(high - low - NORMAL_95 * spread, 0.0), high - low + NORMAL_95 * spread]
    typical = to_number(np.sqrt(np.mean(np.square(sd))))
    return AngleEntry(
        low_deg=low,
        high_deg=high,
        range_deg=high - low,
        interval_deg=interval,
        sd_deg=typical,
        constant_sd_deg=constant,
        used_share=share,
        why=why_unknown("the standard deviation is unknown", interval, typical, constant),
    )


def summarise_landmarks(data: ReportData) -> dict[str, LandmarkEntry]:
    """Return the anatomical landmarks by name; empty if there are none."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return {}
    rows = zip(
        skeleton.landmarks, skeleton.landmark_segment, skeleton.landmark_local, skeleton.landmark_sd, strict=True
    )
    return {
        name: LandmarkEntry.explain(
            "the landmark is not visible in a still pose or a pointer trial",
            segment=skeleton.segments[int(segment)],
            local_m=to_numbers(local),
            sd_m=to_number(sd),
        )
        for name, segment, local, sd in rows
    }


def summarise_imus(data: ReportData) -> dict[str, ImuEntry]:
    """Return the inertial sensors by segment; empty if there are none."""
    return {name: ImuEntry(**entry) for name, entry in data.facts("states.parquet").get("imus", {}).items()}
