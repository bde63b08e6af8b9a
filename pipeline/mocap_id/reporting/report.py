"""A trial's report: the page, the figures and the summary, as files."""

from __future__ import annotations

from mocap_id.reporting.contents import FIGURES, PAGE_FILE, SUMMARY_FILE
from mocap_id.reporting.figures import render
from mocap_id.reporting.material import Material
from mocap_id.reporting.page import page
from mocap_id.reporting.summary import summarise, to_json
from mocap_id.store import Document


def documents(material: Material) -> tuple[Document, ...]:
    """The files in the order of :data:`mocap_id.reporting.contents.FILES`."""
    summary = summarise(material)
    drawn = [render(entry, material) for entry in FIGURES]
    return (
        Document(SUMMARY_FILE, to_json(summary)),
        Document(PAGE_FILE, page(material, summary, drawn)),
        *(Document(drawing.entry.file, drawing.svg) for drawing in drawn),
    )
