"""Messages quoted in docs/troubleshooting.md exist in the program, as do the verdict codes on all pages."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest
from pages_of_docs import DOCS, PAGES, ROOT, inline_code, name

from mocap_id.reporting.explanations import EXPLANATIONS

PAGE = DOCS / "troubleshooting.md"
QUOTED = re.findall(r"`([^`]+)`", "\n".join(re.findall(r"^\| (`.*?`) \|", PAGE.read_text("utf-8"), flags=re.MULTILINE)))


@cache
def messages() -> str:
    """Return all texts of the program, one on each line, with a gap for each value."""
    found = []
    for path in sorted([*(ROOT / "pipeline").rglob("*.py"), *(ROOT / "cli").rglob("*.py")]):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                found.append("".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


@pytest.mark.parametrize("quoted", QUOTED)
def test_a_quoted_message_is_one_of_the_program(quoted: str) -> None:
    pattern = ".*?".join(re.escape(part.strip()) for part in quoted.split("…"))
    found = re.search(pattern, messages()) is not None
    assert found, quoted


def test_messages_are_quoted() -> None:
    assert len(QUOTED) > 15


@pytest.mark.parametrize("page", [page for page in PAGES if "concepts" in page.parts or page == PAGE], ids=name)
def test_codes_exist(page: object) -> None:
    """A hyphenated word in a link to the verdict page, or beside a level, is a code."""
    text = page.read_text("utf-8")  # type: ignore[attr-defined]
    assert set(re.findall(r"\[`([a-z-]+)`\]\(\.?\.?/?verdict\.md", text)) <= set(EXPLANATIONS)
    hyphenated = {code for code in inline_code(page) if re.fullmatch(r"[a-z]+(-[a-z]+)+", code)}  # type: ignore[arg-type]
    known = {"fit-joints", "ukf-smooth", "identify-dim", "mocap-id", "robot-joint", "sit-to-stand", "bounded-cone"}
    assert hyphenated - known <= set(EXPLANATIONS)
