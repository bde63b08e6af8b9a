"""Files of the report of a trial: summary, page and optional figures for papers."""

from __future__ import annotations

from mocap_id.reporting.contents import PAGE_FILE, SUMMARY_FILE, PdfFonts
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figures import draw_figures
from mocap_id.reporting.page import Page, explain_reason, read_figures
from mocap_id.reporting.player import make_player
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.sections import make_key_numbers, make_sections
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.store import Document


def make_documents(data: ReportData, *, figures: bool = False, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """Return the files of :data:`mocap_id.reporting.contents.FILES`, followed by the paper figures if requested."""
    summary = summarise(data)
    verdict = summary.verdict
    headline, lead = LEVELS[verdict.level]
    along = "the first horizontal axis of the recording" if data.in_space else "the motion"
    page = Page(
        name=data.trial,
        headline=headline,
        lead=lead,
        command="report",
        sections=tuple(make_sections(data, summary)),
        figures=draw_figures(data),
        footer=f"SI units; x along {along}, y up. Angles are in degrees here and in radians in the data files.",
        level=verdict.level,
        reasons=tuple(map(explain_reason, verdict.reasons)),
        key_numbers=tuple(make_key_numbers(data, summary)),
        player=make_player(data),
        notes=tuple(map(explain_reason, verdict.notes)),
    )
    contents = {SUMMARY_FILE: encode_summary(summary), PAGE_FILE: page.render()}
    if figures:
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  loads matplotlib

        contents |= paper_figures.make_figure_files(
            read_figures(contents[PAGE_FILE].decode("utf-8")), pdf_fonts
        )  # as `mocap-id figures` does
    return tuple(Document(file, content) for file, content in contents.items())
