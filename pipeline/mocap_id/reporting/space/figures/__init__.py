"""Figures of a trial in space; residuals, wrench and parameters are drawn as in the plane."""

from __future__ import annotations

from mocap_id.reporting.figures import RESIDUALS, FigureEntry, parameters, wrench
from mocap_id.reporting.space.figures import angles, reach, skeleton

FIGURES: tuple[FigureEntry, ...] = (
    FigureEntry(
        "skeleton",
        skeleton.draw,
        "Skeleton and markers in three views",
        "Recovered chain, if one was found, at the two extremes of the motion, without perspective: from the side of "
        "+z, from the side of −x, and from above. Dots: measured markers. Large circles: known joint "
        "centres. Grey is the base; every other colour is one segment, here and in the figure of the residuals. "
        "The player above shows the same chain from any side.",
    ),
    FigureEntry(
        "angles",
        angles.draw,
        "Angles",
        "Angles of every joint with 95 % confidence bands of their changes; the table has the constant error due to "
        "the landmarks. Grey: intervals in which a segment of the joint is not observed and is bridged. Blue: the "
        "elevation is within 15° of 0 or 180°, where plane and axial rotation of the shoulder have no meaning and are "
        "not drawn.",
    ),
    FigureEntry(
        "rates",
        angles.draw_rates,
        "Velocities and accelerations",
        "First and second derivatives of the angles above, with 95 % confidence bands. Shades as above.",
    ),
    FigureEntry(
        "reach",
        reach.draw,
        "What the wrist can reach",
        "Furthest reach of the wrist from the shoulder in every direction, in the axes of the thorax: by the "
        "ranges of all angles taken independently (grey), and by the recorded postures and the postures between "
        "them (blue). Orange: path of the wrist. Thick: the arm at its furthest reach. Crosses: parts of the body, "
        "from tables of proportions. On the page, drag the figure or use the arrow keys to rotate it.",
    ),
    FigureEntry(
        "phase_portraits",
        angles.draw_phase_portraits,
        "Phase portraits",
        "Acceleration against angle in every complete curl: first third blue, middle third green, last third orange. "
        "Bands: 95 % intervals of the acceleration in the first and the last curl. The shape of a curve "
        "within its band may be noise alone.",
    ),
    RESIDUALS,
    FigureEntry(
        "wrench",
        wrench.draw,
        "Ground reaction wrench",
        "Wrench of the ground on the base about the origin of the trial's frame: measured, and identified model with "
        "its 95 % confidence band. Shaded: samples used for identification.",
    ),
    FigureEntry(
        "parameters",
        parameters.draw,
        "Base parameters",
        "Identified base parameters with 95 % confidence intervals.",
    ),
)
"""Figures of a trial in space in reading order."""
