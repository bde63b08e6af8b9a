"""OpenSim's XML elements, and inertial parameters about each body's centre of mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import LINK_PARAMETERS, PLANAR_PARAMETERS
from mocap_id.geometry.so3 import hat
from mocap_id.workflows.export.files import make_legal
from mocap_id.workflows.run_folder import RunFolder

Element: TypeAlias = "ElementTree.Element[Any]"
_VERSION = "40500"  # version of the documents, readable by OpenSim 4.5 and later


def element(tag: str, *children: Element, name: str | None = None, text: str | None = None, **content: Any) -> Element:
    """Return an element, with a ``name`` attribute if given.

    It has these ``children``, and then one for each keyword: with a text, with numbers, or with children of its own.
    """
    made = ElementTree.Element(tag, {} if name is None else {"name": name})
    made.text = text
    made.extend(children)
    for key, value in content.items():
        child = ElementTree.SubElement(made, key)
        if isinstance(value, str):
            child.text = value
        elif all(isinstance(one, ElementTree.Element) for one in value):
            child.extend(value)
        else:
            child.text = format_numbers(value)
    return made


def comment(text: str) -> Element:
    """Return a comment, without the double hyphens that XML forbids."""
    return ElementTree.Comment(f" {text.replace('--', '- -')} ")


def format_numbers(values: Sequence[float]) -> str:
    """Return numbers as text with all their digits, separated by blanks."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def body_element(name: str, inertia: BodyInertia, *components: Element) -> Element:
    """Return a body with its mass, centre of mass, inertia and components such as geometry."""
    content: dict[str, Any] = {"components": components} if components else {}
    content |= {"mass": [inertia.mass], "mass_center": inertia.centre, "inertia": inertia.inertia}
    return element("Body", name=name, **content)


def marker_element(name: str, body: str, position: Sequence[float]) -> Element:
    """Return a marker at a position (3,), m, in the frame of a body."""
    return element("Marker", name=name, socket_parent_frame=f"/bodyset/{body}", location=position)


def coordinate_element(name: str, default: float, span: tuple[float, float], *, locked: bool = False) -> Element:
    """Return a coordinate of a joint with its default value and its range, rad or m."""
    lock = {"locked": "true"} if locked else {}
    return element("Coordinate", name=name, default_value=[default], range=span, **lock)


def offset_frame(
    name: str, parent: str, position: Sequence[float], angles: Sequence[float] = (0.0,) * 3, *components: Element
) -> Element:
    """Return a frame at a position (3,), m, in a parent frame, rotated by angles (3,), rad, about x, then y, then z."""
    return element(
        "PhysicalOffsetFrame",
        *components,
        name=name,
        socket_parent=parent,
        translation=position,
        orientation=angles,
    )


