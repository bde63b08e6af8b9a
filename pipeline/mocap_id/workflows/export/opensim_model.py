"""The recovered chain as an OpenSim model, in the plane and in space, with set-up files of OpenSim's tools.

OpenSim's ground is the plane frame: x along the motion, y up, z out of the plane. The base segment is fixed to it by a
planar joint, whose three coordinates are locked at zero. For these coordinates, inverse dynamics gives the required
ground wrench minus the external loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.store.views import JointStates, SegmentPoses, Skeleton, SpatialSkeleton
from mocap_id.workflows.export.files import (
    ANGLES,
    BASE,
    LOADS,
    MEASURED_MARKERS,
    MODEL,
    ExportFiles,
    name_bodies,
    name_coordinates,
    name_joints,
)
from mocap_id.workflows.export.markers import measure_depths, name_markers
from mocap_id.workflows.export.opensim_parts import (
    LEAST_MASS,
    BodyInertia,
    Element,
    ModelInertia,
    body_element,
    comment,
    coordinate_element,
    element,
    format_document,
    format_numbers,
    marker_element,
    object_set,
    offset_frame,
    read_planar_inertia,
    read_spatial_inertia,
)
from mocap_id.workflows.run_folder import RunFolder

LEAST_RANGE = 2 * np.pi  # every coordinate of a model can change at least by this in both directions, rad or m

_RADIUS = 0.02  # m, of the cylinder that represents a segment
_ACCURACY = "1e-8"  # with its default of 1e-5, OpenSim ends 0.2° rms, at worst 0.8°, from the least-squares solution


def export_model(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.osim``, ``<trial>_ik.xml`` and ``<trial>_id.xml`` of a trial in the plane.

    The last file is omitted if the states or the inertial parameters are unknown.
    """
    tree = run.tree("chain.h5")
    if tree is None:
        return ExportFiles(notes=(f"osim: no model: {run.why_missing('chain.h5')}",))
    skeleton = Skeleton.from_tree(tree)
    inertia = read_planar_inertia(run, len(skeleton.segments))
    files = {
        run.name + MODEL: _format_chain(run, skeleton, inertia),
        f"{run.name}_ik.xml": format_kinematics_setup(run, skeleton.markers),
    }
    if run.table("states.parquet") is not None and inertia.known:
        table = run.table("wrench.parquet")
        has_forces = table is not None and bool(np.isfinite(table["Fy"]).any())
        setup = format_dynamics_setup(run, (MODEL, ANGLES, "_opensim_id.sto"), LOADS if has_forces else None)
        files[f"{run.name}_id.xml"] = setup
    return ExportFiles(files, (f"osim: inertial parameters: {inertia.source}",))


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
    children = [
        *(comment(text) for text in (made, *comments)),
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=format_numbers([0.0, -read_gravity(run), 0.0])),
        object_set("BodySet", bodies),
        object_set("JointSet", joints),
        object_set("MarkerSet", markers),
    ]
    return format_document("Model", run.name, children)


def read_gravity(run: RunFolder) -> float:
    """Return the gravity that the identification used, m/s²; 9.81 if there is no identification."""
    about = run.provenance.get("dynamics.h5")
    settings = {} if about is None else about.origin.parameters.get("identify-dim") or {}
    return float(settings.get("gravity", 9.81))


def planar_joint(name: str, body: str, coordinates: Iterable[Element]) -> Element:
    """Return a planar joint between ground and body; its coordinates are angle, x and y of the body's frame."""
    children = [
        element("socket_parent_frame", text="/ground"),
        element("socket_child_frame", text=f"/bodyset/{body}"),
        element("coordinates", children=coordinates),
    ]
    return element("PlanarJoint", name=name, children=children)


def place_markers(
    run: RunFolder, bodies: Sequence[str], markers: Sequence[str], segment: IntArray, local: FloatArray
) -> Iterator[Element]:
    """Yield markers in the frames of their bodies, at their median distance from the plane.

    ``bodies`` are names in OpenSim, and ``markers`` are M names in the recording. ``segment`` (M,) is the index of each
    marker's body, and ``local`` (M, 2) its position in the body's frame, m.
    """
    names, depth = name_markers(run), measure_depths(run)
    for label, body, position in zip(markers, segment, local, strict=True):
        yield marker_element(names.get(label, label), bodies[int(body)], [*position, depth.get(label, 0.0)])


