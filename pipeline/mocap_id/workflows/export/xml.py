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


def body_element(
    name: str, mass: float, centre: Sequence[float], inertia: Sequence[float], components: Sequence[Element] = ()
) -> Element:
    """Return a body with its mass, kg, its centre of mass (3,), m, and its inertia about this centre (6,), kg·m²."""
    children = [element("components", children=components)] if components else []
    children += [
        element("mass", text=numbers([mass])),
        element("mass_center", text=numbers(centre)),
        element("inertia", text=numbers(inertia)),
    ]
    return element("Body", name=name, children=children)


def offset_frame(
    name: str,
    parent: str,
    place: Sequence[float],
    turn: Sequence[float] = (0.0,) * 3,
    components: Sequence[Element] = (),
) -> Element:
    """Return a frame at a place (3,), m, of a parent frame, turned by OpenSim's angles (3,), rad."""
    children = [
        *components,
        element("socket_parent", text=parent),
        element("translation", text=numbers(place)),
        element("orientation", text=numbers(turn)),
    ]
    return element("PhysicalOffsetFrame", name=name, children=children)


def document(root: Element) -> bytes:
    """Return the content of a file."""
    file = ElementTree.Element("OpenSimDocument", {"Version": _VERSION})
    file.append(root)
    ElementTree.indent(file, "\t")
    text: bytes = ElementTree.tostring(file, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
