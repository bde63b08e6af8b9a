"""``import mocap_id`` is light, and its types are those of its names."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import scipy.linalg  # noqa: F401  loads the linear algebra whose threads are counted
from threadpoolctl import threadpool_info, threadpool_limits

import mocap_id
from mocap_id.interface import running

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


def blas_threads() -> int:
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


@pytest.mark.parametrize("chosen", [None, "3"])
def test_a_run_has_one_thread_of_linear_algebra(chosen: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    if chosen is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", chosen)
    seen = []

    def fake_run(trial: Path, progress: object) -> SimpleNamespace:
        seen.append(blas_threads())
        return SimpleNamespace(folder=trial, steps=())

    monkeypatch.setattr(running, "load", lambda path: path)
    monkeypatch.setattr(running, "open_lazily", lambda folder: folder)
    monkeypatch.setattr(running.runner, "run", fake_run)
    with threadpool_limits(2, "blas"):
        mocap_id.run("trial.yaml")
        assert blas_threads() == 2
    assert seen == [1 if chosen is None else 2]


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
