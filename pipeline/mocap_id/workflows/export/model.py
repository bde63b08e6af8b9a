"""The recovered chain as an OpenSim model: bodies, pin joints about z, markers.

OpenSim's ground is the plane frame: x along the motion, y up, z out of the plane. A planar joint with three
coordinates locked at zero fixes the base segment to it. At these coordinates, inverse dynamics gives the required
ground wrench less the external loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.store.views import JointStates, Skeleton
from mocap_id.workflows.export.inertia import Bodies, BodyInertia
from mocap_id.workflows.export.markers import depths, marker_labels
from mocap_id.workflows.export.names import BASE, body_names, coordinate_names, joint_names, legal
from mocap_id.workflows.export.xml import Element, body_element, document, element, numbers, offset_frame, remark
from mocap_id.workflows.run_folder import RunFolder

_BASE_COORDINATES = (f"{BASE}_rz", f"{BASE}_tx", f"{BASE}_ty")
_RADIUS = 0.02  # m, of the cylinder that represents a segment
_RANGE = 2 * np.pi


@dataclass(frozen=True)
class _Chain:
    skeleton: Skeleton
    bodies: tuple[str, ...]
    inertia: tuple[BodyInertia, ...]
    lengths: FloatArray  # (n + 1,) from each segment's origin to the next joint or the tip, m


def model(run: RunFolder, skeleton: Skeleton, inertia: Bodies) -> bytes:
    """Return the content of the model file.

    Parameters
    ----------
    run : RunFolder
    skeleton : Skeleton
        Skeleton in its chain.h5.
    inertia : Bodies
        Inertia of its segments.
    """
    tips = np.vstack([skeleton.centres, skeleton.tip])
    chain = _Chain(skeleton, body_names(skeleton), inertia.inertia, np.linalg.norm(tips, axis=1))
    places = (skeleton.marker_segment, skeleton.local)
    children = [
        remark(f"Made by mocap-id {__version__} from the trial {run.name}. Ground is the plane frame."),
        remark(f"Inertial parameters: {inertia.source}."),
        remark(
            "Ixx and Iyy do not affect planar motion and are unknown: they are set to Izz. "
            "Centres of mass lie in the plane z = 0."
        ),
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=numbers([0.0, -gravity(run), 0.0])),
        object_set("BodySet", (_body(chain, k) for k in range(len(chain.bodies)))),
        object_set("JointSet", (_base_joint(chain), *_joints(run, chain))),
        object_set("MarkerSet", marker_elements(run, chain.bodies, skeleton.markers, places)),
    ]
    return document(element("Model", name=legal([run.name])[run.name], children=children))


def object_set(tag: str, objects: Iterable[Element]) -> Element:
    """Return a model's set of bodies, joints or markers."""
    return element(tag, name=tag.lower(), children=[element("objects", children=objects)])


def gravity(run: RunFolder) -> float:
    """Return the gravity that the identification used, m/s²."""
    about = run.provenance.get("dynamics.h5")
    settings = {} if about is None else about.origin.parameters.get("identify-dim") or {}
    return float(settings.get("gravity", 9.81))


def _body(chain: _Chain, k: int) -> Element:
    return planar_body(chain.bodies[k], chain.inertia[k], [_cylinder(chain, k)] if k else ())


def planar_body(name: str, found: BodyInertia, components: Sequence[Element] = ()) -> Element:
    """Return a body with its inertia in the plane; the same about all axes."""
    return body_element(name, found.mass, [*found.centre, 0.0], [found.inertia] * 3 + [0.0] * 3, components)


def _cylinder(chain: _Chain, k: int) -> Element:
    """Return a cylinder along the segment's y axis, from its joint to the next one or to the tip."""
    half = chain.lengths[k] / 2
    cylinder = [
        element("socket_frame", text=".."),
        element("radius", text=numbers([_RADIUS])),
        element("half_height", text=numbers([half])),
    ]
    geometry = element("attached_geometry", children=[element("Cylinder", name="stick", children=cylinder)])
    return offset_frame(f"{chain.bodies[k]}_middle", "..", [0.0, half, 0.0], components=[geometry])


def planar_joint(name: str, body: str, coordinates: Iterable[Element]) -> Element:
    """Return a planar joint between ground and body; coordinates: angle, and x and y of the frame's origin."""
    return element(
        "PlanarJoint",
        name=name,
        children=[
            element("socket_parent_frame", text="/ground"),
            element("socket_child_frame", text=f"/bodyset/{body}"),
            element("coordinates", children=coordinates),
        ],
    )


def _base_joint(chain: _Chain) -> Element:
    coordinates = [coordinate_element(name, 0.0, locked=True) for name in _BASE_COORDINATES]
    return planar_joint(BASE, chain.bodies[0], coordinates)


def _joints(run: RunFolder, chain: _Chain) -> Iterator[Element]:
    """Yield pin joints about z; joint j moves segment j and lies at its centre in the previous segment's frame."""
    first, ranges = _angle_ranges(run, len(chain.skeleton.joints))
    names = zip(joint_names(chain.skeleton), coordinate_names(chain.skeleton), strict=True)
    for j, (joint, coordinate) in enumerate(names):
        parent, frame = chain.bodies[int(chain.skeleton.parents[j])], f"{joint}_centre"
        yield element(
            "PinJoint",
            name=joint,
            children=[
                element("socket_parent_frame", text=frame),
                element("socket_child_frame", text=f"/bodyset/{chain.bodies[j + 1]}"),
                element("coordinates", children=[coordinate_element(coordinate, first[j], ranges[j])]),
                element(
                    "frames", children=[offset_frame(frame, f"/bodyset/{parent}", [*chain.skeleton.centres[j], 0.0])]
                ),
            ],
        )


def _angle_ranges(run: RunFolder, joints: int) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Return each joint's first known angle, and a range that contains all its angles and ±2π, rad."""
    table = run.table("states.parquet")
    first, ranges = np.zeros(joints), [(-_RANGE, _RANGE)] * joints
    if table is None:
        return first, ranges
    for j, angles in enumerate(JointStates.from_table(table).angles.T):
        known = angles[np.isfinite(angles)]
        if len(known):
            first[j] = known[0]
            ranges[j] = (min(-_RANGE, float(known.min())), max(_RANGE, float(known.max())))
    return first, ranges


def coordinate_element(
    name: str, default: float, span: tuple[float, float] = (-_RANGE, _RANGE), *, locked: bool = False
) -> Element:
    """Return a coordinate of a joint, rad or m."""
    children = [element("default_value", text=numbers([default])), element("range", text=numbers(span))]
    if locked:
        children.append(element("locked", text="true"))
    return element("Coordinate", name=name, children=children)


def marker_elements(
    run: RunFolder, bodies: Sequence[str], markers: Sequence[str], at: tuple[IntArray, FloatArray]
) -> Iterator[Element]:
    """Yield markers in the frames of their bodies, at their median distance from the plane.

    Parameters
    ----------
    run : RunFolder
    bodies : sequence of str
        Names in OpenSim.
    markers : sequence of str, length M
        Names in the recording.
    at : ((M,) int array, (M, 2) array)
        Body of each marker, and position in that body's frame, m.
    """
    labels, out = marker_labels(run), depths(run)
    for label, body, local in zip(markers, *at, strict=True):
        yield element(
            "Marker",
            name=labels.get(label, label),
            children=[
                element("socket_parent_frame", text=f"/bodyset/{bodies[int(body)]}"),
                element("location", text=numbers([*local, out.get(label, 0.0)])),
            ],
        )
