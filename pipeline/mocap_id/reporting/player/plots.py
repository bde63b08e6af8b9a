"""The player's plots as Bokeh's own documents: the figure in the plane of motion, and curves that share a time axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.decimation import band, envelope, spans
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95
from mocap_id.reporting.player.frames import Frames, Part
from mocap_id.reporting.player.models import Model, column, document, glyph, model, source, value
from mocap_id.reporting.views import Motion

FRAME = (270, 500)
"""Pixels of the figure's own frame: as wide as a phone allows."""
_HEIGHT = 112  # pixels of a curve's plot
_FONT = "sans-serif"
_ROWS = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_BINS = 250  # across a plot that is drawn anew at every step
_COP_TAIL = 0.005  # a centre of pressure under a light foot may shoot off to anywhere
_SOURCES = (
    ("_reference", style.REFERENCE, "--"),
    ("", style.MEASURED, "-"),
    ("_model", style.MODEL, "-"),
)
_DASHES: dict[str, list[int]] = {"-": [], "--": [6], "-.": [6, 4, 2, 4], ":": [2, 4]}  # pixels drawn and left out


@dataclass(frozen=True)
class Plots:
    """A Bokeh document and its roots; ``curves`` is None where there are none."""

    document: dict[str, Any]
    figure: str
    curves: str | None


@dataclass(frozen=True)
class Curves:
    """One plot over time: its axis, the lowest and highest that it shows, and what is drawn."""

    label: str
    bounds: tuple[float, float] | None
    drawn: tuple[Model, ...]


def plots(material: Material, frames: Frames) -> Plots:
    """The figure and the curves of a trial, with nothing to move yet but the first moment."""
    figure, curves = _figure(frames), _curves(material, frames)
    roots = [figure] if curves is None else [figure, curves]
    told, ids = document(style.printable(material.trial), roots)
    return Plots(told, ids[0], None if curves is None else ids[1])


def _figure(frames: Frames) -> Model:
    """Sticks, joints, markers and arrows in the plane of motion, metres to one scale."""
    x, y = _to_scale(frames.bounds)
    ground = model("Span", location=0, dimension="width", line_color=style.FAINT, line_width=1)
    return model(
        "Plot",
        name="figure",
        x_range=_range(*x),
        y_range=_range(*y),
        frame_width=FRAME[0],
        frame_height=FRAME[1],
        renderers=[drawn for part in frames.parts for drawn in _part(part, frames)],
        **_dress("x, along the motion (m)", "y, up (m)", [ground]),
    )


def _part(part: Part, frames: Frames) -> list[Model]:
    """What is drawn of things that move; their columns are filled anew at every moment."""
    columns: dict[str, Any] = {name: part.values[0, k] for k, name in enumerate(part.columns)}
    rows = part.values.shape[2]
    own = column("colour")
    match part.source:
        case "sticks":
            columns["colour"] = [style.colour(k + 1) for k in range(rows)]
            return [glyph(source(columns, part.source), _segments(7, 0.6))]
        case "joints":
            return [
                glyph(source(columns, part.source), _dots(13, value(style.INK), value(None), line_width=value(1.5)))
            ]
        case "markers":
            columns["colour"] = [style.colour(max(int(k), 0)) for k in frames.segments]
            columns["shape"] = ["x" if k < 0 else "circle" for k in frames.segments]
            return [glyph(source(columns, part.source), _dots(5, own, own, marker=column("shape")))]
        case _:
            measured = part.source == "measured"
            columns["colour"] = [style.MEASURED if measured else style.MODEL] * rows
            held, foot = source(columns, part.source), {"x": column("x0"), "y": column("y0")}
            return [glyph(held, _segments(3 if measured else 2, 1.0)), glyph(held, _dots(7, own, own, **foot))]


def _segments(width: float, alpha: float) -> Model:
    ends = {name: column(name) for name in ("x0", "y0", "x1", "y1")}
    look = {"line_width": value(width), "line_alpha": value(alpha), "line_cap": value("round")}
    return model("Segment", **ends, line_color=column("colour"), **look)


def _dots(size: float, line: Any, fill: Any, **more: Any) -> Model:
    own = {"x": column("x"), "y": column("y"), "size": value(size), "line_color": line, "fill_color": fill}
    return model("Scatter", **(own | more))


def _range(start: float, end: float) -> Model:
    return model("Range1d", start=float(start), end=float(end))


def _to_scale(bounds: FloatArray) -> FloatArray:
    """Ranges of x and y, (2, 2), that hold the bounds and the ground, a metre as long on either axis."""
    low, high = np.minimum(bounds[:, 0], [np.inf, 0.0]), np.maximum(bounds[:, 1], [-np.inf, 0.0])
    per_pixel = 1.12 * float(np.max((high - low) / FRAME))
    half = 0.5 * max(per_pixel, 1e-4) * np.array(FRAME)
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=1)


def _curves(material: Material, frames: Frames) -> Model | None:
    """A column of plots over time, with one line for now through all of them; None where nothing is known over time."""
    found = [*_angles(material), *_wrench(material)]
    if not found:
        return None
    clock = _range(frames.time[0], frames.time[-1])
    now = model("Span", name="now", location=None, dimension="height", line_color=style.NOW, line_width=2)
    plots = [_timed(one, clock, now, last=one is found[-1]) for one in found]
    return model("Column", name="curves", children=plots, sizing_mode="stretch_width")


