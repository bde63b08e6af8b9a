"""The wheel and the source distribution: what is in them, how large they are, and their licences."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from email import message_from_string
from pathlib import Path
from typing import Any

import pytest

from mocap_id import __version__

pytest.importorskip("hatchling", reason="the packages are built by hatchling: make test installs it")

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = "mocap_id/reporting/templates"
INFO = f"mocap_id-{__version__}.dist-info"
SUFFIXES = {".py", ".pyi", ".js", ".css", ".j2", ".csv", ".toml", ".LICENSE"}
"""Endings of the files of a program; any other file in the wheel is there by mistake."""
TOP = {
    *("pipeline", "cli", "configs", "tests", "benchmarks", "docs", "sample_trials"),
    *("Makefile", "mkdocs.yml", "pyproject.toml", "requirements.lock", ".gitignore", "PKG-INFO"),
    *("README.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "LICENSES.md"),
}


def _build(folder: Path) -> tuple[Path, Path]:
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder / f"mocap_id-{__version__}-py3-none-any.whl", folder / f"mocap_id-{__version__}.tar.gz"


@pytest.fixture(scope="module")
def built(once: Callable[..., Any]) -> tuple[Path, Path]:
    found: tuple[Path, Path] = once("packages", _build)
    return found


@pytest.fixture(scope="module")
def wheel(built: tuple[Path, Path]) -> dict[str, bytes]:
    """Path → content of the files of the wheel."""
    with zipfile.ZipFile(built[0]) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def source(built: tuple[Path, Path]) -> dict[str, bytes]:
    """Path → content of the files of the source distribution."""
    found = {}
    with tarfile.open(built[1]) as archive:
        for member in archive:
            stream = archive.extractfile(member)
            if stream is not None:
                found[member.name.partition("/")[2]] = stream.read()
    return found


def test_the_wheel_has_the_program_and_nothing_else(wheel: dict[str, bytes]) -> None:
    own = [name for name in wheel if not name.startswith(f"{INFO}/")]
    assert {name.partition("/")[0] for name in own} == {
        "mocap_id",
        "mocap_id_assist",
        "mocap_id_simulation",
        "mocap_id_cli",
    }
    assert [name for name in own if Path(name).suffix not in SUFFIXES and Path(name).name != "py.typed"] == []
    assert [name for name in own if re.search(r"(^|/)(test_|conftest|\.)|__pycache__", name)] == []
    assert {
        "mocap_id/py.typed",
        "mocap_id/__init__.pyi",
        "mocap_id_simulation/py.typed",
        "mocap_id_cli/py.typed",
    } <= set(own)


def test_the_wheel_has_every_file_of_the_program(wheel: dict[str, bytes]) -> None:
    there = {
        path.relative_to(root).as_posix()
        for root in (ROOT / "pipeline", ROOT / "cli")
        for path in root.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert there - set(wheel) == set()


def test_the_source_distribution_has_what_a_user_and_a_packager_need(source: dict[str, bytes]) -> None:
    assert {name.partition("/")[0] for name in source} == TOP
    assert [
        name for name in source if re.search(r"__pycache__|/runs/|/\.venv|\.(pyc|parquet|h5|orig|rej)$", name)
    ] == []
    for needed in ("tests/conftest.py", "sample_trials/sit-to-stand/trial.c3d", "docs/quick-start.md"):
        assert needed in source


def test_the_sizes_are_those_that_the_page_states(built: tuple[Path, Path]) -> None:
    """The page says each size in MB; it may differ by a tenth."""
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    for path, name in zip(built, ("wheel", "source distribution"), strict=True):
        (stated,) = re.findall(rf"{name} \(([\d.]+) MB\)", page)
        assert path.stat().st_size / 1e6 == pytest.approx(float(stated), rel=0.1), name


def test_the_metadata(wheel: dict[str, bytes]) -> None:
    about = message_from_string(wheel[f"{INFO}/METADATA"].decode())
    assert about["Version"] == __version__
    assert about["License-Expression"] == "BSD-3-Clause AND MIT AND Zlib"
    assert "mocap-id = mocap_id_cli.__main__:main" in wheel[f"{INFO}/entry_points.txt"].decode()


def test_every_bundled_script_is_listed_with_its_licence(wheel: dict[str, bytes]) -> None:
    page = wheel[f"{INFO}/licenses/LICENSES.md"].decode()
    bundled = [name for name in wheel if Path(name).suffix in {".js", ".css"}]
    assert len(bundled) >= 4
    for name in bundled:
        assert name.startswith(TEMPLATES)
        assert f"`{Path(name).name}`" in page
    assert hashlib.sha256(wheel[f"{TEMPLATES}/plotly-basic.min.js"]).hexdigest() in page


def test_the_licence_texts_are_in_the_wheel(wheel: dict[str, bytes]) -> None:
    texts = wheel[f"{INFO}/licenses/pipeline/{TEMPLATES}/plotly-basic.LICENSE"].decode()
    bundle = wheel[f"{TEMPLATES}/plotly-basic.min.js"][:200].decode()
    (version,) = re.findall(r"v(\d+\.\d+\.\d+)", bundle)
    assert f"Plotly.js {version}, " in texts
    for words in ("MIT License", "BSD 3-Clause License", "zlib License", "Plotly Technologies", "Bostock", "MapLibre"):
        assert words in texts
    assert b"BSD 3-Clause License" in wheel[f"{INFO}/licenses/LICENSE"]
