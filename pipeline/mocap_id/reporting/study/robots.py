"""``robot.html``, the same tables in Markdown for pages such as docs/robot.md, and the figures (thesis 5.2 to 5.6).

A sentence replaces a missing figure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Band, Dash, Drawing, Drawings, Figure, Item, Line, Panel, Points, Text, thin_curve
from mocap_id.reporting.grids import UNKNOWN, Grid, GridColumn, numbers, show_fixed, texts, to_number
from mocap_id.reporting.page import Page, Section
from mocap_id.reporting.study import TrialEntry, count_passed

if TYPE_CHECKING:
    from mocap_id.reporting.results import ResultTable

LEGEND = (
    "Mean (standard deviation). Values: over the trials of a cell; errors: over all samples of these trials. P: states "
    "from the cameras; R: states from the robot's encoder; Ref.: the reference parameters on the same states. States "
    "are compared with the truth if it is known, else with the encoder. The rows of the thesis are below the rows of "
    "this program; ? is a number that is not readable in the thesis. Cells without a row of the thesis (the fast "
    "shoulder) were not measured there."
)
_FOOTER = (
    "The same numbers in SI units are in the CSV and Parquet files beside this page, which validation.json describes."
)
_RECOVERY = (
    "Above: paths of the markers in the plane, with crosses for stationary markers, colours for markers of the moving "
    "body, and a circle for the joint centre. Beside it: the moving markers in the frame of their segment. Below: "
    "angle, velocity and acceleration by the smoother (blue), and by low-pass and differences at 20 Hz (red)."
)
_WRENCH = (
    "Mean over the repetitions of the cell's trials, with one standard deviation on each side as a band. Measured "
    "(black), reference parameters (orange), states from the encoder (R, green), states from the cameras (P, blue)."
)
_ERRORS = "The same models minus the measured wrench: mean and one standard deviation over the repetitions."
_ACCELERATIONS = (
    "Angular acceleration in one trial: by the smoother (P, blue), and by a 20 Hz low-pass and differences of the "
    "angles (red, dotted); the truth, if known, in black. Below: the error of each against the truth."
)
_QUANTITIES = ("angle (rad)", "velocity (rad/s)", "acceleration (rad/s²)")
_COMPONENTS = ("Fx (N)", "Fy (N)", "τz (N·m)")
_WRENCH_LOOKS: Mapping[str, tuple[str, Dash, float]] = {
    "measured": (style.MEASURED, "-", 1.0),
    "Ref.": (style.ORANGE, "-", 1.6),
    "R": (style.GREEN, "--", 1.4),
    "P": (style.BLUE, "-", 1.0),
}
_STATE_LOOKS: Mapping[str, tuple[str, Dash, float]] = {"Diff.": (style.OTHER, "-", 0.6), "P": (style.BLUE, "-", 1.1)}
_ACCELERATION_LOOKS: Mapping[str, tuple[str, Dash, float]] = {
    "Diff.": (style.OTHER, ":", 0.7),
    "P": (style.BLUE, "-", 1.1),
}


@dataclass(frozen=True)
class StateTraces:
    """States of a trial in the robot's frame: angle, velocity and acceleration, rad, rad/s and rad/s²."""

    trial: str
    time: FloatArray  # (T,) s
    curves: Mapping[str, FloatArray]  # (T, 3) states by method
    truth: FloatArray | None  # (T, 3) true states; None if unknown


@dataclass(frozen=True)
class Recovery:
    """Markers, joint centre and states of one trial."""

    joint: str
    speed: str
    paths: Mapping[str, FloatArray]  # (F, 2) path of each marker in the plane, m
    segment: Mapping[str, int]  # segment of each marker, 0 = base
    local: Mapping[str, FloatArray]  # (2,) coordinates of each marker in its segment's frame, m
    centre: FloatArray  # (2,) centre of the joint, plane frame, m
    traces: StateTraces


@dataclass(frozen=True)
class AveragedWrench:
    """Wrench over the R repetitions of the trials of one cell, in the robot's frame, N and N·m."""

    cell: str  # joint, orientation and speed, a row of the thesis's tables
    repetitions: int
    phase: FloatArray  # (P,) % of a repetition
    measured: FloatArray  # (R, P, 3) Fx, Fy, tauz
    models: Mapping[str, FloatArray]  # (R, P, 3) modelled wrench, by the labels of the thesis
    errors: Mapping[str, FloatArray]  # (R, P, 3) model minus measurement


