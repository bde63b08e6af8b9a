"""SVG and PDF of one drawing are what matplotlib writes by itself, one after the other."""

from __future__ import annotations

import io
import re

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from reporting_cases import Trial, context

from mocap_id.reporting import style
from mocap_id.reporting.figures import _DRAW
from mocap_id.reporting.vector import svg_and_pdf
from mocap_id.stages.report.function import material

SILENT = {"Date": None, "Creator": None, "Format": None, "Type": None, "Title": "what it shows"}
NAMES = ["skeleton", "states", "parameters", "point_masses"]


@pytest.fixture(scope="module")
def drawn() -> dict[str, tuple[Figure, bytes, bytes]]:
    """Figures with markers, bands, error bars, a heat map: as drawn, as SVG and as PDF."""
    found, trial = {}, material(context(Trial(frames=600).artefacts()))
    with style.house(), mpl.rc_context({"pdf.compression": 0}):
        for name in NAMES:
            figure = _DRAW[name](trial)
            assert isinstance(figure, Figure)
            found[name] = (figure, *svg_and_pdf(figure, name, "what it shows"))
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_svg_is_matplotlibs_own(name: str, drawn: dict[str, tuple[Figure, bytes, bytes]]) -> None:
    figure, svg, _ = drawn[name]
    alone = io.BytesIO()
    with style.house(), mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(alone, format="svg", metadata=SILENT)
    assert svg == alone.getvalue()


@pytest.mark.parametrize("name", NAMES)
def test_the_pdf_strokes_as_matplotlibs_own(name: str, drawn: dict[str, tuple[Figure, bytes, bytes]]) -> None:
    """The same operators; numbers differ as the two measures of a text do, by far less than a tenth of a point."""
    figure, _, pdf = drawn[name]
    alone = io.BytesIO()
    with style.house(), mpl.rc_context({"pdf.compression": 0}):
        figure.savefig(alone, format="pdf")
    (operators, numbers), (expected, sizes) = strokes(pdf), strokes(alone.getvalue())
    assert operators == expected and len(numbers) > 500
    assert np.abs(numbers - sizes).max() < 0.1


def test_journals_that_want_truetype_get_it() -> None:
    trial = material(context(Trial(frames=600).artefacts()))
    for fonts, subtype in (("type-3", b"/Type3"), ("truetype", b"/CIDFontType2")):
        with style.house(fonts):  # type: ignore[arg-type]
            figure = _DRAW["parameters"](trial)
            assert isinstance(figure, Figure)
            assert subtype in svg_and_pdf(figure, "parameters", "")[1]


def strokes(pdf: bytes) -> tuple[list[bytes], np.ndarray]:
    """Operators and numbers of a PDF's first page, which stands first and is not compressed."""
    match = re.search(rb"stream\n(.*?)\nendstream", pdf, flags=re.DOTALL)
    assert match is not None
    page = match[1]
    words = re.sub(rb"\((?:\\.|[^\\)])*\)", b"", page).split()
    number = re.compile(rb"-?\d*\.?\d+\Z")
    return [word for word in words if not number.match(word)], np.array([float(w) for w in words if number.match(w)])
