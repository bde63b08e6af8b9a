"""Equations of the pages as MathML, made when the site is built: nothing is left for a browser to fetch or run.

A fence ``math`` is a displayed equation, text between dollars an inline one, as on GitHub. ``\\tag{3.16}`` numbers an
equation after the thesis and gives it the anchor ``eq-3-16``.
"""

from __future__ import annotations

import re
from html import unescape
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from pymdownx.superfences import SuperFencesException

TAG = re.compile(r"\\tag\{([\d.]+)\}")
MATHML = "http://www.w3.org/1998/Math/MathML"
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
    ElementTree.register_namespace("", MATHML)
    tree = ElementTree.fromstring(made)
    for accented in tree.iter(f"{{{MATHML}}}mover"):
        if accented[1].tag == f"{{{MATHML}}}mo":
            accented.set("accent", "true")  # a dot of full size, close above its letter
    for row in tree.iter(f"{{{MATHML}}}mrow"):
        for before, bracket in pairwise(row):
            if before.tag == f"{{{MATHML}}}mtable" and bracket.tag == f"{{{MATHML}}}mo":
                bracket.attrib.update(form="postfix", rspace="0.17em")  # a matrix does not touch what follows
    return ElementTree.tostring(tree, encoding="unicode")


def fence(source: str, *_: Any, **__: Any) -> str:
    """A displayed equation with its number."""
    found = TAG.search(source)
    name = found[1] if found else ""
    anchor = f' id="eq-{name.replace(".", "-")}"' if found else ""
    number = f'<span class="number">({name})</span>' if found else ""
    try:
        made = mathml(TAG.sub("", source), "block")
    except PluginError as error:
        raise SuperFencesException(str(error)) from error  # any other one would leave the source as code
    return f'<div class="equation"{anchor}><div class="scroll">{made}</div>{number}</div>'


def on_config(config: Any) -> Any:
    """Tell the fences' extension of the kind ``math``."""
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [{"name": "math", "class": "equation", "format": fence}]
    }
    return config


def on_page_content(html: str, **_: Any) -> str:
    """Inline equations."""
    return INLINE.sub(lambda found: mathml(unescape(found[1]), "inline"), html)
