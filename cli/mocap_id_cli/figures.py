"""``mocap-id figures``: the figures of a page as files for a paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id.reporting.contents import PdfFonts
from mocap_id_cli.console import shorten


def figures(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder of a trial or study, or its page.", show_default=False)
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder in which the folder `figures` is created; default: the folder of the page.",
            show_default=False,
        ),
    ] = None,
    pdf_fonts: Annotated[
        PdfFonts, typer.Option(help="Fonts in the PDF: type-3, or truetype, which some journals require.")
    ] = "type-3",
) -> None:
    """Draw the figures of a page as SVG and PDF files.

    The figures, captions and data are read from the page; nothing is computed again.
    """
    from mocap_id.workflows.figures import write_figures  # noqa: PLC0415  no other command has to wait for it

    for file in write_figures(run, out, pdf_fonts):
        typer.echo(shorten(file))
