"""Every Python block in the documentation runs beside a finished trial, in the order of its page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pages_of_docs import PAGES, ROOT, Block, blocks, name

from mocap_id.store import Folder, Origin, Table
from mocap_id.store.provenance import STATES

ELSEWHERE = {
    "docs/sit-to-stand.md": "tests/pipeline/test_docs_sit_to_stand.py",
    "docs/reach.md": "tests/pipeline/test_docs_reach.py",
    "docs/python.md": "tests/interface/test_python_page.py",
}
"""Pages whose blocks another test runs."""
NOT_HERE = ("file: ", "edit: ", "not run: ")
"""Remarks before blocks that go into files (tests/docs/test_adding_a_stage.py puts them there), or that need more."""


def scripts(page: Path) -> list[Block]:
    return [block for block in blocks(page) if block.kind == "python" and not block.note.startswith(NOT_HERE)]


WITH_PYTHON = [page for page in PAGES if scripts(page) and name(page) not in ELSEWHERE]


@pytest.fixture
def finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the runs that the pages read."""
    columns = {f"{column.name.format(k=k)}": np.zeros(5) for k in (1, 2, 3) for column in STATES.repeated}
    columns |= {key: np.ones(5, dtype=bool) for key in columns if key.startswith("observed")}
    states = Table(STATES, {"time": np.arange(5) / 100} | columns)
    for trial in ("s01", "s01-sts-normal"):
        with Folder(tmp_path / "runs" / trial).locked() as folder:
            folder.write((states,), Origin("ukf-smooth", 1, {}, {}, "key", 0.1))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    return tmp_path


@pytest.mark.parametrize("page", WITH_PYTHON, ids=name)
def test_its_blocks_run(page: Path, finished: Path) -> None:
    space: dict[str, object] = {"__name__": page.stem}
    for block in scripts(page):
        exec(compile("\n" * block.line + block.text, name(page), "exec", dont_inherit=True), space)


def test_the_other_tests_know_their_pages() -> None:
    for page, test in ELSEWHERE.items():
        assert Path(page).name in (ROOT / test).read_text("utf-8")


def test_some_pages_have_blocks() -> None:
    assert len(WITH_PYTHON) > 5
