"""Contents of a report: its files and figures, in reading order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

PdfFonts: TypeAlias = Literal["type-3", "truetype"]
"""Font type of the text in a PDF."""


@dataclass(frozen=True)
class FigureEntry:
    """Name (stem of its files), title and caption of one figure of the report."""

    name: str
    title: str
    caption: str


FIGURES: tuple[FigureEntry, ...] = (
    FigureEntry(
        "skeleton",
        "Skeleton over the markers",
        "Recovered chain, if one was found, in the plane of motion at two instants. Dots: measured markers. Small "
        "circles: the same markers predicted by the chain. Large circles: joint centres. Crosses: markers without a "
        "segment. Grey is the base; every other colour is one segment, here and in all figures below.",
    ),
    FigureEntry(
        "recovery",
        "How each joint was found",
        "Top: markers of a segment in the frame of the previous segment, where they move on arcs about the joint "
        "(large circle). Pluses: centres of circles fitted to single markers, if near the joint. Bottom: the same "
        "markers in the frame of their own segment, where the markers of a rigid body would not move. Small circles: "
        "markers of the chain. Large circles: joints at either end.",
    ),
    FigureEntry(
        "states",
        "Joint states",
        "Angle, velocity and acceleration of every joint with 95 % confidence bands. Shaded: intervals in which a "
        "joint angle is not observed by any marker and is bridged; the band shows its uncertainty. The bottom panel "
        "shows which joint is bridged.",
    ),
    FigureEntry(
        "repetitions",
        "Repetitions",
        "Joint angles of each repetition (thin lines) over normalised time, with mean (thick line) and one standard "
        "deviation (band). Dotted: mean time of seat-off, if the movement has one. Red: angles from another system, "
        "if given, as mean and one standard deviation.",
    ),
    FigureEntry(
        "phases",
        "Wrench and torques over a repetition",
        "Mean and one standard deviation over complete repetitions: ground reaction wrench and centre of pressure "
        "(measured, identified model, allometric reference), and joint torques of the model. During chair contact, "
        "the models give the sum of ground and chair forces.",
    ),
    FigureEntry(
        "residuals",
        "Residual of each marker",
        "Distance between measured and predicted markers: root mean square (bar) and 95 % quantile (tick). An "
        "unusually long bar is a marker that slides, is swapped or is assigned to the wrong segment.",
    ),
    FigureEntry(
        "wrench",
        "Ground reaction wrench and centre of pressure",
        "Wrench of the ground on the body about the origin of the plane frame: measured, identified model with its "
        "95 % confidence band, and allometric reference, if one applies. Shaded: samples used for identification. "
        "Outside them, a chair may carry part of the modelled force.",
    ),
    FigureEntry(
        "parameters",
        "Base parameters",
        "Identified base parameters with 95 % confidence intervals. Crosses: allometric reference, if one applies.",
    ),
    FigureEntry(
        "point_masses",
        "Point masses",
        "One physically consistent set of point masses with the identified base parameters, in the frame of each "
        "segment (origin at its proximal joint, +y towards the next joint). Grey dots: points without mass.",
    ),
)

SUMMARY_FILE, PAGE_FILE, CAPTIONS_FILE = "summary.json", "report.html", "figures/captions.md"
FILES: tuple[str, ...] = (SUMMARY_FILE, PAGE_FILE)
"""Files of every report; figures for papers are written on request."""
