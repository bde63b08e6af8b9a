"""``mocap-id figures``: the figures of a page as files for a paper."""

from __future__ import annotations

from pathlib import Path

from mocap_id import plain_files
from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting.cohort.material import PAGE_FILE as COHORT
from mocap_id.reporting.contents import PAGE_FILE, PdfFonts
from mocap_id.reporting.embedding import read
from mocap_id.store.atomic import explained, replace_together

PAGES = (PAGE_FILE, COHORT, "robot.html", "sensitivity.html")
"""What a folder may hold, by what made it."""
_UNREADABLE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def figures(source: Path, out: Path | None = None, pdf_fonts: PdfFonts = "type-3") -> tuple[Path, ...]:
    """Draw every figure that a page shows.

    Parameters
    ----------
    source : Path
        A page, or the folder of a trial's run, a study, a robot study or a sensitivity study.
    out : Path, optional
        Gets ``figures/``; by default the page's own folder.
    pdf_fonts : {"type-3", "truetype"}
        Letters of the PDF.

    Returns
    -------
    tuple of Path
        ``captions.md``, and SVG and PDF of each figure.

    Raises
    ------
    ConfigError
        There is no page.
    StoreError
        The page holds no figures, or the folder cannot be written.
    """
    from mocap_id.reporting import paper  # noqa: PLC0415  matplotlib is imported by whoever draws with it

    page = _page(source)
    try:
        files = paper.files(read(plain_files.read(page).decode("utf-8", "replace")), pdf_fonts)
    except OSError as error:
        raise StoreError(f"{page} cannot be read: {error.strerror}") from error
    except _UNREADABLE as error:
        raise StoreError(f"{page}: holds no figures that this version can draw: run again what wrote it") from error
    folder = page.parent if out is None else out
    with explained(folder):
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    replace_together(folder, files)
    return tuple(folder / file for file in files)


def _page(source: Path) -> Path:
    if source.is_file():
        return source
    page = next((source / name for name in PAGES if (source / name).is_file()), None)
    if page is None:
        raise ConfigError(f"{source}: no page here: a run's, a study's or a validation's folder has {', '.join(PAGES)}")
    return page
