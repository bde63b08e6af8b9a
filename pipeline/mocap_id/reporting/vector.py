"""One drawing, two vector files: SVG for the screen and the page, PDF for papers.

Most of matplotlib's time goes into laying out a figure and walking through it. Here it is laid out once and walked
through once, and every stroke goes to matplotlib's own writers of SVG and of PDF; the files are those that it would
write one after the other.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.backends.backend_pdf import PdfFile, RendererPdf
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure

from mocap_id.reporting import style

_POINTS = 72  # an inch; either format counts in them


def svg_and_pdf(drawing: Figure, name: str, title: str) -> tuple[bytes, bytes]:
    """The figure in both formats: the same bytes for the same drawing, no date in them.

    Parameters
    ----------
    drawing : Figure
        Drawn under :func:`mocap_id.reporting.style.house`, which still holds. Its layout is fixed by this.
    name : str
        The figure's own: the ids within the SVG come from it, so that no other figure has them.
    title : str
        What a screen reader says.
    """
    drawing.dpi = _POINTS
    width, height = drawing.get_size_inches()
    text, binary = io.StringIO(), io.BytesIO()
    silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with mpl.rc_context({"svg.hashsalt": name}), warnings.catch_warnings():
        # text stays text in the SVG, so a script that the bundled font lacks is shown by the reader's own fonts;
        # the PDF shows a box
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        settle(drawing)
        svg = RendererSVG(
            _POINTS * width, _POINTS * height, text, image_dpi=_POINTS, metadata={**silent, "Title": title}
        )
        file = PdfFile(binary, metadata={"CreationDate": None, "Creator": None, "Producer": None, "Title": title})
        try:
            file.newPage(width, height)
            pdf = RendererPdf(file, _POINTS, height, width)
            drawing.draw(_Both(svg, pdf))
            svg.finalize()
            pdf.finalize()
            file.finalize()
        finally:
            file.close()
    return text.getvalue().encode("utf-8"), binary.getvalue()


def drawn(name: str, title: str, draw: Callable[[], Figure]) -> dict[str, bytes]:
    """What ``draw`` draws under the house's settings, in both formats by their files' names."""
    with style.house():
        svg, pdf = svg_and_pdf(draw(), name, style.printable(title))
    return {f"{name}.svg": svg, f"{name}.pdf": pdf}


def settle(drawing: Figure) -> None:
    """Lay the figure out once and for all."""
    engine = drawing.get_layout_engine()
    if engine is not None:
        engine.execute(drawing)
        drawing.set_layout_engine("none")


class _Both(RendererBase):
    """Hands every stroke to two writers of one size; the SVG's y points down, which it minds itself but in text."""

    def __init__(self, svg: Any, pdf: Any) -> None:  # the backends have no types
        super().__init__()
        self._svg, self._pdf = svg, pdf

    def new_gc(self) -> GraphicsContextBase:
        found: GraphicsContextBase = self._pdf.new_gc()  # the PDF's holds more than the SVG asks of one
        return found

    def get_canvas_width_height(self) -> tuple[float, float]:
        found: tuple[float, float] = self._svg.get_canvas_width_height()
        return found

    def get_text_width_height_descent(self, *args: Any) -> tuple[float, float, float]:
        found: tuple[float, float, float] = self._svg.get_text_width_height_descent(*args)
        return found

    def flipy(self) -> bool:
        return False

    def open_group(self, s: str, gid: str | None = None) -> None:
        self._svg.open_group(s, gid)

    def close_group(self, s: str) -> None:
        self._svg.close_group(s)

    def draw_path(self, *args: Any, **more: Any) -> None:
        self._svg.draw_path(*args, **more)
        self._pdf.draw_path(*args, **more)

    def draw_markers(self, *args: Any, **more: Any) -> None:
        self._svg.draw_markers(*args, **more)
        self._pdf.draw_markers(*args, **more)

    def draw_path_collection(self, *args: Any, **more: Any) -> None:
        self._svg.draw_path_collection(*args, **more)
        self._pdf.draw_path_collection(*args, **more)

    def draw_image(self, *args: Any, **more: Any) -> None:
        self._svg.draw_image(*args, **more)
        self._pdf.draw_image(*args, **more)

    def draw_text(self, gc: Any, x: float, y: float, *args: Any, **more: Any) -> None:
        self._svg.draw_text(gc, x, self._svg.height - y, *args, **more)
        self._pdf.draw_text(gc, x, y, *args, **more)
