"""Every page can be reached, and every link has a target, on GitHub and on the site."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pages_of_docs import DOCS, PAGES, ROOT, anchors, name, prose
from ruamel.yaml import YAML

by_name = pytest.mark.parametrize("page", PAGES, ids=name)


def links(page: Path) -> list[str]:
    return re.findall(r"\]\(([^)\s]+)\)", prose(page))


@by_name
def test_links_lead_to_a_file_and_a_heading(page: Path) -> None:
    for link in links(page):
        if link.startswith("http"):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), f"{name(page)} links to {link}: there is no such file"
        assert not anchor or anchor in anchors(target), f"{name(page)} links to {link}: {file} has no such heading"


@by_name
def test_nothing_on_a_page_is_fetched_from_elsewhere(page: Path) -> None:
    """Links may be external; images and other embedded files must not."""
    shown = re.findall(
        r"!\[[^\]]*\]\(([^)\s]+)|<(?:img|script|link|iframe)\b[^>]*(?:src|href)=[\"']?([^\"'>\s]+)", prose(page)
    )
    assert [address for pair in shown for address in pair if re.match(r"https?:|//", address)] == []


@by_name
def test_lists_and_tables_are_told_from_the_paragraph_before(page: Path) -> None:
    """The site needs a blank line there, although GitHub does not."""
    before, fenced = "", False
    for number, line in enumerate(page.read_text("utf-8").splitlines(), 1):
        fenced ^= line.startswith("```")
        starts = re.match(r"- |1\. ", line) or (line.startswith("|") and not before.startswith("|"))
        in_list = before.startswith((" ", "- ")) or re.match(r"\d+\. ", before)
        if not fenced and starts and not in_list:
            assert not before.strip(), f"{name(page)}, line {number}: put a blank line before it"
        before = line


def stations(part: object) -> Iterator[str]:
    """Return the pages of a navigation, in order."""
    if isinstance(part, str):
        yield part
    else:
        for each in part if isinstance(part, list) else part.values():  # type: ignore[attr-defined]
            yield from stations(each)


def test_the_navigation_has_every_page_once() -> None:
    listed = list(stations(YAML().load((ROOT / "mkdocs.yml").read_text("utf-8"))["nav"]))
    pages = [page.relative_to(DOCS).as_posix() for page in PAGES if DOCS in page.parents]
    assert sorted(set(listed)) == sorted(listed), "a page stands twice in the navigation"
    lost = sorted(set(pages) - set(listed))
    assert not lost, f"in no section of `nav` in mkdocs.yml: {', '.join(lost)}"
    gone = sorted(set(listed) - set(pages))
    assert not gone, f"`nav` in mkdocs.yml names pages that are not there: {', '.join(gone)}"


def test_the_readme_or_the_home_page_leads_to_every_page() -> None:
    """Readers on GitHub have no navigation."""
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        local = (link.partition("#")[0] for link in links(page) if not link.startswith("http"))
        waiting += [(page.parent / link).resolve() for link in local if link.endswith(".md")]
    assert [name(page) for page in PAGES if DOCS in page.parents and page not in reached] == []
