"""The site is built without warnings and network access, with working links and equations."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from typing import ClassVar
from urllib.parse import unquote

import pytest
from pages_of_docs import DOCS, ROOT, blocks

pytest.importorskip("mkdocs", reason="the site needs `pip install mocap-id[docs]`")
pytestmark = pytest.mark.slow


class Links(HTMLParser):
    """Embedded files, links and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.linked: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a":
            self.linked += [given["href"]] if "href" in given else []
        else:
            self.fetched += [given[key] for key in ("src", "href", "srcset", "data") if key in given]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(target)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert not result.stderr, result.stderr
    return target


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Links]:
    return {page: Links(page.read_text("utf-8")) for page in sorted(site.rglob("*.html")) if page.name != "404.html"}


def test_every_page_is_there(site: Path) -> None:
    for page in DOCS.rglob("*.md"):
        assert (site / page.relative_to(DOCS)).with_suffix(".html").is_file()


def test_nothing_is_fetched_from_elsewhere(site: Path, pages: dict[Path, Links]) -> None:
    for page, links in pages.items():
        assert [link for link in links.fetched if re.match(r"https?:|//", link)] == [], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//|@import", sheet.read_text("utf-8")), sheet
    assert not re.search(r"https?:", "".join(re.findall(r"<script>.*?</script>", (site / "index.html").read_text())))


def test_every_link_leads_to_a_page_and_an_anchor(pages: dict[Path, Links]) -> None:
    broken = []
    for page, links in pages.items():
        for link in {*links.linked, *links.fetched}:
            if re.match(r"https?:|mailto:|data:", link):
                continue
            file, _, anchor = unquote(link).partition("#")
            target = (page.parent / file).resolve() if file else page
            if not target.exists() or (anchor and target in pages and anchor not in pages[target].anchors):
                broken.append(f"{page.name}: {link}")
    assert broken == []


def test_equations_are_equations(site: Path) -> None:
    numbers = set()
    for page in sorted((site / "concepts").glob("*.html")):
        text = page.read_text("utf-8")
        body = re.sub(r"<(pre|code)\b.*?</\1>", "", text, flags=re.DOTALL)
        assert not re.search(r"\\\(|\$\w|\\[a-z]+\{|arithmatex", body), page.name
        source = (DOCS / page.relative_to(site)).with_suffix(".md")
        assert text.count('class="equation"') == sum(block.kind == "math" for block in blocks(source)), page.name
        numbers |= set(re.findall(r'id="eq-([\d-]+)"', text))
    assert {"2-40", "3-16", "3-17", "3-18", "4-15", "4-26"} <= numbers
    assert (site / "_site" / "stix-two-math.woff").stat().st_size < 250_000


def test_an_equation_that_is_not_understood_stops_the_build(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("# x\n\n```math\n\\nosuchthing{x}\n```\n")
    hook = (DOCS / "_site" / "equations.py").as_posix()
    extensions = "markdown_extensions: [pymdownx.superfences]\n"
    (tmp_path / "mkdocs.yml").write_text(f"site_name: x\nhooks: ['{hook}']\n{extensions}")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode != 0
    assert "nosuchthing" in result.stderr


class _Quiet(SimpleHTTPRequestHandler):
    missed: ClassVar[list[str]] = []

    def log_message(self, format: str, *args: object) -> None:
        if "404" in str(args[1:2]):
            self.missed.append(str(args[0]))


@pytest.mark.external
@pytest.mark.parametrize("page", ["index.html", "concepts/regressor.html", "commands.html"])
def test_a_browser_has_nothing_to_complain_of(site: Path, page: str) -> None:
    browser = which("chromium") or which("chromium-browser") or which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    options = [
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=3000",
        "--enable-logging=stderr",
    ]
    only_here = "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"
    address = f"http://127.0.0.1:{server.server_port}/{page}"
    try:
        result = subprocess.run(
            [browser, *options, only_here, "--dump-dom", address],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        server.shutdown()
        server.server_close()
    assert "</html>" in result.stdout
    assert [line for line in result.stderr.splitlines() if "CONSOLE" in line] == []
    assert _Quiet.missed == []