def _angles(material: Material) -> Iterable[Curves]:
    motion = material.motion
    if motion is None or not motion.mean.size:
        return
    degrees = np.degrees(motion.angles)
    lines = [_line(motion.time, curve, style.colour(j), style.dashes(j)) for j, curve in enumerate(degrees.T, start=1)]
    bounds = style.extent(list(degrees.T))
    yield Curves("angle (deg)", bounds, (*_shade(motion.time, _bridged(motion)), *lines))


def _bridged(motion: Motion) -> BoolArray:
    found: BoolArray = motion.observed.sum(axis=1) < motion.observed.shape[1]
    return found


def _wrench(material: Material) -> Iterable[Curves]:
    table = material.frame("dynamics.parquet")
    table = material.frame("wrench.parquet") if table is None else table
    if table is None:
        return
    time = table["time"].to_numpy(dtype=np.float64)
    shade = _shade(time, table["in_fit"].to_numpy(dtype=np.bool_)) if "in_fit" in table else []
    for name, label in _ROWS:
        curves = {suffix: _column(table, name + suffix) for suffix, *_ in _SOURCES}
        known = {suffix: curve for suffix, curve in curves.items() if np.isfinite(curve).any()}
        if not known:
            continue
        area = _band(time, curves["_model"], NORMAL_95 * _column(table, f"sd_{name}_model"))
        lines = [_line(time, known[suffix], colour, dash) for suffix, colour, dash in _SOURCES if suffix in known]
        bounds = style.extent(list(known.values()), _COP_TAIL if name == "cop_x" else 0.0)
        yield Curves(label, bounds, (*shade, *area, *lines))


def _column(table: pd.DataFrame, name: str) -> FloatArray:
    """A column's numbers; unknown where it does not exist."""
    return table[name].to_numpy(dtype=np.float64) if name in table else np.full(len(table), np.nan)


def _timed(curves: Curves, clock: Model, now: Model, *, last: bool) -> Model:
    """A plot over time, framed for its curves; the last one has the axis of time."""
    low, high = curves.bounds or (0.0, 1.0)
    margin = max(0.1 * (high - low), 1e-9)
    tools = [model("BoxZoomTool", dimensions="width"), model("ResetTool")]
    return model(
        "Plot",
        x_range=clock,
        y_range=_range(low - margin, high + margin),
        height=_HEIGHT + 42 if last else _HEIGHT,
        sizing_mode="stretch_width",
        min_border_left=62,
        min_border_right=12,
        toolbar=model("Toolbar", tools=tools),
        renderers=list(curves.drawn),
        **_dress("time (s)" if last else None, curves.label, [now]),
    )


def _dress(below: str | None, left: str, over: Sequence[Model]) -> dict[str, Any]:
    """Axes and grid in the house's style, no logo and no toolbar; without a name the axis below is not shown."""
    axes = [_axis(below, visible=below is not None), _axis(left, visible=True)]
    grids = [
        model("Grid", dimension=k, ticker=axis.attributes["ticker"], grid_line_color=style.GRID)
        for k, axis in enumerate(axes)
    ]
    bare = dict.fromkeys(("toolbar_location", "outline_line_color", "background_fill_color", "border_fill_color"))
    return {"below": axes[:1], "left": axes[1:], "center": [*grids, *over], **bare}


def _axis(label: str | None, *, visible: bool) -> Model:
    return model(
        "LinearAxis",
        axis_label=label,
        visible=visible,
        ticker=model("BasicTicker", desired_num_ticks=4, mantissas=[1, 2, 5]),
        axis_line_color=style.INK,
        major_tick_line_color=style.INK,
        minor_tick_line_color=None,
        major_label_text_font=_FONT,
        major_label_text_color=style.INK,
        major_label_text_font_size="11px",
        axis_label_text_font=_FONT,
        axis_label_text_font_style="normal",
        axis_label_text_color=style.INK,
        axis_label_text_font_size="12px",
    )


def _shade(time: FloatArray, mask: BoolArray) -> list[Model]:
    found = np.array(spans(time, mask)).reshape(-1, 2)
    if not len(found):
        return []
    ends = source({"x0": found[:, 0], "x1": found.sum(axis=1)})
    look = {"fill_color": value(style.GRID), "fill_alpha": value(0.5), "line_color": value(None)}
    return [glyph(ends, model("VStrip", x0=column("x0"), x1=column("x1"), **look))]


def _band(time: FloatArray, middle: FloatArray, half: FloatArray) -> list[Model]:
    if not np.isfinite(half).any():
        return []
    x, low, high = band(time, middle - half, middle + half, _BINS)
    area = source({name: values.astype(np.float32) for name, values in (("x", x), ("low", low), ("high", high))})
    edges = {"x": column("x"), "y1": column("low"), "y2": column("high")}
    return [glyph(area, model("VArea", **edges, fill_color=style.MODEL, fill_alpha=0.2))]


def _line(time: FloatArray, values: FloatArray, colour: str, dash: str) -> Model:
    x, y = envelope(time, values, _BINS)
    held = source({"x": x.astype(np.float32), "y": y.astype(np.float32)})
    look = {"line_color": colour, "line_width": 1.5, "line_dash": _DASHES[dash]}
    return glyph(held, model("Line", x=column("x"), y=column("y"), **look))
