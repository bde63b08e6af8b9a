"""The recovered chain as an OpenSim model, in the plane and in space, with set-up files of OpenSim's tools.

OpenSim's ground is the plane frame: x along the motion, y up, z out of the plane. The base segment is fixed to it by a
planar joint, whose three coordinates are locked at zero. For these coordinates, inverse dynamics gives the required
ground wrench minus the external loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import GRAVITY, FloatArray, IntArray
from mocap_id.dynamics.regressor import LINK_PARAMETERS, PLANAR_PARAMETERS
from mocap_id.geometry import so3
from mocap_id.geometry.so3 import hat
from mocap_id.store.artefacts import JointStates, MeasuredPoses, Skeleton, SpatialSkeleton
from mocap_id.workflows.export.tables import (
    ANGLES,
    BASE,
    LOADS,
    MEASURED_MARKERS,
    MODEL,
    ExportFiles,
    make_legal,
    measure_depths,
    name_coordinates,
    opensim_bodies,
    opensim_joints,
    rename_markers,
)
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


def format_numbers(values: Sequence[float]) -> str:
    """Return numbers as text with all their digits, separated by blanks."""
    return " ".join(f"{float(value) + 0.0:.17g}" for value in values)


def body_element(name: str, inertia: BodyInertia, *components: Element) -> Element:
    """Return a body with its mass, centre of mass, inertia and components such as geometry."""
    content: dict[str, Any] = {"components": components} if components else {}
    mass, centre, about_centre = inertia
    content |= {"mass": [mass], "mass_center": centre, "inertia": about_centre}
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


BodyInertia: TypeAlias = tuple[float, tuple[float, ...], tuple[float, ...]]
"""Mass, kg, centre of mass (3,) in the segment's frame, m, and Ixx, Iyy, Izz, Ixy, Ixz, Iyz about it, kg·m²."""
_PLACEHOLDER: BodyInertia = (1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0))

Inertias: TypeAlias = tuple[tuple[BodyInertia, ...], str]
"""Inertia of every segment, base first, and a text that describes where it comes from."""


def convert_planar_inertia(block: FloatArray) -> BodyInertia:
    """Return the inertia about the centre of mass, from m, mx, my, Izz about the origin (4,).

    The inertia about the centre of mass is Izz - (mx² + my²) / m. It is set for all three axes, because Ixx and Iyy do
    not affect planar motion. A negative value, which rounding may cause, is set to zero.

    >>> convert_planar_inertia(np.array([2.0, 0.0, 1.0, 0.75]))
    (2.0, (0.0, 0.5, 0.0), (0.25, 0.25, 0.25, 0.0, 0.0, 0.0))
    """
    mass, mx, my, inertia = (float(value) for value in block)
    if mass <= 0.0:
        mass, x, y, own = LEAST_MASS, 0.0, 0.0, max(inertia, 0.0)
    else:
        x, y, own = mx / mass, my / mass, max(inertia - (mx * mx + my * my) / mass, 0.0)
    return (mass, (x, y, 0.0), (own, own, own, 0.0, 0.0, 0.0))


