"""A trial's report: the page and the summary, and figures for papers where they are asked for, as files."""

from __future__ import annotations

from mocap_id.reporting.contents import PAGE_FILE, SUMMARY_FILE, PdfFonts
from mocap_id.reporting.embedding import read
from mocap_id.reporting.figures import drawings
from mocap_id.reporting.material import Material
from mocap_id.reporting.page import page
from mocap_id.reporting.summary import summarise, to_json
from mocap_id.store import Document


def documents(material: Material, *, figures: bool = False, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """The files of :data:`mocap_id.reporting.contents.FILES` in their order, and then the figures."""
    summary = summarise(material)
    written = {SUMMARY_FILE: to_json(summary), PAGE_FILE: page(material, summary, drawings(material))}
    if figures:
        from mocap_id.reporting import paper  # noqa: PLC0415  matplotlib is imported by whoever draws with it

        written |= paper.files(read(written[PAGE_FILE].decode("utf-8")), pdf_fonts)  # the same as `mocap-id figures`
    return tuple(Document(file, content) for file, content in written.items())
