"""The report's tables about the segments themselves: how sure they are, and which other readings were weighed up."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import show, show_fixed
from mocap_id.reporting.tables import Grid, grid, millimetres

SHOWN = frozenset({"confidence", "against", "joint_confidences", "joint_ratios", "hypotheses"})
"""The facts of ``segments.parquet`` that these tables show."""

AGAINST: Mapping[str, str] = {
    "skipped": "a segment could be left out at little cost: its joint is the one with the least confidence",
    "left-out": "moving markers are on no segment, and on no limb at the side",
    "axis": "a still marker near the first joint might as well be on the other side of it",
    "first-joint": "the first joint is no point of both bodies to within 8 mm",
    "base": "the still markers hardly stand out from the moving ones",
    "runner-up": "another number of segments explains the markers about as well",
}
"""Each piece of evidence of :class:`mocap_id.kinematics.confidence.Confidence` in words."""

_NOTHING = 5e-4  # less off the log odds is shown as 0.000


def against(material: Material) -> Grid:
    """What speaks against the segments, the gravest first."""
    facts = material.facts("segments.parquet")
    weighed = facts.get("against")
    if weighed is None:
        return grid("", (), ())
    found = sorted(((off, name) for name, off in weighed.items() if off >= _NOTHING), reverse=True)
    rows = [(AGAINST.get(name, name), show_fixed(off, 3), show_fixed(np.exp(off), 2)) for off, name in found]
    caption = f"Chance that count and assignment of the segments are right: {show_fixed(facts.get('confidence'), 2)}"
    head = ("what speaks against them", "off the log odds", "divides the odds by")
    return grid(caption, head, rows or [("nothing", "0", "1")])


def joints(material: Material) -> Grid:
    """How sure every joint is: what happens to the fit without the segment beyond it."""
    facts = material.facts("segments.parquet")
    keys = ("joint_names", "joint_confidences", "joint_ratios")
    rows = [
        (str(name), show_fixed(confidence, 2), show(ratio))
        for name, confidence, ratio in zip(*(facts.get(key) or () for key in keys), strict=True)
    ]
    caption = (
        "Confidence in each joint: 0.5 where without the segment beyond it the markers fit 3.5 times worse, 1.5 times "
        "for the last one"
    )
    return grid(caption, ("joint", "confidence", "fits worse by a factor of"), rows)


def hypotheses(material: Material) -> Grid:
    """The readings of the recording that were weighed up, and why they lost."""
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
        for entry in material.facts("segments.parquet").get("hypotheses") or ()
    ]
    caption = (
        "Readings that were weighed up, the cheapest first: at each level of detail the best chain of each number of "
        "segments (with the base). A number that is absent has no chain over joints that turn and hold, or was not "
        "looked for"
    )
    head = ("segments", "cost", "why", "joints hold to (mm)", "arcs (deg)", "markers, by segment", "left out")
    return grid(caption, head, rows, range(2, 7))
