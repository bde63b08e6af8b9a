"""Equations of the pages as MathML, made when the site is built: nothing is left for a browser to fetch or run.

A fence ``math`` is a displayed equation, text between dollars an inline one, as on GitHub. ``\\tag{3.16}`` numbers an
equation after the thesis and gives it the anchor ``eq-3-16``.
"""

from __future__ import annotations

import re
from html import unescape
from typing import Any
from xml.etree import ElementTree

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

TAG = re.compile(r"\\tag\{([\d.]+)\}")
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)


def mathml(latex: str, display: str) -> str:
    """One equation.

    Parameters
    ----------
    latex : str
    display : str
        ``inline`` or ``block``.

    Raises
    ------
    PluginError
        Something in it is not understood, and would be shown as its source.
    """
    made = convert(latex, display=display)
    left = re.search(r"\\\w+|&(?!#?\w+;)", made)
    if left:
        raise PluginError(f"equation not understood at {left[0]!r}: {latex.strip()}")
    ElementTree.fromstring(made)
    return made


def fence(source: str, *_: Any, **__: Any) -> str:
    """A displayed equation with its number."""
    number = TAG.search(source)
    made = mathml(TAG.sub("", source), "block")
    if number is None:
        return f'<div class="equation">{made}</div>'
    name = number[1]
    return f'<div class="equation" id="eq-{name.replace(".", "-")}">{made}<span class="number">({name})</span></div>'


def on_config(config: Any) -> Any:
    """Tell the fences' extension of the kind ``math``."""
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [{"name": "math", "class": "equation", "format": fence}]
    }
    return config


def on_page_content(html: str, **_: Any) -> str:
    """Inline equations."""
    return INLINE.sub(lambda found: mathml(unescape(found[1]), "inline"), html)
