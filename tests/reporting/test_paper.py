"""Figures for papers: whole files, the same bytes every time, nothing global left behind, nothing heavy before."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from reporting_cases import Trial, context, healthy

from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting import paper
from mocap_id.reporting.contents import FIGURES
from mocap_id.reporting.embedding import read
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Panel, to_json
from mocap_id.reporting.figures import drawings
from mocap_id.stages.report.function import material
from mocap_id.workflows.figures import figures


@pytest.fixture(scope="module")
def made() -> Drawings:
    return drawings(material(context(Trial(frames=400).artefacts())))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What ``mocap-id figures`` makes of a page that stands alone, by name."""
    folder, settings = tmp_path_factory.mktemp("run"), dict(mpl.rcParams)
    (folder / "report.html").write_bytes(healthy()["report.html"])
    written = figures(folder)
    assert dict(mpl.rcParams) == settings and {file.parent for file in written} == {folder / "figures"}
    return {file.name: file.read_bytes() for file in written}


@pytest.mark.parametrize("name", [entry.name for entry in FIGURES])
def test_every_figure_of_a_page_is_drawn_with_its_words(name: str, files: dict[str, bytes]) -> None:
    assert len(files) == 1 + 2 * len(FIGURES)
    one = read(healthy()["report.html"].decode("utf-8"))[name]
    assert isinstance(one.figure, Figure)
    svg, pdf = files[f"{name}.svg"], files[f"{name}.pdf"]
    text = " ".join("".join(element.itertext()) for element in ET.fromstring(svg).iter())
    assert f"{one.title}: s01-sts" in text
    words = {panel.x for panel in one.figure.panels} | {panel.title for panel in one.figure.panels}
    labels = {getattr(item, "label", "") for panel in one.figure.panels for item in panel.items}
    assert [word for word in words | labels if word not in text] == []
    assert pdf.startswith(b"%PDF") and b"<dc:date>" not in svg and b"/CreationDate" not in pdf
    assert f"**{one.title}** (`{name}.svg`, `{name}.pdf`). {one.caption}" in files["captions.md"].decode()


def test_the_same_figure_has_the_same_bytes(made: Drawings) -> None:
    for name in ("states", "parameters"):
        only = Drawings(made.of, (made[name],))
        assert paper.files(only) == paper.files(only)


def test_what_is_missing_has_a_sentence_among_the_captions_and_no_file() -> None:
    files = paper.files(drawings(material(context({}))))
    assert list(files) == ["figures/captions.md"]
    assert (
        "**Base parameters**. No base parameters: dynamics.h5 was not computed."
        in files["figures/captions.md"].decode()
    )


def test_journals_that_want_truetype_get_it(made: Drawings) -> None:
    only = Drawings(made.of, (made["parameters"],))
    for fonts, subtype in (("type-3", b"/Type3"), ("truetype", b"/CIDFontType2")):
        assert subtype in paper.files(only, fonts)["figures/parameters.pdf"]  # type: ignore[arg-type]


OPENING = '<script type="application/json" id="figure-data">'
FLAT = Drawings("x", (Drawing("flat", "", "", Figure(((Panel((), height=0.0),),))),))
NONE = (
    "<html></html>",
    f"{OPENING}[1]</script>",
    OPENING + "[" * 10**6,
    f"{OPENING}{json.dumps(to_json(FLAT))}</script>",
)


@pytest.mark.parametrize("page", NONE)
def test_what_holds_no_figures_is_an_error_in_words(page: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no page here"):
        figures(tmp_path)
    (tmp_path / "report.html").write_text(page)
    with pytest.raises(StoreError, match="run again what wrote it"):
        figures(tmp_path)
    assert not (tmp_path / "figures").exists()


def test_the_command_names_what_it_wrote(tmp_path: Path, made: Drawings, cli: Callable[..., Any]) -> None:
    held = json.dumps(to_json(Drawings(made.of, (made["parameters"],))))
    page = tmp_path / "page.html"
    page.write_text(f'<script type="application/json" id="figure-data">{held}</script>')
    said = cli("figures", page, "--out", tmp_path / "paper", "--pdf-fonts", "truetype")
    assert said.code == 0
    assert [Path(line).name for line in said.out.split()] == ["captions.md", "parameters.svg", "parameters.pdf"]
    assert b"/CIDFontType2" in (tmp_path / "paper" / "figures" / "parameters.pdf").read_bytes()
    assert cli("figures", tmp_path / "nothing").code == 2


def test_a_report_loads_no_library_for_drawing_or_data_frames() -> None:
    """What a run needs for its report, imported by a Python of its own."""
    heavy = ("matplotlib", "pandas")
    code = f"import sys, mocap_id.reporting.report; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
