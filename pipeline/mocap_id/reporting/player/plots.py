"""The player's plots as Bokeh's own documents: the figure in the plane of motion, and curves that share a time axis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from bokeh.document import Document
from bokeh.models import (
    BoxZoomTool,
    Column,
    ColumnDataSource,
    Grid,
    Line,
    LinearAxis,
    Plot,
    Range1d,
    ResetTool,
    Scatter,
    Segment,
    Span,
    VArea,
    VStrip,
)

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.decimation import band, envelope, spans
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95
from mocap_id.reporting.player.frames import Frames
from mocap_id.reporting.views import Motion

FRAME = (270, 500)
"""Pixels of the figure's own frame: as wide as a phone allows."""
_HEIGHT = 112  # pixels of a curve's plot
_FONT = "sans-serif"
_ROWS = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_BINS = 250  # across a plot that is drawn anew at every step
_COP_TAIL = 0.005  # a centre of pressure under a light foot may shoot off to anywhere
_SOURCES = (
    ("_reference", style.REFERENCE, "dashed"),
    ("", style.MEASURED, "solid"),
    ("_model", style.MODEL, "solid"),
)


@dataclass(frozen=True)
class Plots:
    """A Bokeh document and its roots; ``curves`` is None where there are none."""

    document: dict[str, Any]
    figure: str
    curves: str | None


def plots(material: Material, frames: Frames) -> Plots:
    """The figure and the curves of a trial, with nothing to move yet but the first moment."""
    document = Document(title=style.printable(material.trial))
    figure, column = _figure(frames), _curves(material, frames)
    for root in (figure, column):
        if root is not None:
            document.add_root(root)
    return Plots(dict(document.to_json(deferred=False)), figure.id, None if column is None else column.id)


def _figure(frames: Frames) -> Plot:
    """Sticks, joints, markers and arrows in the plane of motion, metres to one scale."""
    x, y = _to_scale(frames.bounds)
    plot = Plot(x_range=Range1d(*x), y_range=Range1d(*y), frame_width=FRAME[0], frame_height=FRAME[1], name="figure")
    _dress(plot, "x, along the motion (m)", "y, up (m)")
    plot.add_layout(Span(location=0, dimension="width", line_color=style.FAINT, line_width=1))
    for part in frames.parts:
        columns = {name: part.values[0, k].tolist() for k, name in enumerate(part.columns)}
        rows = part.values.shape[2]
        source = ColumnDataSource(columns, name=part.source)
        match part.source:
            case "sticks":
                source.data["colour"] = [style.colour(k + 1) for k in range(rows)]
                _segments(plot, source, "colour", 7, 0.6)
            case "joints":
                plot.add_glyph(
                    source, Scatter(x="x", y="y", size=13, fill_color=None, line_color=style.INK, line_width=1.5)
                )
            case "markers":
                source.data["colour"] = [style.colour(max(int(k), 0)) for k in frames.segments]
                source.data["shape"] = ["x" if k < 0 else "circle" for k in frames.segments]
                plot.add_glyph(
                    source, Scatter(x="x", y="y", size=5, marker="shape", fill_color="colour", line_color="colour")
                )
            case _:
                source.data["colour"] = [style.MEASURED if part.source == "measured" else style.MODEL] * rows
                _segments(plot, source, "colour", 3 if part.source == "measured" else 2, 1.0)
                plot.add_glyph(source, Scatter(x="x0", y="y0", size=7, fill_color="colour", line_color="colour"))
    return plot


def _segments(plot: Plot, source: ColumnDataSource, colour: str, width: float, alpha: float) -> None:
    look = {"line_color": colour, "line_width": width, "line_alpha": alpha, "line_cap": "round"}
    plot.add_glyph(source, Segment(x0="x0", y0="y0", x1="x1", y1="y1", **look))


def _to_scale(bounds: FloatArray) -> FloatArray:
    """Ranges of x and y, (2, 2), that hold the bounds and the ground, a metre as long on either axis."""
    low, high = np.minimum(bounds[:, 0], [np.inf, 0.0]), np.maximum(bounds[:, 1], [-np.inf, 0.0])
    per_pixel = 1.12 * float(np.max((high - low) / FRAME))
    half = 0.5 * max(per_pixel, 1e-4) * np.array(FRAME)
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _curves(material: Material, frames: Frames) -> Column | None:
    """A column of plots over time, with one line for now through all of them; None where nothing is known over time."""
    clock = Range1d(float(frames.time[0]), float(frames.time[-1]))
    now = Span(location=None, dimension="height", line_color=style.NOW, line_width=2, name="now")
    found = [*_angles(material, clock), *_wrench(material, clock)]
    if not found:
        return None
    for k, plot in enumerate(found):
        plot.add_layout(now)
        if k == len(found) - 1:
            plot.below[0].axis_label = "time (s)"
            plot.height = _HEIGHT + 42
        else:
            plot.below[0].visible = False
    return Column(*found, sizing_mode="stretch_width", name="curves")


