"""Every reason code in the program is explained in the report and in the documentation."""

from __future__ import annotations

import ast
from pathlib import Path

import mocap_id
from mocap_id.reporting.explanations import EXPLANATIONS, FILES, as_markdown, read_texts

PACKAGE = Path(mocap_id.__file__).parent
DOCUMENT = PACKAGE.parent.parent / "docs" / "verdict.md"


def carriers(trees: list[ast.Module]) -> set[str]:
    """Return the classes with a reason code: ``Refused``, and those whose first field is ``code``."""
    found = {"Refused"}
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                fields = [item.target for item in node.body if isinstance(item, ast.AnnAssign)]
                if fields and isinstance(fields[0], ast.Name) and fields[0].id == "code":
                    found.add(node.name)
    return found


def raised_codes() -> set[str]:
    """Return the constant codes in all calls of these classes, and of the method ``say``, in the source code."""
    trees = [ast.parse(file.read_text("utf-8")) for file in PACKAGE.rglob("*.py")]
    makers = carriers(trees)
    assert "Reason" in makers
    codes: set[str] = set()
    for tree in trees:
        for node in ast.walk(tree):
            made = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in makers
            said = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "say"
            if isinstance(node, ast.Call) and (made or said):
                given = [*node.args[:1], *(keyword.value for keyword in node.keywords if keyword.arg == "code")]
                constants = (
                    leaf for argument in given for leaf in ast.walk(argument) if isinstance(leaf, ast.Constant)
                )
                codes |= {leaf.value for leaf in constants if isinstance(leaf.value, str)}
    return codes


def test_no_code_is_explained_twice() -> None:
    assert len(EXPLANATIONS) == sum(len(read_texts(file)) for file in FILES)


def test_every_code_is_explained_and_no_other() -> None:
    assert raised_codes() == set(EXPLANATIONS)


def test_the_documentation_says_the_same() -> None:
    text = DOCUMENT.read_text("utf-8")
    assert text.partition("## Every code\n\n")[2] == as_markdown(), (
        "docs/verdict.md: replace what follows `## Every code` by mocap_id.reporting.explanations.as_markdown()"
    )
