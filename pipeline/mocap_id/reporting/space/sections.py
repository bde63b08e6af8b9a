"""Sections of the report of a trial in space."""

from __future__ import annotations

from mocap_id.reporting import tables as shared
from mocap_id.reporting.grids import Grid
from mocap_id.reporting.page import Section
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space import curls, reaches, tables
from mocap_id.reporting.summary_schema import Summary


def make_spatial_sections(data: ReportData, summary: Summary, filtering: Grid, sensors: list[Section]) -> list[Section]:
    """Return the sections on chain, angles, sensors, protocol and landmarks.

    Parameters
    ----------
    data : ReportData
    summary : Summary
    filtering : Grid
        Table of the filter's noise.
    sensors : list of Section
        Section on inertial sensors; empty if the trial has none.
    """
    joints = (
        shared.list_joints(summary),
        tables.list_glides(summary),
        tables.list_axes(summary),
        tables.list_kinds(summary),
    )
    missing = tuple(f"{joint.name}: {joint.why}." for joint in summary.joints or () if not joint.known)
    return [
        Section(
            "skeleton",
            "Markers as recorded" if data.spatial_skeleton is None else "Skeleton",
            (*joints, shared.list_lengths(summary)),
            ("skeleton",),
            text=missing,
            needs="planar.parquet",
        ),
        Section(
            "angles", "Angles", (tables.list_angles(summary), filtering), ("angles", "rates"), needs="angles.parquet"
        ),
        *sensors,
        *_make_protocol_section(data, summary),
        Section(
            "landmarks",
            "Landmarks",
            (tables.list_landmarks(data, summary),),
            text=(_describe_frames(data, summary),),
            needs="chain.h5",
        ),
    ]


def _make_protocol_section(data: ReportData, summary: Summary) -> list[Section]:
    """Return the section on the reachable volume or on curls; empty for other protocols."""
    facts, needs = data.facts("events.parquet"), "events.parquet"
    grids: tuple[Grid, ...]
    if "reach" in facts:
        found = summary.workspace
        grids = (
            reaches.list_volumes(found),
            reaches.list_ranges(found),
            reaches.list_areas(found),
            reaches.list_heights(found),
            reaches.list_targets(found),
            reaches.list_reaches(data),
        )
        return [Section("reach", "Reach", grids, ("reach",), text=reaches.describe_volume(found), needs=needs)]
    if "curl" in facts:
        grids = (curls.list_curls(data), curls.list_compensation(data))
        return [Section("curls", "Curls", grids, ("phase_portraits",), needs=needs)]
    return []


def _describe_frames(data: ReportData, summary: Summary) -> str:
    """Return sentences on the coordinate frames of the segments."""
    if data.facts("chain.h5").get("frames") == "isb":
        return "The frames of the segments are the ISB frames (Wu et al. 2005), computed from these landmarks."
    missing = "no landmarks were found" if not summary.landmarks else "the landmarks do not suffice for them"
    return (
        f"The frames of the segments are the program's own, because {missing}. The angles are the joints' own "
        "coordinates and have no anatomical meaning."
    )
