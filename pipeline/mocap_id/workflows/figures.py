"""Figures of a page as files for a paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap_id import plain_files
from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting import COHORT_PAGE, PAGE_FILE, PdfFonts
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.page import read_figures
from mocap_id.store.atomic import write_files
from mocap_id.workflows.run_folder import write_owned

_PAGES = (PAGE_FILE, COHORT_PAGE, "robot.html", "sensitivity.html")
"""Names of the pages with figures."""
_UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def write_figures(source: Path, out: Path | None = None, pdf_fonts: PdfFonts = "type-3") -> tuple[Path, ...]:
    """Draw every figure of a page as SVG and PDF, write the captions, and return the paths of all files.

    ``source`` is a page, or the folder of a trial's run, a study, a robot study or a sensitivity study. The folder
    ``figures`` is made in ``out``, by default in the folder of the page. ConfigError is raised if there is no page,
    StoreError if the page has no figures, or if the folder contains the figures of another page or cannot be written.
    """
    from mocap_id.reporting import paper_figures  # noqa: PLC0415  imports matplotlib

    page = source if source.is_file() else next((source / name for name in _PAGES if (source / name).is_file()), None)
    if page is None:
        raise ConfigError(
            f"{source}: there is no page; expected the folder of a trial or study, which contains one of "
            f"{', '.join(_PAGES)}"
        )
    drawings = read_page_figures(page)
    with _explain_unreadable(page):
        files = paper_figures.make_figure_files(drawings, pdf_fonts)
    folder = page.parent if out is None else out
    if out is None:
        write_files(folder, files)
    else:
        write_owned(folder, files, "figures", page.parent)
    return tuple(folder / file for file in files)


def read_page_figures(page: Path) -> Drawings:
    """Return the figures of a page as data; StoreError is raised if it has none."""
    with _explain_unreadable(page):
        return read_figures(plain_files.read_bytes(page).decode("utf-8", "replace"))


@contextmanager
def _explain_unreadable(page: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreError(f"{page} cannot be read: {error.strerror}") from error
    except _UNREADABLE as error:
        raise StoreError(
            f"{page} contains no figures that this version can draw: repeat the command that wrote the page"
        ) from error
