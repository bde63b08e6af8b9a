"""Files of the report of a trial: summary, page and optional figures for papers."""

from __future__ import annotations

from mocap_id.reporting.contents import PAGE_FILE, SUMMARY_FILE, PdfFonts
from mocap_id.reporting.embedding import read_figures
from mocap_id.reporting.figures import drawings
from mocap_id.reporting.page import page
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary import summarise, to_json
from mocap_id.store import Document


def documents(data: ReportData, *, figures: bool = False, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """Return the files of :data:`mocap_id.reporting.contents.FILES`, followed by the figures if requested."""
    summary = summarise(data)
    contents = {SUMMARY_FILE: to_json(summary), PAGE_FILE: page(data, summary, drawings(data))}
    if figures:
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  loads matplotlib

        contents |= paper_figures.figure_files(
            read_figures(contents[PAGE_FILE].decode("utf-8")), pdf_fonts
        )  # as `mocap-id figures` does
    return tuple(Document(file, content) for file, content in contents.items())
