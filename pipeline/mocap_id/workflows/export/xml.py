"""OpenSim's XML elements and documents."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree

Element: TypeAlias = "ElementTree.Element[Any]"
_VERSION = "40500"
"""Version of the documents, readable by OpenSim 4.5 and later."""


def element(tag: str, *, name: str | None = None, text: str | None = None, children: Iterable[Element] = ()) -> Element:
    """Return an element, with a ``name`` attribute if given."""
    found = ElementTree.Element(tag, {} if name is None else {"name": name})
    found.text = text
    found.extend(children)
    return found


def remark(text: str) -> Element:
    """Return a comment, without the double hyphens that XML forbids."""
    return ElementTree.Comment(f" {text.replace('--', '- -')} ")


def numbers(values: Sequence[float]) -> str:
    """Return numbers with all their digits, separated by blanks."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def document(root: Element) -> bytes:
    """Return the content of a file."""
    file = ElementTree.Element("OpenSimDocument", {"Version": _VERSION})
    file.append(root)
    ElementTree.indent(file, "\t")
    text: bytes = ElementTree.tostring(file, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
