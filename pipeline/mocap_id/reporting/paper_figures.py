"""Figures for papers: SVG, PDF and captions, drawn with matplotlib.

The same figure always gives the same bytes. No global state is changed permanently: pyplot is not used, and
:func:`use_paper_style` restores the settings of matplotlib.
"""

from __future__ import annotations

import io
import math
import textwrap
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as MplFigure
from matplotlib.lines import Line2D

from mocap_id.reporting import CAPTIONS_FILE, PdfFonts, style
from mocap_id.reporting.figure import (
    Band,
    Bars,
    Drawings,
    Figure,
    Heat,
    Item,
    Key,
    Line,
    Points,
    Rule,
    Spans,
    Text,
)

if TYPE_CHECKING:
    from mocap_id.design.proposal import MovementLimits, Trajectory

WIDTH = 7.2
"""Width of a figure, inches: two columns of a journal page."""
HEAT, SHADES = "cividis", 24

_MARKERS = {"dot": "o", "ring": "o", "x": "x", "+": "+", "|": "|", "diamond": "d", "square": "s"}
_OPEN = ("ring", "diamond")
_RC: dict[Any, object] = {
    "axes.axisbelow": True,
    "axes.edgecolor": style.INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": style.INK,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 8.5,
    "axes.titlecolor": style.INK,
    "axes.xmargin": 0.03,
    "figure.facecolor": "none",
    "font.family": ["DejaVu Sans"],
    "font.size": 8,
    "grid.color": style.GRID,
    "grid.linewidth": 0.5,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "patch.linewidth": 0.6,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",  # keep text searchable, editable and small
    "text.color": style.INK,
    "text.parse_math": False,  # labels come from files and may contain dollar signs
    "xtick.color": style.INK,
    "xtick.labelsize": 7.5,
    "ytick.color": style.INK,
    "ytick.labelsize": 7.5,
}