def convert_spatial_inertia(block: FloatArray) -> BodyInertia:
    """Return the inertia about the centre of mass, from m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin.

    >>> convert_spatial_inertia(np.array([2.0, 0.0, 1.0, 0.0, 0.75, 0.1, 0.75, 0.0, 0.0, 0.0]))[2]
    (0.25, 0.1, 0.25, 0.0, 0.0, 0.0)
    """
    mass, moment = float(block[0]), block[1:4]
    if mass <= 0.0:
        own = np.clip(block[4:], 0.0, None) * [1, 1, 1, 0, 0, 0]
        return LEAST_MASS, (0.0, 0.0, 0.0), tuple(own.tolist())
    xx, yy, zz, xy, xz, yz = block[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about_centre = about_origin + hat(moment) @ hat(moment) / mass
    own = about_centre[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] + 0.0
    return mass, tuple((moment / mass).tolist()), tuple(own.tolist())


def _read_planar_inertia(run: RunFolder, count: int) -> Inertias | None:
    """Return the identified inertia of ``count`` segments, or else that of the table; None if there is none."""
    tree, facts = run.tree("dynamics.h5"), run.facts("dynamics.h5")
    value, reference = (
        np.zeros(0) if tree is None else tree.numbers(f"full/{name}").reshape(-1) for name in ("value", "reference")
    )
    table = facts.get("reference_table")
    table_name = "the allometric table" if table is None else f"the allometric table `{table}`"
    if tree is not None and value.size and np.isfinite(value).all():
        motion = facts.get("motion") or {}
        rest = "one of the physically possible bodies" if table is None else table_name
        verdicts = tree.texts("base/verdict")
        counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in dict.fromkeys(verdicts))
        source = (
            f"the {len(tree.texts('base/name'))} base parameters ({counts}) are identified. Their division into m, mx, "
            f"my and Izz of the segments is not identified: it is that of {rest}. Torques and ground wrench do not "
            "depend on the division"
        )
        if motion.get("used"):
            source = (
                f"parameters of {', '.join(motion['bodies'])}, identified on their measured poses and transferred to "
                "the chain of pin joints. Parameters that the recording does not determine are taken from "
                f"{motion['prior'] if table is None else table_name}, so the mass of a single segment is not "
                "meaningful. Torques and modelled wrench of the run belong to these bodies, not to this chain"
            )
    elif reference.size and np.isfinite(reference).all():
        value, why = reference, facts.get("why") or "no wrench"
        source = f"parameters of {table_name}, for the subject's height and mass; none was identified ({why})"
    else:
        return None
    return tuple(map(convert_planar_inertia, value.reshape(count, len(PLANAR_PARAMETERS)))), source


def _read_spatial_inertia(run: RunFolder, count: int) -> Inertias:
    """Return the identified inertia of ``count`` segments in space, base first; placeholders if there is none."""
    tree, width = run.tree("dynamics.h5"), len(LINK_PARAMETERS)
    values = np.zeros(0) if tree is None else tree.numbers("full/value").reshape(-1)
    if values.size not in (width * count, width * (count - 1)) or not np.isfinite(values).all():
        return _use_placeholders(run, count)
    bodies = list(map(convert_spatial_inertia, values.reshape(-1, width)))
    base = [_PLACEHOLDER] * (count - len(bodies))
    also = "; the base has a placeholder" if base else ""
    return (*base, *bodies), f"one of the physically possible bodies with the identified base parameters{also}"


def _use_placeholders(run: RunFolder, count: int) -> Inertias:
    source = (
        f"placeholders of {_PLACEHOLDER[0]:g} kg and {_PLACEHOLDER[2][0]:g} kg·m² for each segment, because "
        f"OpenSim loads no chain without mass. No parameters were identified ({run.why_missing('dynamics.h5')}). Use "
        "this model for kinematics only"
    )
    return (_PLACEHOLDER,) * count, source


# The model in the plane.

LEAST_RANGE = 2 * np.pi  # every coordinate of a model can change at least by this in both directions, rad or m

_RADIUS = 0.02  # m, of the cylinder that represents a segment
_ACCURACY = "1e-8"  # with its default of 1e-5, OpenSim ends 0.2° rms, at worst 0.8°, from the least-squares solution


