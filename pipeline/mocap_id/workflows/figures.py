"""Figures of a page as files for a paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap_id import plain_files
from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting.contents import PAGE_FILE, PdfFonts
from mocap_id.reporting.embedding import read_figures
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.study.page_data import PAGE_FILE as COHORT
from mocap_id.store.atomic import write_files

PAGES = (PAGE_FILE, COHORT, "robot.html", "sensitivity.html")
"""Pages that a folder may hold."""
_UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def figures(source: Path, out: Path | None = None, pdf_fonts: PdfFonts = "type-3") -> tuple[Path, ...]:
    """Draw every figure of a page.

    Parameters
    ----------
    source : Path
        A page, or the folder of a trial's run, a study, a robot study or a sensitivity study.
    out : Path, optional
        Parent folder of ``figures/``; by default the page's own folder.
    pdf_fonts : {"type-3", "truetype"}
        Fonts in the PDF.

    Returns
    -------
    tuple of Path
        ``captions.md``, and an SVG and a PDF file for each figure.

    Raises
    ------
    ConfigError
        There is no page.
    StoreError
        The page holds no figures, or the folder cannot be written.
    """
    from mocap_id.reporting import paper_figures  # noqa: PLC0415  imports matplotlib

    page = _page(source)
    with _readable(page):
        files = paper_figures.figure_files(_drawings(page), pdf_fonts)
    folder = page.parent if out is None else out
    write_files(folder, files)
    return tuple(folder / file for file in files)


def page_drawings(source: Path) -> Drawings:
    """Return the figures of a page, as data; parameters and errors as for :func:`figures`."""
    page = _page(source)
    with _readable(page):
        return _drawings(page)


def _drawings(page: Path) -> Drawings:
    return read_figures(plain_files.read(page).decode("utf-8", "replace"))


@contextmanager
def _readable(page: Path) -> Iterator[None]:
    """Raise StoreError where a page cannot be read, or holds no valid figures."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"{page} cannot be read: {error.strerror}") from error
    except _UNREADABLE as error:
        raise StoreError(
            f"{page}: holds no figures that this version can draw: run the command that wrote it again"
        ) from error


def _page(source: Path) -> Path:
    if source.is_file():
        return source
    page = next((source / name for name in PAGES if (source / name).is_file()), None)
    if page is None:
        raise ConfigError(
            f"{source}: there is no page; expected the folder of a trial or study, which holds one of "
            f"{', '.join(PAGES)}"
        )
    return page
