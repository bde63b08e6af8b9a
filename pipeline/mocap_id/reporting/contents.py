"""What a report holds: its files and figures, in the order in which they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

PdfFonts: TypeAlias = Literal["type-3", "truetype"]
"""How letters stand in a PDF."""


@dataclass(frozen=True)
class FigureEntry:
    """A figure of the report; ``name`` is its file's stem."""

    name: str
    title: str
    caption: str


FIGURES: tuple[FigureEntry, ...] = (
    FigureEntry(
        "skeleton",
        "Skeleton over the markers",
        "The recovered chain, where there is one, in the plane of motion at two moments. Filled dots are markers as "
        "measured, open circles the same markers as the chain predicts them, large rings the joint centres. Grey "
        "belongs to the base; each other colour to one segment, here and in every figure below; crosses are markers "
        "without a segment.",
    ),
    FigureEntry(
        "recovery",
        "How each joint was found",
        "Above: the markers of a segment as seen from the segment before, where they move on arcs about the joint "
        "(ring); pluses are the middles of the circles that fit single markers, where the arc gives one near by. "
        "Below: the same markers as seen from their own segment, where a rigid body would leave single points; circles "
        "are the markers of the chain, rings the joints at either end.",
    ),
    FigureEntry(
        "states",
        "Joint states",
        "Angle, velocity and acceleration of every joint with 95 % bands. Shaded where a joint has no marker to rest "
        "on: the curve is bridged there, and its band says how little is known. The strips tell which joint.",
    ),
    FigureEntry(
        "repetitions",
        "Repetitions",
        "Joint angles of each repetition (thin) on a common time, with their mean (thick) and one standard deviation. "
        "Dotted: mean time of seat-off, where the movement has one. Red, where the trial gives a file of another "
        "system: its angles as they are, mean and one standard deviation.",
    ),
    FigureEntry(
        "phases",
        "Wrench and torques over a repetition",
        "Mean and one standard deviation over the whole repetitions, from start to end: the ground's wrench and centre "
        "of pressure as measured, by the identified model and by the allometric reference, and the model's joint "
        "torques. While a chair is touched, the models hold what ground and chair carry together.",
    ),
    FigureEntry(
        "residuals",
        "Residual of each marker",
        "Distance between measured and predicted markers: root mean square (bar) and 95 % quantile (tick), in "
        "millimetres. A bar that stands out is a marker that slips, is swapped, or sits on the wrong segment.",
    ),
    FigureEntry(
        "wrench",
        "Contact wrench and centre of pressure",
        "Wrench of the ground on the body about the origin of the plane frame: measured, by the identified model with "
        "its 95 % band, and by the allometric reference where one applies. Shaded: samples that the model was "
        "identified on. Elsewhere a chair may carry part of what the models expect the ground to carry.",
    ),
    FigureEntry(
        "parameters",
        "Base parameters",
        "Identified base parameters with 95 % intervals; crosses are the allometric reference where one applies.",
    ),
    FigureEntry(
        "point_masses",
        "Point masses",
        "One physically consistent set of point masses that gives the base parameters, in each segment's own frame "
        "(origin at its proximal joint, +y towards the next joint). Dots without colour carry nothing.",
    ),
)

SUMMARY_FILE, PAGE_FILE, CAPTIONS_FILE = "summary.json", "report.html", "figures/captions.md"
FILES: tuple[str, ...] = (SUMMARY_FILE, PAGE_FILE)
"""What every report has; figures for papers come where they are asked for."""