def export_model(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>.osim``, ``<trial>_ik.xml`` and ``<trial>_id.xml`` of a trial in the plane.

    The last file is omitted if the states or the inertial parameters are unknown.
    """
    tree, states = run.tree("chain.h5"), run.table("states.parquet")
    if tree is None:
        out.note(f"osim: no model: {run.why_missing('chain.h5')}")
        return
    skeleton = Skeleton(tree)
    segments = opensim_bodies(skeleton.segments)
    known = _read_planar_inertia(run, len(segments))
    inertias, source = known or _use_placeholders(run, len(segments))
    # Bodies; a cylinder along the y axis of each, from its joint to the next joint or to the tip, shows where it is.
    lengths = np.linalg.norm(np.vstack([skeleton.centres, skeleton.tip]), axis=1)
    bodies = [body_element(segments[0], inertias[0])]
    for name, body, length in zip(segments[1:], inertias[1:], lengths[1:], strict=True):
        half = length / 2
        stick = element("Cylinder", name="stick", socket_frame="..", radius=[_RADIUS], half_height=[half])
        shown = element("attached_geometry", stick)
        bodies.append(
            body_element(name, body, offset_frame(f"{name}_middle", "..", [0.0, half, 0.0], (0.0,) * 3, shown))
        )
    # A locked joint of the base, and pin joints about z: joint j moves segment j, and its centre is fixed in the frame
    # of the parent segment.
    base = [coordinate_element(f"{BASE}_{each}", 0.0, _widen(), locked=True) for each in ("rz", "tx", "ty")]
    joints = [planar_joint(BASE, segments[0], base)]
    coordinates = name_coordinates(skeleton)
    angles = np.zeros((0, len(coordinates))) if states is None else JointStates.from_table(states).angles
    for j, (joint, coordinate) in enumerate(zip(opensim_joints(skeleton), coordinates, strict=True)):
        parent, frame = segments[int(skeleton.parents[j])], f"{joint}_centre"
        taken = angles[np.isfinite(angles[:, j]), j]
        pin = element(
            "PinJoint",
            name=joint,
            socket_parent_frame=frame,
            socket_child_frame=f"/bodyset/{segments[j + 1]}",
            coordinates=[coordinate_element(coordinate, taken[0] if len(taken) else 0.0, _widen(taken))],
            frames=[offset_frame(frame, f"/bodyset/{parent}", [*skeleton.centres[j], 0.0])],
        )
        joints.append(pin)
    comments = (
        f"Inertial parameters: {source}.",
        "Ixx and Iyy do not affect planar motion and are unknown: they are set to Izz. "
        "Centres of mass lie in the plane z = 0.",
    )
    markers = place_markers(run, segments, skeleton.markers, skeleton.marker_segment, skeleton.local)
    out.files[run.name + MODEL] = format_model(
        run, "the plane frame", comments, bodies=bodies, joints=joints, markers=markers
    )
    out.files[f"{run.name}_ik.xml"] = format_kinematics_setup(run, skeleton.markers)
    if states is not None and known is not None:
        table = run.table("wrench.parquet")
        has_forces = table is not None and bool(np.isfinite(table["Fy"]).any())
        setup = format_dynamics_setup(run, (MODEL, ANGLES, "_opensim_id.sto"), LOADS if has_forces else None)
        out.files[f"{run.name}_id.xml"] = setup
    out.note(f"osim: inertial parameters: {source}")


def format_model(
    run: RunFolder,
    ground: str,
    comments: Iterable[str],
    *,
    bodies: Iterable[Element],
    joints: Iterable[Element],
    markers: Iterable[Element],
) -> bytes:
    """Return the content of a model file; ``ground`` is the name of the coordinate frame of OpenSim's ground."""
    made = f"Made by mocap-id {__version__} from the trial {run.name}. Ground is {ground}."
    sets = {"BodySet": bodies, "JointSet": joints, "MarkerSet": markers}
    return format_document(
        "Model",
        run.name,
        *(ElementTree.Comment(f" {text.replace('--', '- -')} ") for text in (made, *comments)),  # XML forbids `--`
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=format_numbers([0.0, -read_gravity(run), 0.0])),
        *(element(tag, name=tag.lower(), objects=list(objects)) for tag, objects in sets.items()),
    )


def read_gravity(run: RunFolder) -> float:
    """Return the gravity that the identification used, m/s²; 9.81 if there is no identification."""
    about = run.provenance.get("dynamics.h5")
    settings = {} if about is None else about.origin.parameters.get("identify-dim") or {}
    return float(settings.get("gravity", GRAVITY))


def planar_joint(name: str, body: str, coordinates: Sequence[Element]) -> Element:
    """Return a planar joint between ground and body; its coordinates are angle, x and y of the body's frame."""
    sockets = {"socket_parent_frame": "/ground", "socket_child_frame": f"/bodyset/{body}"}
    return element("PlanarJoint", name=name, **sockets, coordinates=coordinates)


def place_markers(
    run: RunFolder, bodies: Sequence[str], markers: Sequence[str], segment: IntArray, local: FloatArray
) -> Iterator[Element]:
    """Yield M markers in the frames of their bodies, at their median distance from the plane.

    ``bodies`` are names in OpenSim, ``segment`` (M,) the index of each marker's body, and ``local`` (M, 2) its place.
    """
    names, depth = rename_markers(run), measure_depths(run)
    for label, body, position in zip(markers, segment, local, strict=True):
        yield marker_element(names.get(label, label), bodies[int(body)], [*position, depth.get(label, 0.0)])