@dataclass(frozen=True)
class RobotStudyData:
    """The data for the page of a robot study."""

    study: str
    trials: tuple[TrialEntry, ...]
    overview: ResultTable  # the table `trials`
    tables: Mapping[str, ResultTable]  # each of the thesis's tables by its title
    recoveries: tuple[Recovery, ...]
    averaged: AveragedWrench | None  # None without a complete repetition
    traces: StateTraces | None  # None if no trial has results


def render_robot_page(data: RobotStudyData) -> bytes:
    """Return the HTML page in UTF-8."""
    against = set(data.overview.frame["against"]) - {""}
    lead = "Neither truth nor encoder is known, so the errors of the states are unknown."
    if "truth" in against:
        lead = "Simulated trials: the errors are differences from the exact truth."
    elif "encoder" in against:
        lead = "The truth is not known. The states from the cameras are compared with the encoder; R has no comparison."
    figures = draw_robot_figures(data)
    first, *tables = _list_grids(data)
    return Page(
        name=data.study,
        headline=count_passed(data.trials),
        lead=lead,
        command="validate robot",
        level="ok" if all(trial.passed for trial in data.trials) else "caution",
        sections=(
            Section("trials", "Trials", (first,)),
            Section("tables", "Tables", tuple(tables), text=(LEGEND,)),
            Section("figures", "Figures", figures=tuple(one.name for one in figures.all)),
        ),
        trials=data.trials,
        figures=figures,
        footer=_FOOTER,
    ).render()


def _list_grids(data: RobotStudyData) -> Iterator[Grid]:
    """Yield the table of every trial with states from the cameras, and the thesis's tables."""
    trials = data.overview.frame
    yield data.overview.grid(
        "Every trial, with states from the cameras; errors of my₂ and Izz₂ ± sd, relative to the reference",
        "trial verdict codes base base_error",
        numbers("acceleration r²", "ddtheta_r2", 4),
        "condition",
        GridColumn("error of my₂ (%)", lambda row: _show_error(row, "my2")),
        GridColumn("error of Izz₂ (%)", lambda row: _show_error(row, "Izz2")),
        texts("Izz₂ is", "Izz2_verdict", UNKNOWN),
        numbers("torque r²", "torque_r2", 4),
        "encoder_offset",
        rows=trials[trials["method"] == "cameras"],
    )
    for title, table in data.tables.items():
        yield table.grid(title, *table.heads)


def _show_error(row: Mapping[str, Any], name: str) -> str:
    """Format the error of a parameter with its standard deviation, in per cent of the reference."""
    value, reference, sd = (to_number(row[key]) for key in (name, f"{name}_reference", f"{name}_sd"))
    if value is None or not reference or sd is None:
        return UNKNOWN
    return f"{show_fixed(100 * (value / reference - 1), 2)} ± {show_fixed(100 * sd / reference, 2)}"


