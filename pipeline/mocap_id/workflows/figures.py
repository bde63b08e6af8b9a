"""Figures of a page as files for a paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap_id import plain_files
from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting.contents import COHORT_PAGE, PAGE_FILE, PdfFonts
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.page import read_figures
from mocap_id.store.atomic import write_files
from mocap_id.workflows.run_folder import find_owner_of_files, write_owned

_PAGES = (PAGE_FILE, COHORT_PAGE, "robot.html", "sensitivity.html")
"""Names of the pages with figures."""
_UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def write_figures(source: Path, out: Path | None = None, pdf_fonts: PdfFonts = "type-3") -> tuple[Path, ...]:
    """Draw every figure of a page as SVG and PDF, write the captions, and return the paths of all files.

    Parameters
    ----------
    source : Path
        A page, or the folder of a trial's run, a study, a robot study or a sensitivity study.
    out : Path, optional
        Folder in which the folder ``figures`` is made; by default the folder of the page.
    pdf_fonts : {"type-3", "truetype"}
        Fonts in the PDF.

    Raises
    ------
    ConfigError
        There is no page.
    StoreError
        The page contains no figures, or the folder cannot be written or contains the figures of another page.
    """
    from mocap_id.reporting import paper_figures  # noqa: PLC0415  imports matplotlib

    page = _find_page(source)
    with _explain_unreadable(page):
        files = paper_figures.make_figure_files(_read_drawings(page), pdf_fonts)
    folder, owner = page.parent if out is None else out, find_owner_of_files(page.parent)
    if out is None:
        write_files(folder, files)
    else:
        write_owned(folder, files, owner, "figures")
    return tuple(folder / file for file in files)


def read_page_figures(source: Path) -> Drawings:
    """Return the figures of a page as data; ``source`` and the exceptions are as for :func:`write_figures`."""
    page = _find_page(source)
    with _explain_unreadable(page):
        return _read_drawings(page)


def _read_drawings(page: Path) -> Drawings:
    return read_figures(plain_files.read(page).decode("utf-8", "replace"))


@contextmanager
def _explain_unreadable(page: Path) -> Iterator[None]:
    """Raise StoreError if a page cannot be read, or contains no valid figures."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"{page} cannot be read: {error.strerror}") from error
    except _UNREADABLE as error:
        raise StoreError(
            f"{page} contains no figures that this version can draw: repeat the command that wrote the page"
        ) from error


def _find_page(source: Path) -> Path:
    if source.is_file():
        return source
    page = next((source / name for name in _PAGES if (source / name).is_file()), None)
    if page is None:
        raise ConfigError(
            f"{source}: there is no page; expected the folder of a trial or study, which contains one of "
            f"{', '.join(_PAGES)}"
        )
    return page