def format_kinematics_setup(run: RunFolder, markers: Sequence[str]) -> bytes:
    """Return the set-up file of inverse kinematics, with equal weights for ``markers``, the markers of the chain."""
    names, planar = name_markers(run), run.long("planar.parquet")
    assert planar is not None
    tasks = [
        element("IKMarkerTask", name=names.get(label, label), children=[element("weight", text="1")])
        for label in markers
    ]
    span = (float(planar.time[0]), float(planar.time[-1]))
    children = [
        element("model_file", text=run.name + MODEL),
        element("IKTaskSet", children=[element("objects", children=tasks)]),
        element("marker_file", text=run.name + MEASURED_MARKERS),
        element("accuracy", text=_ACCURACY),
        element("time_range", text=format_numbers(span)),  # without it, OpenSim stops after two seconds
        element("output_motion_file", text=f"{run.name}_opensim_ik.mot"),
    ]
    return format_document("InverseKinematicsTool", run.name, children)


def format_dynamics_setup(run: RunFolder, endings: tuple[str, str, str], loads: str | None = None) -> bytes:
    """Return the set-up file of inverse dynamics.

    ``endings`` are the endings of the file names of the model, the coordinates and OpenSim's output. ``loads`` is that
    of the external loads; None if there are none.
    """
    tags = ("model_file", "coordinates_file", "output_gen_force_file")
    children = [element(tag, text=run.name + ending) for tag, ending in zip(tags, endings, strict=True)]
    if loads is not None:
        children.append(element("external_loads_file", text=run.name + loads))
    return format_document("InverseDynamicsTool", run.name, children)


def _format_chain(run: RunFolder, skeleton: Skeleton, inertia: ModelInertia) -> bytes:
    names, lengths = name_bodies(skeleton.segments), np.linalg.norm(np.vstack([skeleton.centres, skeleton.tip]), axis=1)
    bodies = [
        body_element(name, body, [_cylinder(name, length)] if k else ())
        for k, (name, body, length) in enumerate(zip(names, inertia.bodies, lengths, strict=True))
    ]
    base = [coordinate_element(f"{BASE}_{each}", 0.0, _widen(), locked=True) for each in ("rz", "tx", "ty")]
    return format_model(
        run,
        "the plane frame",
        (
            f"Inertial parameters: {inertia.source}.",
            "Ixx and Iyy do not affect planar motion and are unknown: they are set to Izz. "
            "Centres of mass lie in the plane z = 0.",
        ),
        bodies=bodies,
        joints=(planar_joint(BASE, names[0], base), *_pin_joints(run, skeleton, names)),
        markers=place_markers(run, names, skeleton.markers, skeleton.marker_segment, skeleton.local),
    )


def _cylinder(body: str, length: float) -> Element:
    """Return a cylinder along a segment's y axis, from its joint to the next joint or to the tip."""
    half = length / 2
    cylinder = [
        element("socket_frame", text=".."),
        element("radius", text=format_numbers([_RADIUS])),
        element("half_height", text=format_numbers([half])),
    ]
    geometry = element("attached_geometry", children=[element("Cylinder", name="stick", children=cylinder)])
    return offset_frame(f"{body}_middle", "..", [0.0, half, 0.0], components=[geometry])


def _pin_joints(run: RunFolder, skeleton: Skeleton, bodies: Sequence[str]) -> Iterator[Element]:
    """Yield the pin joints about z; joint j moves segment j, and its centre is fixed in the parent segment's frame."""
    table = run.table("states.parquet")
    joints, coordinates = name_joints(skeleton), name_coordinates(skeleton)
    angles = np.zeros((0, len(joints))) if table is None else JointStates.from_table(table).angles
    for j, (joint, coordinate) in enumerate(zip(joints, coordinates, strict=True)):
        parent, frame = bodies[int(skeleton.parents[j])], f"{joint}_centre"
        known = angles[np.isfinite(angles[:, j]), j]
        first = known[0] if len(known) else 0.0
        children = [
            element("socket_parent_frame", text=frame),
            element("socket_child_frame", text=f"/bodyset/{bodies[j + 1]}"),
            element("coordinates", children=[coordinate_element(coordinate, first, _widen(known))]),
            element("frames", children=[offset_frame(frame, f"/bodyset/{parent}", [*skeleton.centres[j], 0.0])]),
        ]
        yield element("PinJoint", name=joint, children=children)


def _widen(known: FloatArray | None = None) -> tuple[float, float]:
    """Return a range, rad, that contains ±2π and the values ``known`` (T,)."""
    if known is None or not len(known):
        return -LEAST_RANGE, LEAST_RANGE
    return min(-LEAST_RANGE, float(known.min())), max(LEAST_RANGE, float(known.max()))


_IDENTITY = np.eye(3)


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
    return tuple(f"{name}_girdle" if has else "" for name, has in zip(name_joints(skeleton), glides, strict=True))