def format_kinematics_setup(run: RunFolder, markers: Sequence[str]) -> bytes:
    """Return the set-up file of inverse kinematics, with equal weights for ``markers``, the markers of the chain."""
    names, planar = rename_markers(run), run.long("planar.parquet")
    assert planar is not None
    tasks = [element("IKMarkerTask", name=names.get(label, label), weight="1") for label in markers]
    return format_document(
        "InverseKinematicsTool",
        run.name,
        model_file=run.name + MODEL,
        IKTaskSet=[element("objects", *tasks)],
        marker_file=run.name + MEASURED_MARKERS,
        accuracy=_ACCURACY,
        time_range=[float(planar.time[0]), float(planar.time[-1])],  # without it, OpenSim stops after two seconds
        output_motion_file=f"{run.name}_opensim_ik.mot",
    )


def format_dynamics_setup(run: RunFolder, endings: tuple[str, str, str], loads: str | None = None) -> bytes:
    """Return the set-up file of inverse dynamics.

    ``endings`` are those of the files of the model, the coordinates and OpenSim's output, ``loads`` that of the loads.
    """
    model, coordinates, forces = (run.name + ending for ending in endings)
    external = {} if loads is None else {"external_loads_file": run.name + loads}
    files = {"model_file": model, "coordinates_file": coordinates, "output_gen_force_file": forces}
    return format_document("InverseDynamicsTool", run.name, **files, **external)


def _widen(known: FloatArray | None = None) -> tuple[float, float]:
    """Return a range, rad, that contains ±2π and the values ``known`` (T,)."""
    if known is None or not len(known):
        return -LEAST_RANGE, LEAST_RANGE
    return min(-LEAST_RANGE, float(known.min())), max(LEAST_RANGE, float(known.max()))


# In space.


@dataclass(frozen=True)
class ModelJoint:
    """One joint of the model with d coordinates at T times."""

    name: str
    element: str  # FreeJoint, BallJoint, PinJoint or CustomJoint
    parent: str  # name of the parent body; /ground for the ground
    child: str  # name of the child body
    at: FloatArray  # (3,) centre in the parent's frame, m
    parent_rotation: FloatArray  # (3, 3) frame of the joint on the parent
    child_rotation: FloatArray  # (3, 3) frame of the joint on the child
    coordinates: tuple[str, ...]  # d names
    values: FloatArray  # (T, d) coordinates over time, rad or m; NaN where unknown
    axes: tuple[FloatArray, ...] = ()  # d axes (3,) of a CustomJoint
    slides: bool = False  # the axes of a CustomJoint are directions of translation


def name_girdles(skeleton: SpatialSkeleton) -> tuple[str, ...]:
    """Return the name of the girdle of each joint, n in all; an empty text for a joint without a glide."""
    glides = [bool(np.any(joint.glide)) for joint in skeleton.chain.joints]
    return tuple(f"{name}_girdle" if has else "" for name, has in zip(opensim_joints(skeleton), glides, strict=True))


