"""Tables of the report about the segments: their confidence, and the segmentations that were considered."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.grids import Grid, GridColumn, number, text, to_grid
from mocap_id.reporting.numbers import show_fixed, show_millimetres
from mocap_id.reporting.report_data import ReportData

SHOWN = frozenset(
    {
        *("names", "confidence", "against", "joint_names", "joint_confidences", "joint_ratios", "hypotheses"),
        *("divisions", "bad_stretches"),
    }
)
"""Facts of ``segments.parquet`` that the table of facts omits: they are in other tables, in reasons or for programs."""

AGAINST: Mapping[str, str] = {
    "skipped": "the segment beyond the joint with the lowest confidence could be omitted at little cost",
    "left-out": "some moving markers belong neither to a segment nor to another limb",
    "axis": "a still marker near the first joint may belong to the moving segment beyond this joint",
    "first-joint": "the first joint is not a fixed point of base and first segment to within 8 mm",
    "base": "the still markers move almost as much as the moving markers",
    "runner-up": "another number of segments fits the markers almost as well",
    "links": "a segment has a single marker, and no marker is at either of its joints",
    "ankle": "joint 1 rotates little, and no marker is at this joint",
}
"""Text for each piece of evidence in :class:`mocap_id.kinematics.confidence.Confidence`."""

_NEGLIGIBLE = 5e-4  # would be shown as 0.000


def list_evidence(data: ReportData) -> Grid:
    """Return a table of the evidence against the segments, strongest first; empty without a search for segments."""
    facts = data.facts("segments.parquet")
    if facts.get("against") is None:
        return Grid()
    reductions = ((off, name) for name, off in facts["against"].items() if off >= _NEGLIGIBLE)
    rows = {AGAINST.get(name, name): off for off, name in sorted(reductions, reverse=True)}
    caption = f"Probability that the segments are right: {show_fixed(facts.get('confidence'), 2)}"
    columns = (
        GridColumn("reduction of the log odds", lambda off: show_fixed(off, 3) if off else "0"),
        GridColumn("factor on the odds", lambda off: show_fixed(np.exp(off), 2) if off else "1"),
    )
    return to_grid(caption, rows or {"none": 0.0}, columns, "evidence against the segments")


def list_joint_confidences(data: ReportData) -> Grid:
    """Return a table of the confidence in each joint, and how much worse the fit is without the segment beyond it."""
    facts = data.facts("segments.parquet")
    if not facts.get("joint_confidences"):  # segments of a calibration are not searched for
        return Grid()
    keys = ("joint_names", "joint_confidences", "joint_ratios")
    columns = (
        text("joint", lambda row: row[0]),
        number("confidence", lambda row: row[1], 2),
        number("residual without the segment, factor", lambda row: row[2]),
    )
    caption = (
        "Confidence in each joint. It is 0.5 if the residual is 3.5 times as large without the segment beyond it "
        "(1.5 times for the last joint)"
    )
    return to_grid(caption, zip(*(facts.get(key) or () for key in keys), strict=True), columns)


def list_hypotheses(data: ReportData) -> Grid:
    """Return a table of the segmentations that were considered, and why they were rejected."""
    columns = (
        GridColumn("segments", lambda entry: str(entry.get("segments", ""))),
        number("cost", "cost", 1),
        text("result", "why"),
        text("joint residuals (mm)", lambda entry: _join(entry.get("joint_residual_m"), show_millimetres)),
        text("arcs (deg)", lambda entry: _join(entry.get("arc_deg"), lambda arc: show_fixed(arc, 1))),
        text("markers by segment", lambda entry: " | ".join(map(_join, entry.get("markers") or ()))),
        text("left out", lambda entry: _join(itertools.chain.from_iterable(entry.get("left_out") or ()))),
    )
    caption = (
        "Segmentations considered, lowest cost first: the best chain at each level of detail for each number of "
        "segments, including the base. A missing number has no chain with valid joints, or was not searched for"
    )
    return to_grid(caption, data.facts("segments.parquet").get("hypotheses") or (), columns)


def _join(values: Iterable[Any] | None, show: Callable[[Any], str] = str) -> str:
    return ", ".join(map(show, values or ()))
