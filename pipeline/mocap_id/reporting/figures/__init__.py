"""Figures of the report: their names, captions and drawing functions, in reading order.

A drawing function returns a figure, or a sentence that says why there is no figure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeAlias

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings, Figure
from mocap_id.reporting.figures import motion, skeleton
from mocap_id.reporting.report_data import ReportData

FigureEntry: TypeAlias = tuple[str, Callable[[ReportData], Figure | str], str, str]
"""Declaration of a figure of the report: name (stem of the file names), drawing function, title and caption."""

RESIDUALS: FigureEntry = (
    "residuals",
    skeleton.draw_residuals,
    "Residual of each marker",
    "Distance between measured and predicted markers: root mean square (bar) and 95 % quantile (tick). An "
    "unusually long bar means that the marker slides, is swapped or is assigned to the wrong segment.",
)
"""Figure of the residuals, in the plane and in space."""

FIGURES: tuple[FigureEntry, ...] = (
    (
        "skeleton",
        skeleton.draw_skeleton,
        "Skeleton over the markers",
        "Recovered chain, if one was found, in the plane of motion at two instants. Dots: measured markers. Small "
        "circles: the same markers predicted by the chain. Large circles: joint centres. Crosses: markers without a "
        "segment. Grey is the base; every other colour is one segment, here and in all figures below.",
    ),
    (
        "recovery",
        skeleton.draw_recovery,
        "How each joint was found",
        "Top: markers of a segment in the frame of the previous segment, where they move on arcs about the joint "
        "(large circle). Pluses: centres of circles fitted to single markers, if near the joint. Bottom: the same "
        "markers in the frame of their own segment, where the markers of a rigid body would not move. Small circles: "
        "their positions in the chain. Large circles: joints at either end.",
    ),
    (
        "states",
        motion.draw_states,
        "Joint states",
        "Angle, velocity and acceleration of every joint with 95 % confidence bands. Shaded: intervals in which a "
        "joint angle is not observed by any marker and is bridged; the band shows its uncertainty. The bottom panel "
        "shows which joint is bridged.",
    ),
    (
        "repetitions",
        motion.draw_repetitions,
        "Repetitions",
        "Joint angles of each repetition (thin lines) over normalised time, with mean (thick line) and one standard "
        "deviation (band). Dotted: mean time of seat-off, if the movement has one. Red: angles from another system, "
        "if given, as mean and one standard deviation.",
    ),
    (
        "phases",
        motion.draw_phases,
        "Wrench and torques over a repetition",
        "Mean and one standard deviation over complete repetitions: ground reaction wrench and centre of pressure "
        "(measured, identified model, allometric reference), and joint torques of the model. During chair contact, "
        "the models give the sum of ground and chair forces. Shaded: a torque is unknown in at least one repetition, "
        "because a chair or support that no plate measures may carry part of the body.",
    ),
    RESIDUALS,
    (
        "wrench",
        motion.draw_wrench,
        "Ground reaction wrench and centre of pressure",
        "Wrench of the ground on the body about the origin of the plane frame: measured, identified model with its "
        "95 % confidence band, and allometric reference, if one applies. Shaded: samples used for identification. "
        "Outside them, a chair may carry part of the modelled force.",
    ),
    (
        "torques",
        motion.draw_torques,
        "Joint torques",
        "Torque of the lower on the upper segment at each joint, with its 95 % confidence band. Shaded: a chair or "
        "support that no plate measures carries, or may carry, part of the body. The torques of the joints below it "
        "are unknown there and not drawn.",
    ),
    (
        "parameters",
        motion.draw_parameters,
        "Base parameters",
        "Identified base parameters with 95 % confidence intervals. Crosses: allometric reference, if one applies.",
    ),
    (
        "point_masses",
        motion.draw_point_masses,
        "Point masses",
        "One physically consistent set of point masses with the identified base parameters, in the frame of each "
        "segment (origin at its proximal joint, +y towards the next joint). Grey dots: points without mass.",
    ),
)
"""Figures of a trial in the plane."""

SPATIAL_FIGURES: tuple[FigureEntry, ...] = (
    (
        "skeleton",
        skeleton.draw_spatial_skeleton,
        "Skeleton and markers in three views",
        "Recovered chain, if one was found, at the two extremes of the motion, without perspective: from the side of "
        "+z, from the side of −x, and from above. Dots: measured markers. Large circles: known joint "
        "centres. Grey is the base; every other colour is one segment, here and in the figure of the residuals. "
        "The player above shows the same chain from any side.",
    ),
    (
        "angles",
        partial(motion.draw_derivatives, what="angles", orders=(0,), height=1.9),
        "Angles",
        "Angles of every joint with 95 % confidence bands of their changes; the table has the constant error due to "
        "the landmarks. Grey: intervals in which a segment of the joint is not observed and is bridged. Blue: the "
        "elevation is within 15° of 0 or 180°, where plane and axial rotation of the shoulder have no meaning and are "
        "not drawn.",
    ),
    (
        "rates",
        partial(motion.draw_derivatives, what="velocities and accelerations", orders=(1, 2), height=1.7),
        "Velocities and accelerations",
        "First and second derivatives of the angles above, with 95 % confidence bands. Shades as above.",
    ),
    (
        "reach",
        skeleton.draw_reach,
        "What the wrist can reach",
        "Furthest reach of the wrist from the shoulder in every direction, in the axes of the thorax: by the "
        "ranges of all angles taken independently (grey), and by the recorded postures and the postures between "
        "them (blue). Orange: path of the wrist. Thick: the arm at its furthest reach. Crosses: parts of the body, "
        "from tables of proportions. On the page, drag the figure or use the arrow keys to rotate it.",
    ),
    (
        "phase_portraits",
        motion.draw_phase_portraits,
        "Phase portraits",
        "Acceleration against angle in every complete curl: first third blue, middle third green, last third orange. "
        "Bands: 95 % intervals of the acceleration in the first and the last curl. The shape of a curve "
        "within its band may be noise alone.",
    ),
    RESIDUALS,
    (
        "wrench",
        motion.draw_wrench,
        "Ground reaction wrench",
        "Wrench of the ground on the base about the origin of the trial's frame: measured, and identified model with "
        "its 95 % confidence band. Shaded: samples used for identification.",
    ),
    (
        "parameters",
        motion.draw_parameters,
        "Base parameters",
        "Identified base parameters with 95 % confidence intervals.",
    ),
)
"""Figures of a trial in space in reading order."""

_OF_POSES: Mapping[str, str] = {
    "wrench": "The measured wrench is not filtered.",
    "phases": "The measured wrench is not filtered.",
    "torques": "",
    "parameters": "The parameters are computed from bodies that were fitted with a loose prior.",
    "point_masses": "Each panel is a body of the fit. If a body is not a segment of the chain, its origin is the "
    "centroid of its markers.",
}
_OF_CHAIN: Mapping[str, str] = {
    "parameters": "The parameters contain all information about the body in the wrench.",
}


_ZEROS: Mapping[str, str] = {
    "static": "is zero in the static pose that the configuration gives",
    "standing": "is zero in the mean of the standing phases",
    "segment line": "is zero where the lines of its two segments are parallel. The markers define these lines, so "
    "this zero is arbitrary: compare changes of the angle only, or give a standing pose in `static:`",
}
"""Where the angle of a joint is zero, by the source of the zero."""


def draw_figures(data: ReportData) -> Drawings:
    """Return all figures of a trial in the plane or in space."""
    entries = SPATIAL_FIGURES if data.in_space else FIGURES
    made = (
        Drawing(name, title, _complete_caption(name, caption, data), draw(data))
        for name, draw, title, caption in entries
    )
    return Drawings(style.clean(data.trial), tuple(made))


def _complete_caption(name: str, caption: str, data: ReportData) -> str:
    """Return the caption of a figure, which says where angles are zero and, for the dynamics, how the masses move."""
    sentences = [caption]
    if name in ("states", "repetitions") and data.zeros:
        joints = data.skeleton.joint_names if data.skeleton is not None else ()
        for source, text in _ZEROS.items():
            own = [joint for joint, zero in zip(joints, data.zeros, strict=False) if zero[0] == source]
            if own:
                whose = "every joint" if len(own) == len(data.zeros) else ", ".join(own)
                sentences.append(f"The angle of {whose} {text}.")
        return f"{caption} {' '.join(sentences[1:])}"
    if name not in _OF_POSES or data.facts("dynamics.h5").get("motion") is None:
        return caption
    if name in ("phases", "torques"):
        if data.facts("dynamics.parquet").get("legs") == "both":
            sentences.append("Forces and torques are sums over both legs.")
        missing = data.facts("dynamics.h5").get("untold") or ()
        unknown = [joint for j, joint in enumerate(data.joint_names, start=1) if f"tau_{j}" in missing]
        if unknown:
            sentences.append(f"The fit does not determine the torque of: {', '.join(unknown)}.")
    if data.measured_poses:
        cutoffs = ", ".join(f"{axis} {cutoff:g} Hz" for axis, cutoff in (data.bands or {}).items())
        sentences += [f"The masses move with the measured poses, low-pass filtered ({cutoffs}).", _OF_POSES[name]]
    else:
        sentences += ["The masses move with the pinned chain.", _OF_CHAIN.get(name, "")]
    return " ".join(sentence for sentence in sentences if sentence)
