"""OpenSim's XML elements and documents."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree

from mocap_id.workflows.export.files import make_legal
from mocap_id.workflows.export.inertia import BodyInertia

Element: TypeAlias = "ElementTree.Element[Any]"
_VERSION = "40500"  # version of the documents, readable by OpenSim 4.5 and later


def element(tag: str, *, name: str | None = None, text: str | None = None, children: Iterable[Element] = ()) -> Element:
    """Return an element, with a ``name`` attribute if given."""
    made = ElementTree.Element(tag, {} if name is None else {"name": name})
    made.text = text
    made.extend(children)
    return made


def comment(text: str) -> Element:
    """Return a comment, without the double hyphens that XML forbids."""
    return ElementTree.Comment(f" {text.replace('--', '- -')} ")


def format_numbers(values: Sequence[float]) -> str:
    """Return numbers as text with all their digits, separated by blanks."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def object_set(tag: str, objects: Iterable[Element]) -> Element:
    """Return a model's set of bodies, joints or markers, such as ``BodySet``."""
    return element(tag, name=tag.lower(), children=[element("objects", children=objects)])


def body_element(name: str, inertia: BodyInertia, components: Sequence[Element] = ()) -> Element:
    """Return a body with its mass, centre of mass, inertia and components such as geometry."""
    children = [element("components", children=components)] if components else []
    children += [
        element("mass", text=format_numbers([inertia.mass])),
        element("mass_center", text=format_numbers(inertia.centre)),
        element("inertia", text=format_numbers(inertia.inertia)),
    ]
    return element("Body", name=name, children=children)


def marker_element(name: str, body: str, position: Sequence[float]) -> Element:
    """Return a marker at a position (3,), m, in the frame of a body."""
    children = [
        element("socket_parent_frame", text=f"/bodyset/{body}"),
        element("location", text=format_numbers(position)),
    ]
    return element("Marker", name=name, children=children)


def coordinate_element(name: str, default: float, span: tuple[float, float], *, locked: bool = False) -> Element:
    """Return a coordinate of a joint with its default value and its range, rad or m."""
    children = [
        element("default_value", text=format_numbers([default])),
        element("range", text=format_numbers(span)),
    ]
    if locked:
        children.append(element("locked", text="true"))
    return element("Coordinate", name=name, children=children)


def offset_frame(
    name: str,
    parent: str,
    position: Sequence[float],
    angles: Sequence[float] = (0.0,) * 3,
    components: Sequence[Element] = (),
) -> Element:
    """Return a frame at a position (3,), m, in a parent frame, rotated by angles (3,), rad, about x, then y, then z."""
    children = [
        *components,
        element("socket_parent", text=parent),
        element("translation", text=format_numbers(position)),
        element("orientation", text=format_numbers(angles)),
    ]
    return element("PhysicalOffsetFrame", name=name, children=children)


def format_document(tag: str, name: str, children: Iterable[Element]) -> bytes:
    """Return the content of a file with one object; its name is changed if OpenSim does not accept it."""
    file = ElementTree.Element("OpenSimDocument", {"Version": _VERSION})
    file.append(element(tag, name=make_legal([name])[name], children=children))
    ElementTree.indent(file, "\t")
    text: bytes = ElementTree.tostring(file, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
