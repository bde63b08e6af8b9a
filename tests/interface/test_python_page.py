"""Every example on docs/python.md runs, and the page describes every public name."""

from __future__ import annotations

import doctest
import re
import shutil
from pathlib import Path

import pytest

import mocap_id

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "python.md").read_text("utf-8")


def test_every_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = ROOT / "sample_trials" / "sit-to-stand"
    for name in ("trial.yaml", "trial.c3d"):
        shutil.copy(sample / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    page = doctest.DocTestParser().get_doctest(PAGE.replace("```", ""), {}, "docs/python.md", "docs/python.md", 0)
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(page, out=said.append)
    assert "".join(said) == ""


@pytest.mark.parametrize("name", mocap_id.__all__)
def test_every_public_name_is_described_with_an_example(name: str) -> None:
    assert getattr(mocap_id, name) is not None
    assert f"`{name}`" in PAGE
    assert f"mocap_id.{name}" in "\n".join(re.findall(r"^(?:>>>|\.\.\.) .*$", PAGE, re.MULTILINE))


@pytest.mark.parametrize("owner", [mocap_id.Run, mocap_id.Study, mocap_id.Figure], ids=lambda owner: owner.__name__)
def test_every_attribute_of_a_result_is_described(owner: type) -> None:
    public = [name for name in vars(owner) if not name.startswith("_")]
    assert public
    missing = [name for name in public if f"{owner.__name__.lower()}.{name}" not in PAGE]
    assert missing == []


@pytest.mark.parametrize("owner", [mocap_id.Recording, mocap_id.Plate], ids=lambda owner: owner.__name__)
def test_every_attribute_of_a_recording_is_described(owner: type) -> None:
    table = PAGE.partition(f"| of a `{owner.__name__}` |")[2].partition("\n\n")[0]
    public = {name for name in (*vars(owner), *owner.__dataclass_fields__) if not name.startswith("_")}
    assert public == {name.removesuffix("()") for name in re.findall(r"`([^`]+)`", table)}
