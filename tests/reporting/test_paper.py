"""Figures for papers are complete and reproducible, change no global state and load libraries only when needed."""

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
from mocap_id.reporting import paper_figures
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Panel, to_json
from mocap_id.reporting.figures import FIGURES, draw_figures
from mocap_id.reporting.page import read_figures
from mocap_id.stages.report import report_data
from mocap_id.workflows.figures import write_figures


@pytest.fixture(scope="module")
def made() -> Drawings:
    return draw_figures(report_data(context(Trial(frames=400).artefacts())))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files that ``mocap-id figures`` writes from a page alone, by name."""
    folder, settings = tmp_path_factory.mktemp("run"), dict(mpl.rcParams)
    (folder / "report.html").write_bytes(healthy()["report.html"])
    written = write_figures(folder)
    assert dict(mpl.rcParams) == settings and {file.parent for file in written} == {folder / "figures"}
    return {file.name: file.read_bytes() for file in written}


@pytest.mark.parametrize("name", [name for name, *_ in FIGURES])
def test_every_figure_of_a_page_is_drawn_with_its_texts(name: str, files: dict[str, bytes]) -> None:
    assert len(files) == 1 + 2 * len(FIGURES)
    one = read_figures(healthy()["report.html"].decode("utf-8"))[name]
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
        assert paper_figures.make_figure_files(only) == paper_figures.make_figure_files(only)


def test_a_missing_figure_has_a_caption_but_no_file() -> None:
    files = paper_figures.make_figure_files(draw_figures(report_data(context({}))))
    assert list(files) == ["figures/captions.md"]
    assert (
        "**Base parameters**. No base parameters: dynamics.h5 was not computed."
        in files["figures/captions.md"].decode()
    )


def test_truetype_fonts_can_be_embedded(made: Drawings) -> None:
    only = Drawings(made.of, (made["parameters"],))
    for fonts, subtype in (("type-3", b"/Type3"), ("truetype", b"/CIDFontType2")):
        assert subtype in paper_figures.make_figure_files(only, fonts)["figures/parameters.pdf"]  # type: ignore[arg-type]


OPENING = '<script type="application/json" id="figure-data">'
FLAT = Drawings("x", (Drawing("flat", "", "", Figure(((Panel((), height=0.0),),))),))
NONE = (
    "<html></html>",
    f"{OPENING}[1]</script>",
    OPENING + "[" * 10**6,
    f"{OPENING}{json.dumps(to_json(FLAT))}</script>",
)


@pytest.mark.parametrize("page", NONE)
def test_a_page_without_figures_is_an_error(page: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no page"):
        write_figures(tmp_path)
    (tmp_path / "report.html").write_text(page)
    with pytest.raises(StoreError, match="repeat the command that wrote the page"):
        write_figures(tmp_path)
    assert not (tmp_path / "figures").exists()


def test_the_command_prints_the_files_it_wrote(tmp_path: Path, made: Drawings, cli: Callable[..., Any]) -> None:
    held = json.dumps(to_json(Drawings(made.of, (made["parameters"],))))
    page = tmp_path / "page.html"
    page.write_text(f'<script type="application/json" id="figure-data">{held}</script>')
    said = cli("figures", page, "--out", tmp_path / "paper", "--pdf-fonts", "truetype")
    assert said.code == 0
    assert [Path(line).name for line in said.out.split()] == ["captions.md", "parameters.svg", "parameters.pdf"]
    assert b"/CIDFontType2" in (tmp_path / "paper" / "figures" / "parameters.pdf").read_bytes()
    assert cli("figures", tmp_path / "nothing").code == 2


def test_a_report_loads_no_library_for_drawing_or_data_frames() -> None:
    """Runs the imports of a report in a separate Python process."""
    heavy = ("matplotlib", "pandas")
    code = f"import sys, mocap_id.reporting.report; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
