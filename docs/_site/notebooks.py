"""Notebooks as pages of the site: text as text, code cells as blocks of code. They are stored without results.

A link to a notebook leads to its page; there, another one downloads the notebook itself.
"""

from __future__ import annotations

import json
import re
from pathlib import PurePosixPath
from typing import Any

from mkdocs.structure.files import File, InclusionLevel

LINK = re.compile(r"(\]\([^)\s:]*)\.ipynb\)")


def on_files(files: Any, config: Any) -> Any:
    """Add a page for every notebook."""
    for file in list(files):
        if file.src_uri.endswith(".ipynb"):
            page = f"{file.src_uri.removesuffix('.ipynb')}.md"
            shown = _shown(file.content_string, PurePosixPath(file.src_uri).name)
            files.append(File.generated(config, page, content=shown, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Turn links to notebooks into links to their pages."""
    return LINK.sub(r"\1.md)", markdown)


def _shown(text: str, name: str) -> str:
    cells = json.loads(text)["cells"]
    title, *rest = ("".join(cells[0]["source"])).split("\n", 1)
    parts = [title, f'<a href="{name}" download>Download this notebook</a>', *rest]
    for cell in cells[1:]:
        source = "".join(cell["source"])
        parts.append(f"```python\n{source}\n```" if cell["cell_type"] == "code" else source)
    return "\n\n".join(parts) + "\n"
