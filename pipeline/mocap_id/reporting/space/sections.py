"""Sections of the page of a trial in space."""

from __future__ import annotations

from mocap_id.reporting import segment_tables
from mocap_id.reporting import tables as shared
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.sections import Section, clock, identification, noise, origin, segmentation, sensors
from mocap_id.reporting.space import curls, reaches, tables
from mocap_id.reporting.summary_schema import Summary


def spatial_sections(data: ReportData, summary: Summary) -> list[Section]:
    """Return the sections of the page; a refused trial has fewer, up to the stage that refused."""
    title = "Markers as recorded" if data.spatial_skeleton is None else "Skeleton"
    own = (
        *(tables.joints(summary), tables.glides(summary), tables.axes(summary), tables.kinds(summary)),
        shared.lengths(summary),
    )
    parts = [
        Section("skeleton", title, "planar.parquet", ("skeleton",), own, _unknown(summary)),
        Section(
            "angles", "Angles", "angles.parquet", ("angles", "rates"), (tables.angles(summary), noise(data, summary))
        ),
        *sensors(summary),
        *_reach(data, summary),
        *_curls(data),
        Section("landmarks", "Landmarks", "chain.h5", (), (tables.landmarks(data, summary),), _frames(data, summary)),
        Section("wrench", "Ground reaction wrench", "wrench.parquet", ("wrench",), _wrench(data, summary)),
        Section(
            "parameters",
            "Inertial parameters",
            "dynamics.h5",
            ("parameters",),
            (shared.base_parameters(data, summary), shared.excitation(summary), identification(data)),
        ),
        Section(
            "markers",
            "Markers and segments",
            "segments.parquet",
            ("residuals",) if "markers.parquet" in data.artefacts else (),
            (
                shared.markers(data),
                segment_tables.against(data),
                segment_tables.hypotheses(data),
                segmentation(data),
            ),
        ),
        Section("origin", "Provenance", "", (), origin(data, summary)),
    ]
    return [part for part in parts if not part.needs or part.needs in data.artefacts]


def _reach(data: ReportData, summary: Summary) -> tuple[Section, ...]:
    """Return the section on the reachable volume; nothing for other protocols."""
    if "reach" not in data.facts("events.parquet"):
        return ()
    found = summary.workspace
    own = (
        *(reaches.volumes(found), reaches.ranges(found), reaches.areas(found), reaches.heights(found)),
        *(reaches.targets(found), reaches.list_reaches(data)),
    )
    return (Section("reach", "Reach", "events.parquet", ("reach",), own, reaches.text(found)),)


def _curls(data: ReportData) -> tuple[Section, ...]:
    """Return the section on curls; nothing for other protocols."""
    if "curl" not in data.facts("events.parquet"):
        return ()
    own = (curls.counts(data), curls.compensation(data))
    return (Section("curls", "Curls", "events.parquet", ("phase_portraits",), own),)


def _unknown(summary: Summary) -> tuple[str, ...]:
    """Return a sentence on every joint whose centre the motion does not show."""
    return tuple(f"{joint.name}: {joint.why}." for joint in summary.joints or () if not joint.known)


def _frames(data: ReportData, summary: Summary) -> tuple[str, ...]:
    """Return a sentence on the frames of the segments."""
    if data.facts("chain.h5").get("frames") == "isb":
        return ("The frames of the segments are those of the ISB (Wu et al. 2005), made from these landmarks.",)
    missing = "no landmarks were found" if not summary.landmarks else "the landmarks do not suffice for them"
    return (
        f"The frames of the segments are the program's own, because {missing}. The angles are the coordinates of the "
        "joints and have no anatomical meaning.",
    )


def _wrench(data: ReportData, summary: Summary) -> tuple[shared.Grid, ...]:
    return shared.agreement(data, summary), clock(summary), shared.plates(data)