def _angles(material: Material, clock: Range1d) -> Iterable[Plot]:
    motion = material.motion
    if motion is None or not motion.mean.size:
        return
    degrees = np.degrees(motion.angles)
    plot = _timed(clock, "angle (deg)", list(degrees.T))
    _shade(plot, motion.time, _bridged(motion))
    for j, curve in enumerate(degrees.T):
        _line(plot, motion.time, curve, style.colour(j + 1), ("solid", "dashed", "dashdot")[j // 6 % 3])
    yield plot


def _bridged(motion: Motion) -> BoolArray:
    found: BoolArray = motion.observed.sum(axis=1) < motion.observed.shape[1]
    return found


def _wrench(material: Material, clock: Range1d) -> Iterable[Plot]:
    table = material.frame("dynamics.parquet")
    table = material.frame("wrench.parquet") if table is None else table
    if table is None:
        return
    time = table["time"].to_numpy(dtype=np.float64)
    for name, label in _ROWS:
        curves = {suffix: _column(table, name + suffix) for suffix, *_ in _SOURCES}
        known = [curve for curve in curves.values() if np.isfinite(curve).any()]
        if not known:
            continue
        plot = _timed(clock, label, known, _COP_TAIL if name == "cop_x" else 0.0)
        if "in_fit" in table:
            _shade(plot, time, table["in_fit"].to_numpy(dtype=np.bool_))
        half = NORMAL_95 * _column(table, f"sd_{name}_model")
        if np.isfinite(half).any():
            model = curves["_model"]
            x, low, high = band(time, model - half, model + half, _BINS)
            inside = np.isfinite(low + high)
            area = ColumnDataSource(
                {"x": x, "low": np.where(inside, low, np.nan), "high": np.where(inside, high, np.nan)}
            )
            plot.add_glyph(area, VArea(x="x", y1="low", y2="high", fill_color=style.MODEL, fill_alpha=0.2))
        for suffix, colour, dash in _SOURCES:
            if np.isfinite(curves[suffix]).any():
                _line(plot, time, curves[suffix], colour, dash)
        yield plot


def _column(table: pd.DataFrame, name: str) -> FloatArray:
    """A column's numbers; unknown where it does not exist."""
    return table[name].to_numpy(dtype=np.float64) if name in table else np.full(len(table), np.nan)


def _timed(clock: Range1d, label: str, curves: list[FloatArray], tail: float = 0.0) -> Plot:
    """An empty plot over time, framed for these curves."""
    low, high = style.extent(curves, tail) or (0.0, 1.0)
    margin = max(0.1 * (high - low), 1e-9)
    plot = Plot(
        x_range=clock,
        y_range=Range1d(low - margin, high + margin),
        height=_HEIGHT,
        sizing_mode="stretch_width",
        min_border_left=62,
        min_border_right=12,
    )
    _dress(plot, None, label)
    plot.add_tools(BoxZoomTool(dimensions="width"), ResetTool())
    return plot


def _dress(plot: Plot, below: str | None, left: str) -> None:
    """Axes and grid in the house's style, no logo and no toolbar."""
    ink = {"axis_line_color": style.INK, "major_tick_line_color": style.INK, "minor_tick_line_color": None}
    text = {
        "major_label_text_font": _FONT,
        "major_label_text_color": style.INK,
        "major_label_text_font_size": "11px",
        "axis_label_text_font": _FONT,
        "axis_label_text_font_style": "normal",
        "axis_label_text_color": style.INK,
        "axis_label_text_font_size": "12px",
    }
    for side, label in (("below", below), ("left", left)):
        axis = LinearAxis(axis_label=label, **ink, **text)
        axis.ticker.desired_num_ticks = 4
        plot.add_layout(axis, side)
        plot.add_layout(Grid(dimension=0 if side == "below" else 1, ticker=axis.ticker, grid_line_color=style.GRID))
    plot.toolbar_location = None
    plot.outline_line_color = None
    plot.background_fill_color = plot.border_fill_color = "#ffffff"


def _shade(plot: Plot, time: FloatArray, mask: BoolArray) -> None:
    found = spans(time, mask)
    if found:
        source = ColumnDataSource(
            {"x0": [start for start, _ in found], "x1": [start + width for start, width in found]}
        )
        plot.add_glyph(source, VStrip(x0="x0", x1="x1", fill_color=style.GRID, fill_alpha=0.5, line_color=None))


def _line(plot: Plot, time: FloatArray, values: FloatArray, colour: str, dash: str) -> None:
    x, y = envelope(time, values, _BINS)
    source = ColumnDataSource({"x": x.astype(np.float32), "y": y.astype(np.float32)})
    plot.add_glyph(source, Line(x="x", y="y", line_color=colour, line_width=1.5, line_dash=dash))
