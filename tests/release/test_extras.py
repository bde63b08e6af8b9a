"""A package of an extra that is not installed: the message names the command that installs it."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

from mocap_id.errors import ConfigError
from mocap_id.extras import optional
from mocap_id.workflows.parallel import DaskBackend

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
SOURCES = [*(ROOT / "pipeline").rglob("*.py"), *(ROOT / "cli").rglob("*.py")]
MODULES = {"ruamel-yaml": "ruamel", "ruamel.yaml": "ruamel", "mocap-id": "mocap_id"}


def test_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    assert optional("math", "cluster", "this test").sqrt(4.0) == 2.0
    monkeypatch.setitem(sys.modules, "distributed", None)
    backend = DaskBackend("tcp://nowhere:1")
    expected = re.escape("running on a cluster needs it: pip install 'mocap-id[cluster]'")
    with pytest.raises(ConfigError, match=expected), backend.workers(2):
        pass


def imported() -> set[str]:
    """Return the packages that the program imports, without those that it needs for its types alone."""
    found = set()
    for path in SOURCES:
        waiting: list[ast.AST] = [*ast.parse(path.read_text("utf-8")).body]
        while waiting:
            node = waiting.pop()
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(str(node.module).partition(".")[0])
            elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
                for part in ("body", "orelse", "handlers", "finalbody"):
                    waiting += inner if isinstance(inner := getattr(node, part, None), list) else []
    return found


def test_every_import_is_a_requirement() -> None:
    """A module of an extra is imported by ``optional``."""
    known = {MODULES.get(name, name) for name in (re.split(r"[><=]", one)[0] for one in PROJECT["dependencies"])}
    known |= {
        "mocap_id",
        "mocap_id_assist",
        "mocap_id_simulation",
        "mocap_id_cli",
        "pydantic_core",
        *sys.stdlib_module_names,
    }
    found = imported()
    assert len(found) > len(PROJECT["dependencies"])
    assert found - known == set()


def test_every_extra_that_is_named_exists() -> None:
    calls = [
        call for path in SOURCES for call in re.findall(r"\boptional\(\s*[^,()]+,\s*\"(\w+)\"", path.read_text("utf-8"))
    ]
    assert "cluster" in calls
    assert set(calls) <= set(PROJECT["optional-dependencies"])


def test_the_page_lists_every_extra() -> None:
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    listed = set(re.findall(r"pip install 'mocap-id\[(\w+)\]'", page))
    assert listed == set(PROJECT["optional-dependencies"])