def model_joints(skeleton: SpatialSkeleton, poses: MeasuredPoses) -> list[ModelJoint]:
    """Return the joints of the model, parents first."""
    segments, girdles, still = opensim_bodies(skeleton.segments), name_girdles(skeleton), np.eye(3)
    mean = _mean_rotation(poses.rotation[:, 0])
    values = np.column_stack([euler_angles(mean.T @ poses.rotation[:, 0]), poses.origin[:, 0] @ mean])
    names = tuple(f"{BASE}_{each}" for each in ("rx", "ry", "rz", "tx", "ty", "tz"))
    joints = [ModelJoint(BASE, "FreeJoint", "/ground", segments[0], np.zeros(3), mean, still, names, values)]
    for k, (name, joint) in enumerate(zip(opensim_joints(skeleton), skeleton.chain.joints, strict=True)):
        rotation = poses.compute_rotation(joint.parent, k + 1)
        parent, child = segments[joint.parent], segments[k + 1]
        if girdles[k]:
            along = joint.glide / float(np.linalg.norm(joint.glide))
            shift = ((joint.origin(rotation) - joint.centre) @ along)[:, None]
            ends, names = (parent, girdles[k], np.zeros(3)), (f"{name}_glide_shift",)
            glide = ModelJoint(f"{name}_glide", "CustomJoint", *ends, still, still, names, shift, (along,), slides=True)
            joints.append(glide)
            parent = girdles[k]
        ends = (parent, child, joint.centre)
        turned = rotation @ joint.offset.T
        if joint.kind == "ball":
            mean = _mean_rotation(rotation)
            names, values = tuple(f"{name}_{each}" for each in ("rx", "ry", "rz")), euler_angles(mean.T @ rotation)
            joints.append(ModelJoint(name, "BallJoint", *ends, mean, still, names, values))
        elif joint.kind == "two-axis":
            first, second = joint.first_axis, joint.offset @ joint.second_axis
            q1 = _angle(first, np.broadcast_to(second, turned.shape[:-1]), turned @ second)
            probe = so3.exp(np.pi / 2 * first) @ second
            rest = np.swapaxes(so3.exp(q1[:, None] * first), -1, -2) @ turned
            q2 = _angle(second, np.broadcast_to(probe, turned.shape[:-1]), rest @ probe)
            names, values = (f"{name}_angle_1", f"{name}_angle_2"), _unwrap(np.column_stack([q1, q2]))
            axes = (first, second)
            joints.append(ModelJoint(name, "CustomJoint", *ends, still, joint.offset.T, names, values, axes))
        else:
            axis = joint.first_axis
            across = np.cross(axis, still[int(np.abs(axis).argmin())])
            across /= np.linalg.norm(across)
            own = np.column_stack([across, np.cross(axis, across), axis])
            values = _unwrap(_angle(axis, np.broadcast_to(across, turned.shape[:-1]), turned @ across)[:, None])
            names = (f"{name}_angle",)
            joints.append(ModelJoint(name, "PinJoint", *ends, own, joint.offset.T @ own, names, values))
    return joints


