"""A trial's report: the page, the figures and the summary, as files."""

from __future__ import annotations

from mocap_id.reporting.contents import CAPTIONS_FILE, FIGURES, PAGE_FILE, SUMMARY_FILE, PdfFonts
from mocap_id.reporting.figures import captions, render
from mocap_id.reporting.material import Material
from mocap_id.reporting.page import page
from mocap_id.reporting.summary import summarise, to_json
from mocap_id.store import Document


def documents(material: Material, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """The files in the order of :data:`mocap_id.reporting.contents.FILES`."""
    summary = summarise(material)
    drawn = [render(entry, material, pdf_fonts) for entry in FIGURES]
    return (
        Document(SUMMARY_FILE, to_json(summary)),
        Document(PAGE_FILE, page(material, summary, drawn)),
        Document(CAPTIONS_FILE, captions(material.trial, drawn)),
        *(Document(file, content) for drawing in drawn for file, content in drawing.files.items()),
    )