def format_document(tag: str, trial: str, *children: Element, **content: Any) -> bytes:
    """Return the content of a file with one object; its name is the trial's, changed if OpenSim does not accept it."""
    file = ElementTree.Element("OpenSimDocument", {"Version": _VERSION})
    file.append(element(tag, *children, name=make_legal([trial])[trial], **content))
    ElementTree.indent(file, "\t")
    text: bytes = ElementTree.tostring(file, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


LEAST_MASS = 1e-9  # kg: OpenSim rejects a chain whose last body is massless


@dataclass(frozen=True)
class BodyInertia:
    """Inertia of a body about its centre of mass."""

    mass: float  # kg
    centre: tuple[float, ...]  # (3,) centre of mass in the segment's frame, m
    inertia: tuple[float, ...]  # (6,) Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, kg·m²


_PLACEHOLDER = BodyInertia(1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class ModelInertia:
    """Inertia of every segment, base first, and a text that describes where it comes from."""

    bodies: tuple[BodyInertia, ...]
    known: bool  # false for placeholders
    source: str


def convert_planar_inertia(block: FloatArray) -> BodyInertia:
    """Return the inertia about the centre of mass, from m, mx, my, Izz about the origin (4,).

    The inertia about the centre of mass is Izz - (mx² + my²) / m. It is set for all three axes, because Ixx and Iyy do
    not affect planar motion. A negative value, which rounding may cause, is set to zero.

    Examples
    --------
    >>> convert_planar_inertia(np.array([2.0, 0.0, 1.0, 0.75]))
    BodyInertia(mass=2.0, centre=(0.0, 0.5, 0.0), inertia=(0.25, 0.25, 0.25, 0.0, 0.0, 0.0))
    """
    mass, mx, my, inertia = (float(value) for value in block)
    if mass <= 0.0:
        mass, x, y, own = LEAST_MASS, 0.0, 0.0, max(inertia, 0.0)
    else:
        x, y, own = mx / mass, my / mass, max(inertia - (mx * mx + my * my) / mass, 0.0)
    return BodyInertia(mass, (x, y, 0.0), (own, own, own, 0.0, 0.0, 0.0))


def convert_spatial_inertia(block: FloatArray) -> BodyInertia:
    """Return the inertia about the centre of mass, from m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin.

    Examples
    --------
    >>> convert_spatial_inertia(np.array([2.0, 0.0, 1.0, 0.0, 0.75, 0.1, 0.75, 0.0, 0.0, 0.0])).inertia
    (0.25, 0.1, 0.25, 0.0, 0.0, 0.0)
    """
    mass, moment = float(block[0]), block[1:4]
    if mass <= 0.0:
        own = np.clip(block[4:], 0.0, None) * [1, 1, 1, 0, 0, 0]
        return BodyInertia(LEAST_MASS, (0.0, 0.0, 0.0), tuple(own.tolist()))
    xx, yy, zz, xy, xz, yz = block[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about_centre = about_origin + hat(moment) @ hat(moment) / mass
    own = about_centre[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] + 0.0
    return BodyInertia(mass, tuple((moment / mass).tolist()), tuple(own.tolist()))


def read_planar_inertia(run: RunFolder, count: int) -> ModelInertia:
    """Return the identified inertia of ``count`` segments; if there is none, that of the table, or placeholders."""
    for name, describe in (("value", _describe_identified), ("reference", _describe_reference)):
        values = _read_blocks(run, name)
        if values.size and np.isfinite(values).all():
            blocks = values.reshape(count, len(PLANAR_PARAMETERS))
            return ModelInertia(tuple(map(convert_planar_inertia, blocks)), True, describe(run))
    return _use_placeholders(run, count)


def read_spatial_inertia(run: RunFolder, count: int) -> ModelInertia:
    """Return the identified inertia of ``count`` segments in space, base first; placeholders if there is none."""
    values, width = _read_blocks(run, "value"), len(LINK_PARAMETERS)
    if values.size not in (width * count, width * (count - 1)) or not np.isfinite(values).all():
        return _use_placeholders(run, count)
    bodies = list(map(convert_spatial_inertia, values.reshape(-1, width)))
    base = [_PLACEHOLDER] * (count - len(bodies))
    also = "; the base has a placeholder" if base else ""
    source = f"one of the physically possible bodies with the identified base parameters{also}"
    return ModelInertia((*base, *bodies), True, source)


def _read_blocks(run: RunFolder, name: str) -> FloatArray:
    tree = run.tree("dynamics.h5")
    return np.zeros(0) if tree is None else tree.numbers(f"full/{name}").reshape(-1)


def _use_placeholders(run: RunFolder, count: int) -> ModelInertia:
    source = (
        f"placeholders of {_PLACEHOLDER.mass:g} kg and {_PLACEHOLDER.inertia[0]:g} kg·m² for each segment, because "
        f"OpenSim loads no chain without mass. No parameters were identified ({run.why_missing('dynamics.h5')}). Use "
        "this model for kinematics only"
    )
    return ModelInertia((_PLACEHOLDER,) * count, False, source)


def _describe_identified(run: RunFolder) -> str:
    tree = run.tree("dynamics.h5")
    assert tree is not None
    verdicts = tree.texts("base/verdict")
    facts = run.facts("dynamics.h5")
    table, motion = facts.get("reference_table"), facts.get("motion") or {}
    if motion.get("used"):
        return (
            f"parameters of {', '.join(motion['bodies'])}, identified on their measured poses and transferred to the "
            "chain of pin joints. Parameters that the recording does not determine are taken from "
            f"{motion['prior'] if table is None else _name_table(run)}, so the mass of a single segment is not "
            "meaningful. Torques and modelled wrench of the run belong to these bodies, not to this chain"
        )
    rest = "one of the physically possible bodies" if table is None else _name_table(run)
    counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in dict.fromkeys(verdicts))
    return (
        f"the {len(tree.texts('base/name'))} base parameters ({counts}) are identified. Their division into m, mx, my "
        f"and Izz of the segments is not identified: it is that of {rest}. Torques and ground wrench do not depend on "
        "the division"
    )


def _describe_reference(run: RunFolder) -> str:
    why = run.facts("dynamics.h5").get("why") or "no wrench"
    return f"parameters of {_name_table(run)}, for the subject's height and mass; none was identified ({why})"


def _name_table(run: RunFolder) -> str:
    table = run.facts("dynamics.h5").get("reference_table")
    return "the allometric table" if table is None else f"the allometric table `{table}`"
