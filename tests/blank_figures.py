"""Trials whose report has blank figures, for tests that look at a whole run's numbers.

Matplotlib's writing of nine figures takes longer than all the stages before. What draws them from the trial's data is
called as ever, and the page is made; tests/reporting, and whoever does without this, have the figures written too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from unittest.mock import patch

from matplotlib.figure import Figure

from mocap_id.reporting import figures, report
from mocap_id.reporting.contents import FigureEntry, PdfFonts
from mocap_id.reporting.figures import Drawing
from mocap_id.reporting.material import Material

RENDER, WRITE = figures.render, figures.svg_and_pdf


@cache
def blank(name: str) -> tuple[bytes, bytes]:
    """SVG and PDF of nothing."""
    return WRITE(Figure(), name, "blank")


def unwritten(drawing: Figure, name: str, title: str) -> tuple[bytes, bytes]:
    """Leaves the drawing aside."""
    return blank(name)


def drawn_only(entry: FigureEntry, material: Material, pdf_fonts: PdfFonts = "type-3") -> Drawing:
    """As the report renders a figure, but for its writing."""
    with patch.object(figures, "svg_and_pdf", unwritten):
        return RENDER(entry, material, pdf_fonts)


@contextmanager
def blank_figures() -> Iterator[None]:
    """Within it, and within this process, the reports of trials have blank figures."""
    with patch.object(report, "render", drawn_only):
        yield