def model_joints(skeleton: SpatialSkeleton, poses: SegmentPoses) -> list[ModelJoint]:
    """Return the joints of the model, parents first."""
    segments, girdles = name_bodies(skeleton.segments), name_girdles(skeleton)
    joints = [_free(segments[0], poses)]
    for k, (name, joint) in enumerate(zip(name_joints(skeleton), skeleton.chain.joints, strict=True)):
        rotation = poses.compute_rotation(joint.parent, k + 1)
        parent, child = segments[joint.parent], segments[k + 1]
        if girdles[k]:
            joints.append(_glide(name, joint, rotation, (parent, girdles[k])))
            parent = girdles[k]
        make = {"ball": _ball, "two-axis": _two_axis, "hinge": _hinge}[joint.kind]
        joints.append(make(name, joint, rotation, (parent, child)))
    return joints


def _free(base: str, poses: SegmentPoses) -> ModelJoint:
    mean = _mean_rotation(poses.rotation[:, 0])
    angles = euler_angles(mean.T @ poses.rotation[:, 0])
    names = tuple(f"{BASE}_{each}" for each in ("rx", "ry", "rz", "tx", "ty", "tz"))
    values = np.column_stack([angles, poses.origin[:, 0] @ mean])
    return ModelJoint(BASE, "FreeJoint", "/ground", base, np.zeros(3), mean, _IDENTITY, names, values)


