"""OpenSim's XML: elements with a name, a text or children; and the document around them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree

Element: TypeAlias = "ElementTree.Element[Any]"
_VERSION = "40500"
"""Of the documents: any OpenSim from 4.5 on reads them."""


def element(tag: str, *, name: str | None = None, text: str | None = None, children: Iterable[Element] = ()) -> Element:
    """An element, with its ``name`` attribute where it has one."""
    made = ElementTree.Element(tag, {} if name is None else {"name": name})
    made.text = text
    made.extend(children)
    return made


def remark(text: str) -> Element:
    """A comment; XML forbids two hyphens in one."""
    return ElementTree.Comment(f" {text.replace('--', '- -')} ")


def numbers(values: Sequence[float]) -> str:
    """Numbers as OpenSim reads them, with all their digits."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def document(root: Element) -> bytes:
    """A whole file."""
    whole = ElementTree.Element("OpenSimDocument", {"Version": _VERSION})
    whole.append(root)
    ElementTree.indent(whole, "\t")
    text: bytes = ElementTree.tostring(whole, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
