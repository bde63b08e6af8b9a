"""Citation, conda recipe and container file agree with the package."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from mocap_id import __version__

ROOT = Path(__file__).resolve().parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
RECIPE = ROOT / "configs" / "conda" / "recipe.yaml"
CONTAINER = ROOT / "configs" / "container" / "Containerfile"
CONDA_NAMES = {"matplotlib": "matplotlib-base"}  # without the windows of Qt
INSTRUCTIONS = {"FROM", "COPY", "RUN", "ENV", "WORKDIR", "ENTRYPOINT", "CMD"}


def load(file: Path) -> dict[str, Any]:
    found: dict[str, Any] = YAML(typ="safe").load(file.read_text("utf-8"))
    return found


def test_the_recipe_needs_what_the_package_needs() -> None:
    recipe = load(RECIPE)
    wanted = []
    for requirement in PROJECT["dependencies"]:
        name, least = requirement.split(">=")
        wanted.append(f"{CONDA_NAMES.get(name, name)} >={least}")
    run = recipe["requirements"]["run"]
    assert run[0] == f"python {PROJECT['requires-python']}"
    assert run[1:] == wanted
    build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]["requires"]
    assert {re.sub(">=", " >=", one) for one in build} <= set(recipe["requirements"]["host"])


def test_the_recipe_describes_this_package() -> None:
    recipe = load(RECIPE)
    assert recipe["schema_version"] == 1
    assert recipe["context"]["version"] == __version__
    assert recipe["package"] == {"name": PROJECT["name"], "version": "${{ version }}"}
    assert recipe["source"]["path"].endswith("/dist/mocap_id-${{ version }}.tar.gz")
    assert recipe["about"]["license"] == PROJECT["license"]
    ((name, place),) = PROJECT["scripts"].items()
    assert recipe["build"]["python"]["entry_points"] == [f"{name} = {place}"]
    for file in recipe["about"]["license_file"]:
        assert (ROOT / file).is_file()


def instructions() -> list[tuple[str, str]]:
    """Return the instructions of the container file with their arguments."""
    text = "\n".join(line for line in CONTAINER.read_text("utf-8").splitlines() if not line.startswith("#"))
    lines = text.replace("\\\n", " ").split("\n")
    return [(line.split(" ", 1)[0], line.split(" ", 1)[1]) for line in lines if line.strip()]


def test_the_container_file_can_be_read() -> None:
    found = instructions()
    assert {name for name, _ in found} <= INSTRUCTIONS
    assert found[0][0] == "FROM"
    (base,) = {words.split()[0] for name, words in found if name == "FROM"}
    assert re.fullmatch(r"python:3\.\d+-slim", base)
    assert f"Programming Language :: Python :: {base[7:-5]}" in PROJECT["classifiers"]
    for name, words in found:
        if name in ("ENTRYPOINT", "CMD"):
            assert all(isinstance(word, str) for word in json.loads(words))
        if name == "RUN":
            assert all(shlex.split(part) for part in words.split("&&"))


def test_the_container_file_copies_what_the_wheel_is_built_from() -> None:
    copied = [
        part
        for name, words in instructions()
        if name == "COPY" and "--from" not in words
        for part in words.split()[:-1]
    ]
    assert all((ROOT / part).exists() for part in copied)
    there = " ".join(copied)
    for needed in ("pyproject.toml", PROJECT["readme"], *PROJECT["license-files"][:2], "pipeline", "cli"):
        assert needed in there


@pytest.mark.external
def test_the_container_is_built(tmp_path: Path) -> None:
    """A daemon is needed, and the network."""
    program = shutil.which("docker") or shutil.which("podman")
    if program is None or subprocess.run([program, "info"], capture_output=True, check=False).returncode:
        pytest.skip("no container builder works on this machine")
    subprocess.run([program, "build", "--file", CONTAINER, "--tag", "mocap-id-test", ROOT], check=True)
    said = subprocess.run(
        [program, "run", "--rm", "mocap-id-test", "--version"], capture_output=True, text=True, check=True
    )
    assert said.stdout == f"mocap-id {__version__}\n"


def test_the_citation() -> None:
    """The keys and their forms are those of the Citation File Format 1.2.0."""
    found = load(ROOT / "CITATION.cff")
    assert {"cff-version", "message", "title", "authors", "version", "date-released", "license"} <= set(found)
    assert (found["cff-version"], found["type"]) == ("1.2.0", "software")
    assert (found["title"], found["version"]) == (PROJECT["name"], __version__)
    assert found["authors"] == PROJECT["authors"]
    assert " AND ".join(found["license"]) == PROJECT["license"]
    assert re.fullmatch(r"\d{4}-\d{2}-\d{2}", found["date-released"])
    (thesis,) = found["references"]
    assert {"type", "title", "authors"} <= set(thesis)
