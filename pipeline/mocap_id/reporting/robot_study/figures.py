"""The figures of a robot study (thesis figures 5.2 to 5.6); a sentence replaces a missing figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.downsampling import thin_curve
from mocap_id.reporting.figure import Band, Dash, Drawing, Drawings, Figure, Item, Line, Panel, Points, Text
from mocap_id.reporting.robot_study.page_data import AveragedWrench, Recovery, RobotStudyData, StateTraces

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


def draw_robot_figures(data: RobotStudyData) -> Drawings:
    """Return all figures of the page."""
    return Drawings(style.clean(data.study), tuple(_make_drawings(data)))


def _make_drawings(data: RobotStudyData) -> Iterator[Drawing]:
    for k, one in enumerate(data.recoveries, start=1):
        title = style.clean(f"Kinematic recovery: {one.speed} swing of the {one.joint} ({one.trial})")
        yield Drawing(f"recovery-{k}", title, _RECOVERY, _draw_recovery(one))
    wrench: Figure | str = "No repetition is complete in any trial that has results."
    errors, cell, averaged = wrench, "", data.averaged
    if averaged is not None:
        cell = f": {averaged.cell}, {averaged.repetitions} swings"
        wrench = _draw_wrench(averaged, {"measured": averaged.measured, **averaged.models})
        errors = _draw_wrench(averaged, averaged.errors)
    yield Drawing("wrench", f"Measured and recovered contact wrench{cell}", _WRENCH, wrench)
    yield Drawing("residuals", f"Errors of the recovered contact wrench{cell}", _ERRORS, errors)
    accelerations = "No trial has results." if data.traces is None else _draw_accelerations(data.traces)
    yield Drawing("accelerations", "Acceleration by the smoother and by differences", _ACCELERATIONS, accelerations)


def _draw_recovery(one: Recovery) -> Figure:
    """Return markers in the plane and in the segment side by side, and below them the states (figures 5.2 and 5.3)."""
    return Figure(((_draw_plane(one), _draw_segment(one)), *((_draw_states(one.traces, order),) for order in range(3))))


def _draw_plane(one: Recovery) -> Panel:
    still = [np.nanmean(path, axis=0) for label, path in one.paths.items() if one.segment[label] == 0]
    moving = [path for label, path in one.paths.items() if one.segment[label] > 0]
    x, y = np.array(still).reshape(-1, 2).T
    items: tuple[Item, ...] = (
        Points(x, y, style.FAINT, symbol="x"),
        *(Line(path[:, 0], path[:, 1], style.pick_colour(k), width=1.2) for k, path in enumerate(moving, start=1)),
        Points(one.centre[:1], one.centre[1:], style.GREEN, symbol="ring", size=9.0),
    )
    return Panel(items, "markers and joint", "x (m)", "y (m)", equal=True, height=3.0)


def _draw_segment(one: Recovery) -> Panel:
    own = {label: local for label, local in one.local.items() if one.segment[label] > 0}
    x, y = np.array(list(own.values())).reshape(-1, 2).T
    items: tuple[Item, ...] = (
        Points(x, y, style.INK, symbol="x"),
        *(Text(float(local[0]), float(local[1]), style.clean(label, 8)) for label, local in own.items()),
        Points(np.zeros(1), np.zeros(1), style.GREEN, symbol="ring", size=9.0),
    )
    return Panel(items, "in the segment", "x (m)", "y (m)", equal=True, height=3.0)


def _draw_states(traces: StateTraces, order: int) -> Panel:
    """Return angle, velocity or acceleration (``order`` 0, 1 or 2) by every method, the smoother in front."""
    series = {name: curve[:, order] for name, curve in traces.curves.items()}
    below, height = ("time (s)", 1.5) if order == 2 else ("", 1.2)
    return Panel(
        tuple(_draw_lines(traces, series, _STATE_LOOKS, 150)), x=below, y=_QUANTITIES[order], linked=True, height=height
    )


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
