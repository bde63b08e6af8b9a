"""Sections of pages that benchmarks write: each has both markers and a benchmark, and is replaced without the rest."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
from pages_of_docs import DOCS, PAGES, ROOT

BENCHMARKS = ROOT / "benchmarks"


def names(kind: str, text: str) -> list[str]:
    return re.findall(rf"<!-- {kind} ([\w-]+) -->", text)


def test_every_section_is_closed_and_has_a_benchmark() -> None:
    code = "".join(file.read_text("utf-8") for file in BENCHMARKS.glob("*.py"))
    for page in PAGES:
        text = page.read_text("utf-8")
        begun = names("begin", text)
        assert begun == names("end", text), page
        for name in begun:
            prefix, _, part = name.rpartition("-")
            written = f'"{name}"' in code or (f'"{prefix}-{{' in code and f'"{part}"' in code)
            assert written, f"{page.name}: no benchmark writes {name}"


def test_every_measured_page_names_its_benchmarks() -> None:
    for page in (DOCS / "measured").glob("*.md"):
        named = set(re.findall(r"benchmarks/(\w+\.py)", page.read_text("utf-8")))
        assert named, page.name
        assert all((BENCHMARKS / name).is_file() for name in named), page.name


def test_a_section_is_replaced_and_the_rest_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        harness = importlib.import_module("harness")
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- begin one -->\n\nold\n\n<!-- end one -->\n\nAfter.\n")
    harness.publish({"one": "new"}, write=False, folder=tmp_path)
    assert "old" in page.read_text()
    harness.publish({"one": "new"}, write=True, folder=tmp_path)
    assert page.read_text() == "Before.\n\n<!-- begin one -->\n\nnew\n\n<!-- end one -->\n\nAfter.\n"
    assert "new" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="no page has the markers of: two"):
        harness.publish({"two": "text"}, write=True, folder=tmp_path)
