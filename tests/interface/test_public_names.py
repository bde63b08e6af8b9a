"""``import mocap_id`` is light, and its types are those of its names."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import mocap_id

ROOT = Path(__file__).resolve().parents[2]


def test_the_import_loads_no_library() -> None:
    code = "import sys, mocap_id; print(*sys.modules); mocap_id.RecordingError"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in found if name.startswith("mocap_id")] == ["mocap_id"]
    assert not {"numpy", "pandas", "pydantic", "scipy"} & set(found)


def test_the_types_have_the_public_names() -> None:
    tree = ast.parse((ROOT / "pipeline" / "mocap_id" / "__init__.pyi").read_text("utf-8"))
    typed = {
        alias.asname: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert {"__version__", *typed} == set(mocap_id.__all__)
    assert {name: f"mocap_id.{module}" for name, module in mocap_id._MODULES.items()} == typed


def test_an_unknown_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'runs'"):
        mocap_id.runs  # noqa: B018
    assert set(mocap_id.__all__) <= set(dir(mocap_id))


@pytest.mark.parametrize(("chosen", "expected"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_the_linear_algebra_has_one_thread(chosen: dict[str, str], expected: str) -> None:
    code = "import os, mocap_id; print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    call = [sys.executable, "-c", code]
    found = subprocess.run(call, env=environment | chosen, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == expected


def test_the_users_script_has_every_name() -> None:
    script = (ROOT / "tests" / "interface" / "typed_user_script.py").read_text("utf-8")
    assert [name for name in mocap_id.__all__ if f"mocap_id.{name}" not in script] == []


def test_types_of_users() -> None:
    """The types of the project come from mypy's cache, if `make test` has filled it."""
    script = "tests/interface/typed_user_script.py"
    call = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", script]
    said = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    assert "checked 1 source file" in said or "no issues found" in said
    assert [line for line in said.splitlines() if line.startswith(script)] == []
