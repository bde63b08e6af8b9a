"""How every figure looks: colours, sizes, and the way to a deterministic SVG.

The colours are Okabe and Ito's, which people with any colour vision tell apart. Figures are drawn without pyplot and
under :func:`house`, so that nothing global outlives a drawing. The page replaces the colours in :data:`ON_PAGE` by its
own (:func:`inline`), so that a figure is readable on light and on dark.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting.contents import PdfFonts
from mocap_id.reporting.panel import Sheet

INK, GRID, FAINT = "#1b1c1f", "#d3d4d8", "#6b6e75"
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
MEASURED, MODEL, REFERENCE = INK, BLUE, ORANGE
OTHER = "#b2182b"
"""Another system's curves."""
NOW = "#882255"
"""The player's time."""
ON_PAGE: Mapping[str, str] = {INK: "--ink", GRID: "--grid", BLUE: "--blue", NOW: "--now"}
"""Colours that the page has a lighter one of where it is dark, with the names that they go by in its style."""
HEAT = "cividis"
SHADES = 24
"""Steps of the heat colours: few enough to read off the bar, and to draw it as vectors."""
WIDTH = 7.2
"""Width of a figure, inches: two columns of a journal page."""

_CHAIN_COLOURS = (VERMILLION, GREEN, PURPLE, SKY, ORANGE, BLUE)  # last those that stand beside them for forces
_DASHES = ("-", "--", "-.", ":")

_RC: dict[Any, object] = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 8.5,
    "axes.titlecolor": INK,
    "axes.xmargin": 0.01,
    "figure.facecolor": "none",
    "font.family": ["DejaVu Sans"],
    "font.size": 8,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "patch.linewidth": 0.6,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",  # text stays text: searchable, editable, small
    "text.color": INK,
    "text.parse_math": False,  # labels come from files: a dollar sign is a dollar sign
    "xtick.color": INK,
    "xtick.labelsize": 7.5,
    "ytick.color": INK,
    "ytick.labelsize": 7.5,
}


@contextmanager
def house(pdf_fonts: PdfFonts = "type-3") -> Iterator[None]:
    """The house's matplotlib settings, for the length of one drawing."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        mpl.rcParams["pdf.fonttype"] = {"type-3": 3, "truetype": 42}[pdf_fonts]
        yield


def figure(height: float) -> Figure:
    """An empty figure of the house's width and this height, inches; call it under :func:`house`."""
    return Sheet(figsize=(WIDTH, height), layout="constrained")


def colour(k: int) -> str:
    """Colour of joint or segment ``k``; 0 is the base."""
    return FAINT if k == 0 else _CHAIN_COLOURS[(k - 1) % len(_CHAIN_COLOURS)]


def dashes(k: int) -> str:
    """Line style of joint ``k``: solid until the colours are used up."""
    return _DASHES[(k - 1) // len(_CHAIN_COLOURS) % len(_DASHES)]


def printable(text: object, limit: int = 0) -> str:
    """A label without control characters, cut to ``limit`` characters (0 = whole)."""
    clean = "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in str(text))
    return f"{clean[: limit - 1]}…" if 0 < limit < len(clean) else clean


def notice(text: str) -> Figure:
    """A figure that says why there is nothing to draw."""
    drawing = figure(0.8)
    axes = drawing.subplots()
    axes.set_axis_off()
    axes.text(0.5, 0.5, printable(text), transform=axes.transAxes, ha="center", va="center", wrap=True)
    return drawing


def label_left(axes: Axes, text: str) -> None:
    """Label the y axis at a fixed distance, so that labels of one column stand under each other."""
    axes.set_ylabel(text)
    axes.yaxis.set_label_coords(-0.62 / WIDTH, 0.5)


def fit_y(axes: Axes, curves: Sequence[FloatArray], tail: float = 0.0) -> None:
    """Frame the curves, each without this share of its samples at either end; unknown samples do not count."""
    found = extent(curves, tail)
    if found is None:
        return
    margin = 0.1 * (found[1] - found[0])
    if margin > 0:
        axes.set_ylim(found[0] - margin, found[1] + margin)


def extent(curves: Sequence[FloatArray], tail: float = 0.0) -> tuple[float, float] | None:
    """Lowest and highest of the curves, each without this share of its samples at either end; None of nothing known."""
    known = [curve[np.isfinite(curve)] for curve in curves]
    if tail:
        ends = [tuple(np.quantile(curve, (tail, 1 - tail))) for curve in known if len(curve)]
    else:
        ends = [(curve.min(), curve.max()) for curve in known if len(curve)]
    if not ends:
        return None
    return float(min(low for low, _ in ends)), float(max(high for _, high in ends))


def legend_above(drawing: Figure, panels: Iterable[Axes]) -> None:
    """One legend over the figure for what is labelled in any panel; nothing (and no warning) where nothing is."""
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(str(label), handle)
    if handles:
        columns = max(1, min(6, 90 // (max(map(len, handles)) + 6)))  # about 90 characters go across
        drawing.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=columns)


def unit(text: str) -> str:
    """A unit as it is set: ``kg*m^2`` as kg·m²."""
    return text.replace("*", "·").replace("^2", "²").replace("^3", "³")


def on_page(colour: str) -> str:
    """A colour as the page's style says it."""
    return f"var({ON_PAGE[colour]})" if colour in ON_PAGE else colour


def inline(content: bytes, name: str) -> str:
    """An SVG file as an element of an HTML page, in the page's colours and without ids that another figure may have."""
    element = content.decode("utf-8")
    element = element[element.index("<svg") :]
    for colour in ON_PAGE:
        element = element.replace(colour, on_page(colour))
    element = re.sub(r'\bid="', f'id="{name}-', element)
    element = re.sub(r'href="#', f'href="#{name}-', element)
    return re.sub(r"url\(#", f"url(#{name}-", element)