@contextmanager
def use_paper_style(pdf_fonts: PdfFonts = "type-3") -> Iterator[None]:
    """Return a context manager within which matplotlib uses our settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        mpl.rcParams["pdf.fonttype"] = {"type-3": 3, "truetype": 42}[pdf_fonts]
        yield


def make_figure_files(drawings: Drawings, pdf_fonts: PdfFonts = "type-3") -> dict[str, bytes]:
    """Return the contents of the figure files by file name: the captions, and every existing figure as SVG and PDF."""
    captions = (
        f"**{one.title}** (`{one.name}.svg`, `{one.name}.pdf`). {one.caption}"
        if one.missing is None
        else f"**{one.title}**. {one.missing}"
        for one in drawings.all
    )
    markdown = "\n\n".join([f"# Figures of {drawings.of}", *captions]) + "\n"
    contents = {CAPTIONS_FILE: markdown.encode("utf-8")}
    for one in drawings.all:
        figure = one.figure
        if not isinstance(figure, str):
            title = f"{one.title}: {drawings.of}"
            rendered = render(one.name, title, lambda figure=figure: to_matplotlib(figure), pdf_fonts)  # type: ignore[misc]
            contents |= {f"figures/{file}": content for file, content in rendered.items()}
    return contents


def render(name: str, title: str, draw: Callable[[], MplFigure], pdf_fonts: PdfFonts = "type-3") -> dict[str, bytes]:
    """Render the figure that ``draw`` returns with our settings; return SVG and PDF by file name."""
    about = {"CreationDate": None, "Creator": None, "Producer": None}
    silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with use_paper_style(pdf_fonts), mpl.rc_context({"svg.hashsalt": name}), warnings.catch_warnings():
        # A character that matplotlib's font lacks stays text in the SVG (viewer's font) and is a box in the PDF.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        made, svg, pdf = draw(), io.BytesIO(), io.BytesIO()
        made.draw_without_rendering()
        made.set_layout_engine("none")  # one layout for both formats
        for axes in made.axes:  # the layout solver is not reproducible to the last bit
            axes.set_position(np.round(axes.get_position(original=True).bounds, 6).tolist())
        FigureCanvasSVG(made).print_figure(svg, format="svg", metadata={**silent, "Title": style.clean(title)})
        FigureCanvasPdf(made).print_figure(pdf, format="pdf", metadata={**about, "Title": style.clean(title)})
    return {f"{name}.svg": svg.getvalue(), f"{name}.pdf": pdf.getvalue()}


def make_figure(height: float) -> MplFigure:
    """Return an empty figure of the standard width and this height, inches; call it within :func:`use_paper_style`."""
    return MplFigure(figsize=(WIDTH, height), layout="constrained")


def to_matplotlib(figure: Figure) -> MplFigure:
    """Convert a figure to a matplotlib figure; call this within :func:`use_paper_style`."""
    heights = [max(panel.height for panel in line) for line in figure.lines]
    whole = make_figure(0.4 + sum(heights))
    columns = math.lcm(*(len(line) for line in figure.lines))
    grid = whole.add_gridspec(len(heights), columns, height_ratios=heights)
    norm = Normalize(figure.scale.low, figure.scale.high) if figure.scale else None
    first: Axes | None = None
    found = []
    for row, line in enumerate(figure.lines):
        wide = columns // len(line)
        for k, panel in enumerate(line):
            place = grid[row, k * wide : (k + 1) * wide]
            axes = whole.add_subplot(place, sharex=first if panel.linked else None)
            first = axes if panel.linked else first
            for item in panel.flat().items:
                _draw_item(axes, item, norm)
            axes.set(title=panel.title, xlabel=panel.x, ylabel=panel.y)
            if panel.x_range is not None:
                axes.set_xlim(panel.x_range)
            if panel.y_range is not None:
                axes.set_ylim(panel.y_range)
            if panel.x_ticks:
                axes.set_xticks([at for at, _ in panel.x_ticks], [words for _, words in panel.x_ticks])
            if panel.rows:
                small = 6.5 if len(panel.rows) > 20 else 7.5
                axes.set_yticks(
                    range(len(panel.rows)), panel.rows if k == 0 else [""] * len(panel.rows), fontsize=small
                )
                axes.set_ylim(len(panel.rows) - 0.4, -0.6)
                axes.grid(False, axis="y")
            if panel.equal:
                axes.margins(0.1)
                axes.set_aspect("equal", adjustable="box" if panel.x_range else "datalim")
            if panel.linked and not panel.x:
                axes.tick_params(labelbottom=False)
            if len(line) > 1 and not panel.x_ticks:
                axes.locator_params(axis="x", nbins=max(2, 7 - len(line)))
            found.append(axes)
    whole.align_ylabels(found)
    if figure.scale is not None:
        shades = ScalarMappable(norm, mpl.colormaps[HEAT].resampled(SHADES))
        whole.colorbar(shades, ax=found, label=figure.scale.label, shrink=0.7, aspect=30)
    add_legend(whole, found)
    return whole


def add_legend(whole: MplFigure, panels: Sequence[Axes]) -> None:
    """Add one legend with the labels of all panels above the figure, if there are any labels."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(str(label), handle)
    if handles:
        columns = max(1, min(6, 90 // (max(map(len, handles)) + 6)))  # about 90 characters per line
        whole.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=columns)


def _draw_item(axes: Axes, item: Item, norm: Normalize | None) -> None:
    look: dict[str, Any]
    match item:
        case Line():
            look = {"color": item.colour, "lw": item.width, "alpha": item.opacity}
            axes.plot(item.x, item.y, item.dash, label=item.label or None, **look)
        case Band():
            axes.fill_between(item.x, item.low, item.high, color=item.colour, alpha=item.opacity, lw=0)
        case Points():
            look = {
                "marker": _MARKERS[item.symbol],
                "ms": item.size,
                "mfc": "none" if item.symbol in _OPEN else item.colour,
                "mec": item.colour,
                "color": item.colour,
                "ls": "none",
                "capsize": 2,
                "elinewidth": 0.8,
                "mew": 1.6 if item.symbol in ("x", "|") else 0.9,
                "zorder": 3,
            }
            axes.errorbar(item.x, item.y, xerr=item.half, label=item.label or None, **look)
        case Heat():
            look = {"marker": "s", "linewidths": 0.3, "edgecolors": style.INK, "zorder": 3, "clip_on": False}
            shades = mpl.colormaps[HEAT].resampled(SHADES)
            axes.scatter(item.x, item.y, s=item.size**2, c=item.value, norm=norm, cmap=shades, **look)
        case Bars():
            opacity = np.ones(len(item.row)) if item.opacity is None else item.opacity
            for row, low, high, colour, shown in zip(item.row, item.low, item.high, item.colours, opacity, strict=True):
                axes.barh(row, high - low, left=low, height=item.thick, color=colour, alpha=shown, lw=0)
        case Spans():
            wide = list(zip(item.start, item.end - item.start, strict=True))
            look = {"color": item.colour, "alpha": item.opacity, "lw": 0}
            axes.broken_barh(wide, (0, 1), transform=axes.get_xaxis_transform(), **look)
        case Rule():
            across = axes.axvline if item.axis == "x" else axes.axhline
            across(item.at, color=item.colour, ls=item.dash, lw=item.width)
        case Text():
            axes.annotate(item.words, (item.x, item.y), (7, -3), textcoords="offset points", fontsize=7.5)
        case Key():
            axes.add_line(Line2D([], [], marker="s", ls="none", ms=5, color=item.colour, label=item.label))


_ADVISED_PANEL = 1.25  # inches
_DETAIL = 8.0  # s


def draw_advice(course: Trajectory, joints: Sequence[str], limits: MovementLimits, words: str) -> MplFigure:
    """Return the figure; call this within :func:`mocap_id.reporting.paper_figures.use_paper_style`.

    ``limits`` of the angles are dotted lines. ``words``, the instruction for the person, are the title of the figure.
    """
    drawing = make_figure(0.9 + _ADVISED_PANEL * len(joints))
    panels = drawing.subplots(len(joints), 2, squeeze=False, sharey="row", width_ratios=[2, 1])
    time = course.time - course.time[0]
    start = max(0.0, (time[-1] - _DETAIL) / 2)
    close = (time >= start) & (time <= start + _DETAIL)
    for j, name in enumerate(joints):
        for axes, part in zip(panels[j], (np.ones_like(close), close), strict=True):
            axes.plot(time[part], np.degrees(course.q[part, j]), color=style.pick_colour(j + 1))
            for end in (limits.low[j], limits.high[j]):
                axes.axhline(float(np.degrees(end)), color=style.FAINT, linewidth=0.8, linestyle=":")
        panels[j, 0].set_ylabel(f"{style.clean(name, 20)} (°)")
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    drawing.suptitle("\n".join(textwrap.wrap(style.clean(words), 105)), fontsize=8, x=0.01, ha="left")
    return drawing
