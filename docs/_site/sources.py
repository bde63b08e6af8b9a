"""Links from a page to files of the source tree outside ``docs/``: on the site they lead to a page with that file.

On GitHub such links lead to the file itself; a site has only what it was built from. Links to folders become text.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from posixpath import normpath
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, InclusionLevel

LINK = re.compile(r"\[([^\]\n]*(?:\n[^\]\n]*)?)\]\(((?:\.\./)+)([^)#\s]*)(#[^)\s]*)?\)")
LOCAL = re.compile(r"\]\((?!https?:|#)([^)\s]*)\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml"}
FOLDER = "source"


def on_files(files: Any, config: Any) -> Any:
    """Add a page for every file outside that some page links to."""
    root = Path(config.docs_dir).parent
    wanted, seen = [file.src_uri for file in files.documentation_pages()], set()
    while wanted:
        uri = wanted.pop()
        for found in LINK.finditer(_text(files, uri)):
            target = _outside(uri, found)
            if target is None or target in seen or not (root / target).is_file():
                continue
            seen.add(target)
            shown = _shown(root / target, target)
            page = File.generated(config, _page(target), content=shown, inclusion=InclusionLevel.NOT_IN_NAV)
            files.append(page)
            wanted.append(page.src_uri)
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Turn links to the outside into links to those pages."""
    root = Path(config.docs_dir).parent

    def turned(found: re.Match[str]) -> str:
        target = _outside(page.file.src_uri, found)
        if target is None:
            return found[0]
        if not (root / target).exists():
            raise PluginError(f"{page.file.src_uri}: no {target} in the source tree")
        if (root / target).is_dir():
            return found[1]
        up = "../" * page.file.src_uri.count("/")
        return f"[{found[1]}]({up}{_page(target)}{found[4] or ''})"

    return LINK.sub(turned, markdown)


def _text(files: Any, uri: str) -> str:
    return str(files.get_file_from_path(uri).content_string)


def _outside(uri: str, found: re.Match[str]) -> str | None:
    """Where a link leads, from the top of the source tree; None within ``docs/``."""
    parts = list(PurePosixPath("docs", uri).parent.parts)
    climb = found[2].count("../")
    if climb > len(parts):
        raise PluginError(f"{uri}: {found[0]} leads out of the source tree")
    target = PurePosixPath(*parts[: len(parts) - climb], found[3])
    return None if target.parts[:1] == ("docs",) else target.as_posix()


def _page(target: str) -> str:
    return f"{FOLDER}/{target}" if target.endswith(".md") else f"{FOLDER}/{target}.md"


def _shown(path: Path, target: str) -> str:
    """The file as a page: Markdown with its links as seen from there, code in a fence; search leaves it out."""
    text = path.read_text("utf-8")
    head = "---\nsearch: {exclude: true}\nhide: [navigation, toc]\n---\n\n"
    if path.suffix != ".md":
        return f"{head}# `{target}`\n\n`````{LANGUAGES.get(path.suffix, 'text')}\n{text}\n`````\n"
    return head + LOCAL.sub(lambda found: f"]({_relinked(target, found[1])})", text)


def _relinked(target: str, link: str) -> str:
    """A link of a Markdown file outside ``docs/``, as its page on the site has to give it."""
    climbs = "../" * (1 + target.count("/"))  # to the top of the site, which is docs/
    leads = PurePosixPath(normpath(PurePosixPath(target).parent / link))
    return climbs + (leads.relative_to("docs").as_posix() if leads.parts[0] == "docs" else f"../{leads.as_posix()}")