def _angle(axis: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the angles (T,), rad, about ``axis`` (3,) from directions ``before`` (T, 3) to directions ``after``."""
    sine = np.einsum("i,ti->t", axis, np.cross(before, after))
    along = np.einsum("i,ti->t", axis, before) * np.einsum("i,ti->t", axis, after)
    return np.asarray(np.arctan2(sine, np.einsum("ti,ti->t", before, after) - along))


def _mean_rotation(rotations: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) nearest to the mean of the known rotations (T, 3, 3), or the identity without any."""
    known = rotations[np.isfinite(rotations).all(axis=(1, 2))]
    if not len(known):
        return np.eye(3)
    left, _, right = np.linalg.svd(known.mean(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def euler_angles(rotations: FloatArray) -> FloatArray:
    """Return the angles (T, 3), rad, of rotations (T, 3, 3) as in OpenSim: about the body's x, then y, then z axis.

    The angles have no jumps by 2π over time.

    >>> turned = so3.exp(np.array([[0.3, 0.0, 0.0]])) @ so3.exp(np.array([[0.0, 0.0, -0.2]]))
    >>> euler_angles(turned).round(6)
    array([[ 0.3,  0. , -0.2]])
    """
    R = rotations
    x = np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    y = np.arcsin(np.clip(R[..., 0, 2], -1.0, 1.0))
    z = np.arctan2(-R[..., 0, 1], R[..., 0, 0])
    return _unwrap(np.stack([x, y, z], axis=-1))


def _unwrap(angles: FloatArray) -> FloatArray:
    """Return angles (T, d), rad, without jumps by 2π, also across gaps."""
    out = angles.copy()
    for column in out.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return out


def read_model_parts(run: RunFolder) -> tuple[SpatialSkeleton, MeasuredPoses] | str:
    """Return the chain and the poses of its segments, or a text with the reason why there can be no model."""
    tree, table = run.tree("chain.h5"), run.table("poses.parquet")
    if tree is None or table is None:
        return run.why_missing("chain.h5" if tree is None else "poses.parquet")
    skeleton = SpatialSkeleton(tree)
    unknown = [name for name, joint in zip(skeleton.joints, skeleton.chain.joints, strict=True) if not joint.known]
    if unknown:
        return f"the motion does not determine the centre of: {', '.join(unknown)}"
    return skeleton, MeasuredPoses(table)


def export_spatial_model(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>.osim`` and ``<trial>_ik.xml`` of a trial in space; only a note if there can be no model."""
    parts = read_model_parts(run)
    if isinstance(parts, str):
        out.note(f"osim: no model: {parts}")
        return
    skeleton, chain = parts[0], parts[0].chain
    segments, girdles = opensim_bodies(skeleton.segments), [name for name in name_girdles(skeleton) if name]
    inertias, source = _read_spatial_inertia(run, len(segments))
    light: BodyInertia = (LEAST_MASS, (0.0,) * 3, (0.0,) * 6)
    bodies = [*zip(segments, inertias, strict=True), *((name, light) for name in girdles)]
    joints = []
    for joint in model_joints(*parts):
        parent = joint.parent if joint.parent.startswith("/") else f"/bodyset/{joint.parent}"
        angles = [euler_angles(each[None])[0].tolist() for each in (joint.parent_rotation, joint.child_rotation)]
        frames = [
            offset_frame(f"{joint.name}_on_parent", parent, joint.at.tolist(), angles[0]),
            offset_frame(f"{joint.name}_on_child", f"/bodyset/{joint.child}", [0.0] * 3, angles[1]),
        ]
        # The default of a coordinate is its first known value, and its range contains all values.
        coordinates = []
        for name, values in zip(joint.coordinates, joint.values.T, strict=True):
            known = values[np.isfinite(values)]
            low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
            span = (min(low - 1.0, -LEAST_RANGE), max(high + 1.0, LEAST_RANGE))
            coordinates.append(coordinate_element(name, float(known[0]) if len(known) else 0.0, span))
        content: dict[str, Any] = {
            "socket_parent_frame": f"{joint.name}_on_parent",
            "socket_child_frame": f"{joint.name}_on_child",
            "coordinates": coordinates,
            "frames": frames,
        }
        if joint.element == "CustomJoint":
            rotations, translations = ((), joint.axes) if joint.slides else (joint.axes, ())
            rows = [*_axis_rows("rotation", joint, rotations), *_axis_rows("translation", joint, translations)]
            content["SpatialTransform"] = rows
        joints.append(element(joint.element, name=joint.name, **content))
    # A marker that moves with a glide is on the girdle's body.
    labels = rename_markers(run)
    markers = [
        marker_element(
            labels.get(label, label), girdles[0] if glides and girdles else segments[int(segment)], local.tolist()
        )
        for label, segment, local, glides in zip(
            skeleton.markers, chain.segment, chain.local, chain.on_glide, strict=True
        )
    ]
    out.files[run.name + MODEL] = format_model(
        run,
        "the frame of the trial",
        [f"Inertial parameters: {source}."],
        bodies=(body_element(name, body) for name, body in bodies),
        joints=joints,
        markers=markers,
    )
    out.files[f"{run.name}_ik.xml"] = format_kinematics_setup(run, skeleton.markers)
    out.note(f"osim: inertial parameters: {source}")
    if girdles:
        out.note("osim: the glide of a joint is a separate coordinate, which does not depend on the elevation")


def _axis_rows(kind: str, joint: ModelJoint, axes: Sequence[FloatArray]) -> Iterator[Element]:
    """Yield three axes of a CustomJoint: first those of the coordinates, then fixed axes at right angles to them."""
    fixed = np.linalg.svd(np.stack(axes), full_matrices=True)[2][len(axes) :] if axes else np.eye(3)
    for k in range(3):
        name = f"{kind}{k + 1}"
        if k < len(axes):
            function = element("LinearFunction", name="function", coefficients="1 0")
            coordinate, axis = joint.coordinates[k], axes[k]
        else:
            function, coordinate, axis = element("Constant", name="function", value="0"), "", fixed[k - len(axes)]
        parts = (element("coordinates", text=coordinate), element("axis", text=format_numbers(axis.tolist())))
        yield element("TransformAxis", *parts, function, name=name)