def _glide(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    size = float(np.linalg.norm(joint.glide))
    along = joint.glide / size
    values = ((joint.origin(rotation) - joint.centre) @ along)[:, None]
    return ModelJoint(
        f"{name}_glide", "CustomJoint", *bodies, np.zeros(3), _IDENTITY, _IDENTITY, (f"{name}_glide_shift",), values,
        (along,), slides=True,
    )  # fmt: skip


def _ball(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    mean = _mean_rotation(rotation)
    names = tuple(f"{name}_{each}" for each in ("rx", "ry", "rz"))
    values = euler_angles(mean.T @ rotation)
    return ModelJoint(name, "BallJoint", *bodies, joint.centre, mean, _IDENTITY, names, values)


def _two_axis(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    first, second = joint.first_axis, joint.offset @ joint.second_axis
    turned = rotation @ joint.offset.T
    q1 = _angle(first, np.broadcast_to(second, turned.shape[:-1]), turned @ second)
    probe = so3.exp(np.pi / 2 * first) @ second
    rest = np.swapaxes(so3.exp(q1[:, None] * first), -1, -2) @ turned
    q2 = _angle(second, np.broadcast_to(probe, turned.shape[:-1]), rest @ probe)
    values = _unwrap(np.column_stack([q1, q2]))
    names = (f"{name}_angle_1", f"{name}_angle_2")
    return ModelJoint(
        name, "CustomJoint", *bodies, joint.centre, _IDENTITY, joint.offset.T, names, values, (first, second)
    )


def _hinge(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    axis = joint.first_axis
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= np.linalg.norm(across)
    own = np.column_stack([across, np.cross(axis, across), axis])
    turned = rotation @ joint.offset.T
    values = _unwrap(_angle(axis, np.broadcast_to(across, turned.shape[:-1]), turned @ across)[:, None])
    return ModelJoint(name, "PinJoint", *bodies, joint.centre, own, joint.offset.T @ own, (f"{name}_angle",), values)


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

    Examples
    --------
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


def list_coordinates(joints: list[ModelJoint]) -> Iterator[tuple[str, FloatArray, bool]]:
    """Yield the name of each coordinate of a model, its values (T,), and whether it is an angle."""
    for joint in joints:
        for k, name in enumerate(joint.coordinates):
            lengths = joint.slides or (joint.element == "FreeJoint" and k >= 3)
            yield name, joint.values[:, k], not lengths


def read_model_parts(run: RunFolder) -> tuple[SpatialSkeleton, SegmentPoses] | str:
    """Return the chain and the poses of its segments, or a text with the reason why there can be no model."""
    tree, table = run.tree("chain.h5"), run.table("poses.parquet")
    if tree is None or table is None:
        return run.why_missing("chain.h5" if tree is None else "poses.parquet")
    skeleton = SpatialSkeleton.from_tree(tree)
    unknown = [name for name, joint in zip(skeleton.joints, skeleton.chain.joints, strict=True) if not joint.known]
    if unknown:
        return f"the motion does not determine the centre of: {', '.join(unknown)}"
    return skeleton, SegmentPoses.from_table(table)


def export_spatial_model(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.osim`` and ``<trial>_ik.xml`` of a trial in space; only a note if there can be no model."""
    parts = read_model_parts(run)
    if isinstance(parts, str):
        return ExportFiles(notes=(f"osim: no model: {parts}",))
    skeleton, poses = parts
    inertia = read_spatial_inertia(run, len(skeleton.segments))
    files = {
        run.name + MODEL: _format_spatial_chain(run, skeleton, model_joints(skeleton, poses), inertia),
        f"{run.name}_ik.xml": format_kinematics_setup(run, skeleton.markers),
    }
    notes = [f"osim: inertial parameters: {inertia.source}"]
    if any(name_girdles(skeleton)):
        notes.append("osim: the glide of a joint is a separate coordinate, which does not depend on the elevation")
    return ExportFiles(files, tuple(notes))


def _format_spatial_chain(
    run: RunFolder, skeleton: SpatialSkeleton, joints: list[ModelJoint], inertia: ModelInertia
) -> bytes:
    girdles = [name for name in name_girdles(skeleton) if name]
    light = BodyInertia(LEAST_MASS, (0.0,) * 3, (0.0,) * 6)
    bodies = [*zip(name_bodies(skeleton.segments), inertia.bodies, strict=True), *((name, light) for name in girdles)]
    return format_model(
        run,
        "the frame of the trial",
        [f"Inertial parameters: {inertia.source}."],
        bodies=(body_element(name, each) for name, each in bodies),
        joints=map(_joint, joints),
        markers=_markers(run, skeleton),
    )


def _joint(joint: ModelJoint) -> Element:
    parent = joint.parent if joint.parent.startswith("/") else f"/bodyset/{joint.parent}"
    angles = [euler_angles(each[None])[0].tolist() for each in (joint.parent_rotation, joint.child_rotation)]
    frames = [
        offset_frame(f"{joint.name}_on_parent", parent, joint.at.tolist(), angles[0]),
        offset_frame(f"{joint.name}_on_child", f"/bodyset/{joint.child}", [0.0] * 3, angles[1]),
    ]
    children = [
        element("socket_parent_frame", text=f"{joint.name}_on_parent"),
        element("socket_child_frame", text=f"{joint.name}_on_child"),
        element("coordinates", children=_coordinates(joint)),
        element("frames", children=frames),
    ]
    if joint.element == "CustomJoint":
        rotations, translations = ((), joint.axes) if joint.slides else (joint.axes, ())
        rows = [*_axis_rows("rotation", joint, rotations), *_axis_rows("translation", joint, translations)]
        children.append(element("SpatialTransform", children=rows))
    return element(joint.element, name=joint.name, children=children)


def _coordinates(joint: ModelJoint) -> Iterator[Element]:
    """Yield each coordinate of a joint, with its first known value as default and a range that contains all values."""
    for name, values in zip(joint.coordinates, joint.values.T, strict=True):
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        first = float(known[0]) if len(known) else 0.0
        yield coordinate_element(name, first, (min(low - 1.0, -LEAST_RANGE), max(high + 1.0, LEAST_RANGE)))


def _axis_rows(kind: str, joint: ModelJoint, axes: Sequence[FloatArray]) -> Iterator[Element]:
    """Yield three axes of a CustomJoint: first those of the coordinates, then fixed axes at right angles to them."""
    fixed = np.linalg.svd(np.stack(axes), full_matrices=True)[2][len(axes) :] if axes else np.eye(3)
    for k in range(3):
        moves = k < len(axes)
        kind_of_function, parameter, value = (
            ("LinearFunction", "coefficients", "1 0") if moves else ("Constant", "value", "0")
        )
        children = [
            element("coordinates", text=joint.coordinates[k] if moves else ""),
            element("axis", text=format_numbers((axes[k] if moves else fixed[k - len(axes)]).tolist())),
            element(kind_of_function, name="function", children=[element(parameter, text=value)]),
        ]
        yield element("TransformAxis", name=f"{kind}{k + 1}", children=children)


def _markers(run: RunFolder, skeleton: SpatialSkeleton) -> Iterator[Element]:
    """Yield the markers of the chain; a marker that moves with a glide is on the girdle's body."""
    names, bodies, chain = name_markers(run), name_bodies(skeleton.segments), skeleton.chain
    girdle = next((name for name in name_girdles(skeleton) if name), "")
    rows = zip(skeleton.markers, chain.segment, chain.local, chain.on_glide, strict=True)
    for label, segment, local, on_glide in rows:
        body = girdle if on_glide and girdle else bodies[int(segment)]
        yield marker_element(names.get(label, label), body, local.tolist())
