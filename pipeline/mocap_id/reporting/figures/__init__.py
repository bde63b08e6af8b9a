"""The report's figures, one file each: a drawing, or a sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from mocap_id.reporting import collection, style
from mocap_id.reporting.contents import FigureEntry, PdfFonts
from mocap_id.reporting.figures import (
    parameters,
    phases,
    point_masses,
    recovery,
    repetitions,
    residuals,
    skeleton,
    states,
    wrench,
)
from mocap_id.reporting.figures.moved import captioned
from mocap_id.reporting.material import Material
from mocap_id.reporting.vector import svg_and_pdf

_DRAW: Mapping[str, Callable[[Material], Figure | str]] = {
    "skeleton": skeleton.draw,
    "recovery": recovery.draw,
    "states": states.draw,
    "repetitions": repetitions.draw,
    "phases": phases.draw,
    "residuals": residuals.draw,
    "wrench": wrench.draw,
    "parameters": parameters.draw,
    "point_masses": point_masses.draw,
}


@dataclass(frozen=True)
class Drawing:
    """A figure of the report; ``missing`` says why there is nothing to see, where there is nothing."""

    entry: FigureEntry
    svg: bytes
    pdf: bytes
    missing: str | None

    @property
    def files(self) -> dict[str, bytes]:
        """What is written, by file."""
        return {self.entry.svg: self.svg, self.entry.pdf: self.pdf}


def render(entry: FigureEntry, material: Material, pdf_fonts: PdfFonts = "type-3") -> Drawing:
    """Draw one figure of the report; where its data are missing, the files hold the sentence that says so."""
    return drawing(captioned(entry, material), material.trial, lambda: _DRAW[entry.name](material), pdf_fonts)


def drawing(entry: FigureEntry, of: str, draw: Callable[[], Figure | str], pdf_fonts: PdfFonts = "type-3") -> Drawing:
    """What ``draw`` gives under the house's settings, as files; ``of`` is the name of what it is about."""
    with style.house(pdf_fonts):
        drawn = draw()
        whole = drawn if isinstance(drawn, Figure) else style.notice(drawn)
        svg, pdf = svg_and_pdf(whole, entry.name, f"{entry.title}: {style.printable(of)}")
    missing = None if isinstance(drawn, Figure) else style.printable(drawn)
    del drawn, whole
    collection.clear()
    return Drawing(entry, svg, pdf, missing)


def captions(of: str, drawings: Sequence[Drawing]) -> bytes:
    """What stands under each figure, as Markdown: a figure leaves its page when it goes into a paper."""
    told = (
        f"**{one.entry.title}** (`{one.entry.name}.svg`, `{one.entry.name}.pdf`). {one.missing or one.entry.caption}"
        for one in drawings
    )
    return ("\n\n".join([f"# Figures of {style.printable(of)}", *told]) + "\n").encode("utf-8")
