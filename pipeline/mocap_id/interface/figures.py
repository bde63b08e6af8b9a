"""Figures of a page for Python: interactive in a notebook, or drawn by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mocap_id.config.parsing import suggest_name
from mocap_id.errors import StoreError
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.workflows.figures import read_page_figures

if TYPE_CHECKING:
    import matplotlib.figure


class Figure:
    """A figure of a page. As the last line of a notebook cell, it is displayed as on the page and can be zoomed."""

    def __init__(self, of: str, drawing: Drawing) -> None:
        self._of = of
        self._drawing = drawing

    def __repr__(self) -> str:
        return f"<Figure {self.name}: {self.title}, {self._of}>"

    def _repr_html_(self) -> str:
        """Return the interactive figure as HTML for a notebook."""
        from mocap_id.reporting.report import render_figure_frame  # noqa: PLC0415  needs the page's templates

        return render_figure_frame(self._of, self._drawing)

    @property
    def name(self) -> str:
        """The name of the figure, as in ``run.figures``."""
        return self._drawing.name

    @property
    def title(self) -> str:
        """The title, without the name of the trial."""
        return self._drawing.title

    @property
    def caption(self) -> str:
        """Description of the figure, in sentences for a paper."""
        return self._drawing.caption

    def to_html(self) -> str:
        """Return a complete HTML page with the interactive figure and its scripts; it needs no network (1.2 MB)."""
        from mocap_id.reporting.report import render_figure_page  # noqa: PLC0415  needs the page's templates

        return render_figure_page(self._of, self._drawing)

    def to_matplotlib(self) -> matplotlib.figure.Figure:
        """Return a new matplotlib figure, in the style of ``mocap-id figures``, which you can change or save."""
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  imports matplotlib

        assert not isinstance(self._drawing.figure, str)
        with paper_figures.use_paper_style():
            return paper_figures.to_matplotlib(self._drawing.figure)


class PageFigures:
    """The figures of an HTML page, by name.

    Raises
    ------
    StoreError
        There is no such page, or it contains no figures.
    """

    def __init__(self, page: Path) -> None:
        if not page.is_file():
            raise StoreError(f"{page}: there is no such page with figures: run the trial or the study again")
        self._drawings: Drawings = read_page_figures(page)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the figures that exist, in the order of the page."""
        return tuple(one.name for one in self._drawings.all if one.missing is None)

    def find(self, name: str) -> Figure:
        """Return the figure of this name; raise StoreError with the reason if it is missing."""
        known = {one.name: one for one in self._drawings.all}
        if name not in known:
            raise StoreError(f"{self._drawings.of}: there is no figure {name!r}: {suggest_name(name, tuple(known))}")
        missing = known[name].missing
        if missing is not None:
            raise StoreError(f"{self._drawings.of}: there is no figure {name!r}: {missing}")
        return Figure(self._drawings.of, known[name])