def render_markdown(data: RobotStudyData, figures: Mapping[str, str]) -> str:
    """Return the tables and the ``figures`` (file by title) in Markdown."""
    parts = [LEGEND]
    for grid in _list_grids(data):
        if grid.rows:
            head = "| " + " | ".join(grid.head) + " |"
            line = "|" + "|".join("---" if k in grid.text else "--:" for k in range(len(grid.head))) + "|"
            rows = ("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in grid.rows)
            parts.append("\n".join([f"**{grid.caption}**", "", head, line, *rows]))
    parts += [f"![{name}]({file})" for name, file in figures.items()]
    return "\n\n".join(parts) + "\n"


def draw_robot_figures(data: RobotStudyData) -> Drawings:
    """Return all figures of the page."""
    drawings = []
    for k, one in enumerate(data.recoveries, start=1):
        title = style.clean(f"Kinematic recovery: {one.speed} swing of the {one.joint} ({one.traces.trial})")
        drawings.append(Drawing(f"recovery-{k}", title, _RECOVERY, _draw_recovery(one)))
    wrench: Figure | str = "No repetition is complete in any trial that has results."
    errors, cell, averaged = wrench, "", data.averaged
    if averaged is not None:
        cell = f": {averaged.cell}, {averaged.repetitions} swings"
        wrench = _draw_wrench(averaged, {"measured": averaged.measured, **averaged.models})
        errors = _draw_wrench(averaged, averaged.errors)
    drawings.append(Drawing("wrench", f"Measured and recovered contact wrench{cell}", _WRENCH, wrench))
    drawings.append(Drawing("residuals", f"Errors of the recovered contact wrench{cell}", _ERRORS, errors))
    figure = "No trial has results." if data.traces is None else _draw_accelerations(data.traces)
    drawings.append(Drawing("accelerations", "Acceleration by the smoother and by differences", _ACCELERATIONS, figure))
    return Drawings(style.clean(data.study), tuple(drawings))


def _draw_recovery(one: Recovery) -> Figure:
    """Return markers in the plane and in the segment side by side, and below them the states (figures 5.2 and 5.3)."""
    still = [np.nanmean(path, axis=0) for label, path in one.paths.items() if one.segment[label] == 0]
    moving = [path for label, path in one.paths.items() if one.segment[label] > 0]
    x, y = np.array(still).reshape(-1, 2).T
    in_plane: tuple[Item, ...] = (
        Points(x, y, style.FAINT, symbol="x"),
        *(Line(path[:, 0], path[:, 1], style.pick_colour(k), width=1.2) for k, path in enumerate(moving, start=1)),
        Points(one.centre[:1], one.centre[1:], style.GREEN, symbol="ring", size=9.0),
    )
    own = {label: local for label, local in one.local.items() if one.segment[label] > 0}
    x, y = np.array(list(own.values())).reshape(-1, 2).T
    in_segment: tuple[Item, ...] = (
        Points(x, y, style.INK, symbol="x"),
        *(Text(float(local[0]), float(local[1]), style.clean(label, 8)) for label, local in own.items()),
        Points(np.zeros(1), np.zeros(1), style.GREEN, symbol="ring", size=9.0),
    )
    markers = (
        Panel(in_plane, "markers and joint", "x (m)", "y (m)", equal=True, height=3.0),
        Panel(in_segment, "in the segment", "x (m)", "y (m)", equal=True, height=3.0),
    )
    rows: list[tuple[Panel, ...]] = [markers]
    for order, quantity in enumerate(_QUANTITIES):  # by every method, the smoother in front
        series = {name: curve[:, order] for name, curve in one.traces.curves.items()}
        lines = tuple(_draw_lines(one.traces, series, _STATE_LOOKS, 150))
        below, height = ("time (s)", 1.5) if order == 2 else ("", 1.2)
        rows.append((Panel(lines, x=below, y=quantity, linked=True, height=height),))
    return Figure(tuple(rows))


def _draw_wrench(averaged: AveragedWrench, series: Mapping[str, FloatArray]) -> Figure:
    """Return mean and one standard deviation of each series (R, P, 3) over the repetition (figures 5.4 and 5.5).

    A series has R repetitions, P phases and the components Fx, Fy, τz.
    """
    panels = []
    for d, title in enumerate(_COMPONENTS):
        items: list[Item] = []
        for name, (colour, dash, width) in _WRENCH_LOOKS.items():
            if name in series:
                mean, sd = series[name][..., d].mean(axis=0), np.std(series[name][..., d], axis=0)
                items.append(Band(averaged.phase, mean - sd, mean + sd, colour, 0.15))
                items.append(Line(averaged.phase, mean, colour, name, dash, width))
        panels.append(Panel(tuple(items), title, "repetition (%)", linked=True, height=2.2))
    return Figure((tuple(panels),))


def _draw_accelerations(traces: StateTraces) -> Figure:
    """Return the accelerations, and their errors if the truth is known (figure 5.6)."""
    series = {name: curve[:, 2] for name, curve in traces.curves.items()}
    curves = _draw_lines(traces, series, _ACCELERATION_LOOKS, 200)
    title, time = f"acceleration (rad/s²): {style.clean(traces.trial)}", "time (s)"
    if traces.truth is None:
        return Figure(((Panel(tuple(curves), title, time, linked=True, height=2.2),),))
    truth = traces.truth[:, 2]
    errors = _draw_lines(traces, {name: curve - truth for name, curve in series.items()}, _ACCELERATION_LOOKS, 200)
    curves.append(Line(*thin_curve(traces.time, truth, 200), style.INK, "truth", width=0.6))
    above = Panel(tuple(curves), title, linked=True, height=1.7)
    return Figure(((above,), (Panel(tuple(errors), "error (rad/s²)", time, linked=True, height=1.9),)))


def _draw_lines(
    traces: StateTraces, series: Mapping[str, FloatArray], looks: Mapping[str, tuple[str, Dash, float]], bins: int
) -> list[Line]:
    """Return a line over time for each series (T,) that has an entry in ``looks``: colour, dash and width."""
    return [
        Line(*thin_curve(traces.time, series[name], bins), colour, name, dash, width)
        for name, (colour, dash, width) in looks.items()
        if name in series
    ]
