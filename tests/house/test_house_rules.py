"""House rules for every file of the source tree."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from mocap_id import __version__

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted([*(ROOT / "pipeline").rglob("*.py"), *(ROOT / "cli").rglob("*.py")])


def trees() -> Iterator[tuple[str, ast.Module]]:
    return ((name(path), ast.parse(path.read_text("utf-8"))) for path in SOURCES)


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def tracked() -> list[Path]:
    """Return the files of the tree that git does not ignore."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if result.returncode:
        pytest.skip("not a git work tree")
    return [ROOT / file for file in result.stdout.split("\0") if file and (ROOT / file).is_file()]


def test_every_public_thing_has_a_docstring() -> None:
    undocumented = []
    for file, tree in trees():
        parts = [part for part in tree.body if isinstance(part, ast.FunctionDef | ast.ClassDef) and part.name[0] != "_"]
        undocumented += [(file, getattr(part, "name", "")) for part in (tree, *parts) if not ast.get_docstring(part)]
    assert undocumented == []


def test_no_error_is_swallowed() -> None:
    silent = [
        (file, node.lineno)
        for file, tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.ExceptHandler)
        and (node.type is None or getattr(node.type, "id", "") in ("Exception", "BaseException"))
        and all(isinstance(step, ast.Pass | ast.Continue) for step in node.body)
    ]
    assert silent == []


def test_no_room_for_odds_and_ends() -> None:
    vague = {"utils", "util", "common", "helpers", "misc"}
    assert [name(path) for path in SOURCES if vague & set(path.with_suffix("").parts)] == []


def test_no_path_of_any_machine() -> None:
    pattern = re.compile(r"(^|[^\w.])/(?:work|root|tmp|home|Users)/\w", re.MULTILINE)
    found = []
    for path in tracked():
        if path.suffix in {".c3d", ".npz"} or path == Path(__file__):
            continue
        match = pattern.search(path.read_text("utf-8", errors="replace"))
        if match:
            found.append(f"{name(path)}: {match[0].strip()}")
    assert not found


def test_one_version_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["version"] == __version__
    assert f"\n## {__version__}\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_the_lock_file_pins_every_dependency_and_no_server() -> None:
    lines = (ROOT / "requirements.lock").read_text("utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if re.fullmatch(r"[\w.-]+==\S+", line))
    document = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = document["project"]["optional-dependencies"]
    assert "mocap-id[docs]" in extras["dev"]
    wanted = [
        *document["build-system"]["requires"],
        *document["project"]["dependencies"],
        *(one for one in extras["dev"] if one != "mocap-id[docs]"),
        *extras["docs"],
    ]
    for requirement in wanted:
        package, sign, bound = re.split(r"(>=|<)", requirement)
        pinned = pins[re.sub(r"[-_.]+", "-", package).lower()]
        assert (release(pinned) >= release(bound)) == (sign == ">="), requirement
    others = [line for line in lines if line and not line.lstrip().startswith("#") and "==" not in line]
    assert others == []
    assert not re.search(r"https?://|file://|--index|--find-links", "\n".join(lines))


def release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version))
