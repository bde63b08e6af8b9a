"""Tables of the report about the segments: their confidence, and the segmentations that were considered."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mocap_id.reporting.numbers import show, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.tables import Grid, grid, millimetres

SHOWN = frozenset({"confidence", "against", "joint_confidences", "joint_ratios", "hypotheses"})
"""Facts of ``segments.parquet`` that these tables show."""

AGAINST: Mapping[str, str] = {
    "skipped": "a segment could be omitted at little cost: the one beyond the joint with the least confidence",
    "left-out": "moving markers belong neither to a segment nor to another limb",
    "axis": "a still marker near the first joint may belong to its other side",
    "first-joint": "the first joint is not a fixed point of both bodies to within 8 mm",
    "base": "the still markers are hardly stiller than the moving ones",
    "runner-up": "another number of segments fits the markers almost as well",
    "links": "a segment has a single marker, and no marker is at either of its joints",
    "ankle": "joint 1 turns little, and no marker is at it",
}
"""Text for each piece of evidence in :class:`mocap_id.kinematics.confidence.Confidence`."""

_NEGLIGIBLE = 5e-4  # would be shown as 0.000


def against(data: ReportData) -> Grid:
    """Return the evidence against the segments, strongest first."""
    facts = data.facts("segments.parquet")
    weighed = facts.get("against")
    if weighed is None:
        return grid("", (), ())
    found = sorted(((off, name) for name, off in weighed.items() if off >= _NEGLIGIBLE), reverse=True)
    rows = [(AGAINST.get(name, name), show_fixed(off, 3), show_fixed(np.exp(off), 2)) for off, name in found]
    caption = f"Probability that the segments are right: {show_fixed(facts.get('confidence'), 2)}"
    head = ("evidence against the segments", "reduction of the log odds", "factor on the odds")
    return grid(caption, head, rows or [("none", "0", "1")])


def joints(data: ReportData) -> Grid:
    """Return the confidence in each joint: how much worse the fit is without the segment beyond it."""
    facts = data.facts("segments.parquet")
    if not facts.get("joint_confidences"):  # segments of a calibration are not searched for
        return grid("", (), ())
    keys = ("joint_names", "joint_confidences", "joint_ratios")
    rows = [
        (str(name), show_fixed(confidence, 2), show(ratio))
        for name, confidence, ratio in zip(*(facts.get(key) or () for key in keys), strict=True)
    ]
    caption = (
        "Confidence in each joint. It is 0.5 if the residual is 3.5 times as large without the segment beyond it "
        "(1.5 times for the last joint)"
    )
    return grid(caption, ("joint", "confidence", "residual without the segment, factor"), rows)


def hypotheses(data: ReportData) -> Grid:
    """Return the segmentations that were considered, and why they were rejected."""
    rows = [
        (
            str(entry.get("segments", "")),
            show_fixed(entry.get("cost"), 1),
            str(entry.get("why", "")),
            ", ".join(millimetres(residual) for residual in entry.get("joint_residual_m") or ()),
            ", ".join(show_fixed(arc, 1) for arc in entry.get("arc_deg") or ()),
            " | ".join(", ".join(map(str, body)) for body in entry.get("markers") or ()),
            ", ".join(str(label) for body in entry.get("left_out") or () for label in body),
        )
        for entry in data.facts("segments.parquet").get("hypotheses") or ()
    ]
    caption = (
        "Segmentations considered, lowest cost first: the best chain at each level of detail for each number of "
        "segments, including the base. A missing number has no chain with valid joints, or was not searched for"
    )
    head = ("segments", "cost", "result", "joint residuals (mm)", "arcs (deg)", "markers by segment", "left out")
    return grid(caption, head, rows, range(2, 7))
