"""Repetitions over normalised time: joint angles (figure 6.5), wrench and torques."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Band, Dash, Figure, Item, Line, Panel, Rule, arrange_in_lines
from mocap_id.reporting.figures.states import draw_shades, label_angle
from mocap_id.reporting.report_data import ReportData
from mocap_id.store import Table
from mocap_id.store.views import JointStates

_SPAN = "time in the repetition (%)"
_WRENCH = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_COP_TAIL = 0.02
_SOURCES: tuple[tuple[str, str, Dash, str], ...] = (
    ("", style.MEASURED, "-", "measured"),
    ("_model", style.MODEL, "-", "identified model"),
    ("_reference", style.REFERENCE, "--", "allometric reference"),
)
_COLUMNS = 3
_GRID = np.linspace(0.0, 1.0, 101)


def draw(data: ReportData) -> Figure | str:
    """Return a panel for each joint: repetitions (thin), mean (thick) and one standard deviation (band)."""
    motion, events = data.shown_motion, data.table("events.parquet")
    bounds = np.zeros((0, 2)) if events is None else find_whole_repetitions(events)
    if motion is None or events is None or not motion.mean.size or not len(bounds):
        why = "none were found" if events is not None else data.why_missing("events.parquet")
        return f"No repetitions to compare: {why}."
    curves = np.degrees(normalise_time(motion, bounds))  # (R, 101, n)
    names = data.skeleton.joints if data.skeleton is not None else ()
    panels = []
    for j in range(curves.shape[2]):
        items = [
            *_draw_curves(curves[..., j], style.pick_colour(j + 1)),
            *_draw_other_system(data, j + 1),
            *_draw_seat_off(events),
        ]
        name = style.clean(names[j], 20) if j < len(names) else f"joint {j + 1}"
        panels.append(Panel(tuple(items), name, _SPAN, label_angle(data), x_range=(0, 100), linked=True, height=2.4))
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))


def find_whole_repetitions(events: Table) -> FloatArray:
    """Return start and end, (R, 2), s, of the repetitions for which both are known."""
    bounds = events.stack(["start", "end"])
    whole: FloatArray = bounds[bounds[:, 1] > bounds[:, 0]]  # false if start or end is NaN
    return whole


def normalise_time(motion: JointStates, bounds: FloatArray) -> FloatArray:
    """Return the angles at 0, 1 … 100 % of each repetition, (R, 101, n), rad; NaN where bridged or unknown."""
    at = bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * _GRID  # (R, 101)
    nearest = np.searchsorted(motion.time, at).clip(0, len(motion.time) - 1)
    curves = np.stack([np.interp(at, motion.time, angle, np.nan, np.nan) for angle in motion.angles.T], axis=-1)
    return np.where(motion.observed[nearest], curves, np.nan)


def _draw_curves(curves: FloatArray, colour: str) -> list[Item]:
    """Return the curves (R, 101) of all repetitions as one interrupted line, their mean, and one standard deviation."""
    percent = 100 * _GRID
    count = np.isfinite(curves).sum(axis=0)
    mean = np.nansum(curves, axis=0) / np.where(count > 0, count, np.nan)
    spread = np.sqrt(np.nansum((curves - mean) ** 2, axis=0) / np.where(count > 1, count - 1, np.nan))
    lifted = np.pad(curves, ((0, 0), (0, 1)), constant_values=np.nan)
    each = Line(np.tile([*percent, np.nan], len(curves)), lifted.ravel(), colour, width=0.6, opacity=0.6)
    return [each, Band(percent, mean - spread, mean + spread, colour, 0.2), Line(percent, mean, colour, width=1.8)]


def _draw_other_system(data: ReportData, joint: int) -> list[Item]:
    """Return mean and standard deviation of a joint angle from another system; empty without one."""
    table = data.table("phases.parquet")
    if table is None:
        return []
    mean, sd, percent = read_average(table, f"theta_{joint}_other")
    if not np.isfinite(mean).any():
        return []
    mean, sd = np.degrees(mean), np.degrees(sd)
    band = Band(percent, mean - sd, mean + sd, style.OTHER, 0.2)
    return [band, Line(percent, mean, style.OTHER, "another system", "--", 1.4)]


def _draw_seat_off(events: Table) -> list[Item]:
    """Return a dotted line at the mean time of seat-off; empty if it is unknown."""
    start, seat_off, end = events.stack(["start", "seat_off", "end"]).T
    share = (seat_off - start) / np.where(end > start, end - start, np.nan)
    share = share[np.isfinite(share)]
    return [Rule("x", 100 * float(share.mean()), style.INK, ":", 0.8)] if len(share) else []


def draw_phases(data: ReportData) -> Figure | str:
    """Return four panels of the wrench and one of the torques, each with mean and one standard deviation."""
    table = data.table("phases.parquet")
    if table is None:
        return f"No averages over repetitions: {data.why_missing('phases.parquet')}."
    names = data.skeleton.joints if data.skeleton is not None else ()
    wrench = tuple(_draw_phase_panel(table, name, label) for name, label in _WRENCH)
    torques = tuple(
        item
        for k, name in enumerate(names, start=1)
        for item in _draw_phase_curve(table, f"tau_{k}", style.pick_colour(k), "-", f"{style.clean(name, 14)} torque")
    )
    if not torques and not any(panel.items for panel in wrench):
        why = data.facts("phases.parquet").get("why") or "forces and torques are unknown"
        return f"No averages over repetitions: {style.clean(why)}."
    legs = ", both legs together" if data.facts("dynamics.parquet").get("legs") == "both" else ""
    shades = _shade_unknown_torques(table, len(names))
    last = Panel((*shades, *torques), f"joint torques{legs} (N·m)", _SPAN, x_range=(0, 100), linked=True)
    return Figure((wrench[:2], wrench[2:], *(((last,),) if torques else ())))


def _shade_unknown_torques(table: Table, joints: int) -> tuple[Item, ...]:
    """Return shaded intervals of the repetition in which fewer repetitions than elsewhere have a torque."""
    unknown = np.zeros(len(_GRID), dtype=np.bool_)
    for joint in range(1, joints + 1):
        own = (table["quantity"] == f"tau_{joint}") & (table["span"] == "repetition")
        if own.any():
            unknown |= table["count"][own] < table["count"][own].max()
    return draw_shades(100 * _GRID, unknown)


def read_average(table: Table, quantity: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, standard deviation and percent of a quantity over complete repetitions; empty if missing."""
    own = (table["quantity"] == quantity) & (table["span"] == "repetition")
    mean, sd, percent = table.stack(["mean", "sd", "percent"])[own].T
    return mean, sd, percent


def _draw_phase_panel(table: Table, name: str, label: str) -> Panel:
    items, curves = [], []
    for suffix, colour, dash, what in _SOURCES:
        items += _draw_phase_curve(table, f"{name}{suffix}", colour, dash, what)
        curves.append(read_average(table, f"{name}{suffix}")[0])
    framed = style.find_range(curves, _COP_TAIL if name == "cop_x" else 0.0)
    return Panel(tuple(items), label, _SPAN, x_range=(0, 100), y_range=framed, linked=True)


def _draw_phase_curve(table: Table, quantity: str, colour: str, dash: Dash, label: str) -> list[Item]:
    mean, sd, percent = read_average(table, quantity)
    if not np.isfinite(mean).any():
        return []
    return [Band(percent, mean - sd, mean + sd, colour, 0.15), Line(percent, mean, colour, label, dash, 1.2)]
