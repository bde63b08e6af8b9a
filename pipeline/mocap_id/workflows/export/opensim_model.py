"""The recovered chain as an OpenSim model, in the plane and in space, with set-up files of OpenSim's tools.

OpenSim's ground is the plane frame: x along the motion, y up, z out of the plane. The base segment is fixed to it by a
planar joint, whose three coordinates are locked at zero. For these coordinates, inverse dynamics gives the required
ground wrench minus the external loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.store.views import JointStates, MeasuredPoses, Skeleton, SpatialSkeleton
from mocap_id.workflows.export.files import (
    ANGLES,
    BASE,
    LOADS,
    MEASURED_MARKERS,
    MODEL,
    ExportFiles,
    name_coordinates,
    opensim_bodies,
    opensim_joints,
)
from mocap_id.workflows.export.markers import measure_depths, rename_markers
from mocap_id.workflows.export.opensim_parts import (
    LEAST_MASS,
    BodyInertia,
    Element,
    body_element,
    comment,
    coordinate_element,
    element,
    format_document,
    format_numbers,
    marker_element,
    offset_frame,
    read_planar_inertia,
    read_spatial_inertia,
)
from mocap_id.workflows.run_folder import RunFolder

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
    skeleton = Skeleton.from_tree(tree)
    segments, inertia = opensim_bodies(skeleton.segments), read_planar_inertia(run, len(skeleton.segments))
    # Bodies; a cylinder along the y axis of each, from its joint to the next joint or to the tip, shows where it is.
    lengths = np.linalg.norm(np.vstack([skeleton.centres, skeleton.tip]), axis=1)
    bodies = [body_element(segments[0], inertia.bodies[0])]
    for name, body, length in zip(segments[1:], inertia.bodies[1:], lengths[1:], strict=True):
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
        known = angles[np.isfinite(angles[:, j]), j]
        pin = element(
            "PinJoint",
            name=joint,
            socket_parent_frame=frame,
            socket_child_frame=f"/bodyset/{segments[j + 1]}",
            coordinates=[coordinate_element(coordinate, known[0] if len(known) else 0.0, _widen(known))],
            frames=[offset_frame(frame, f"/bodyset/{parent}", [*skeleton.centres[j], 0.0])],
        )
        joints.append(pin)
    comments = (
        f"Inertial parameters: {inertia.source}.",
        "Ixx and Iyy do not affect planar motion and are unknown: they are set to Izz. "
        "Centres of mass lie in the plane z = 0.",
    )
    markers = place_markers(run, segments, skeleton.markers, skeleton.marker_segment, skeleton.local)
    out.files[run.name + MODEL] = format_model(
        run, "the plane frame", comments, bodies=bodies, joints=joints, markers=markers
    )
    out.files[f"{run.name}_ik.xml"] = format_kinematics_setup(run, skeleton.markers)
    if states is not None and inertia.known:
        table = run.table("wrench.parquet")
        has_forces = table is not None and bool(np.isfinite(table["Fy"]).any())
        setup = format_dynamics_setup(run, (MODEL, ANGLES, "_opensim_id.sto"), LOADS if has_forces else None)
        out.files[f"{run.name}_id.xml"] = setup
    out.note(f"osim: inertial parameters: {inertia.source}")


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
        *(comment(text) for text in (made, *comments)),
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=format_numbers([0.0, -read_gravity(run), 0.0])),
        *(element(tag, name=tag.lower(), objects=list(objects)) for tag, objects in sets.items()),
    )


def read_gravity(run: RunFolder) -> float:
    """Return the gravity that the identification used, m/s²; 9.81 if there is no identification."""
    about = run.provenance.get("dynamics.h5")
    settings = {} if about is None else about.origin.parameters.get("identify-dim") or {}
    return float(settings.get("gravity", 9.81))


def planar_joint(name: str, body: str, coordinates: Sequence[Element]) -> Element:
    """Return a planar joint between ground and body; its coordinates are angle, x and y of the body's frame."""
    sockets = {"socket_parent_frame": "/ground", "socket_child_frame": f"/bodyset/{body}"}
    return element("PlanarJoint", name=name, **sockets, coordinates=coordinates)


def place_markers(
    run: RunFolder, bodies: Sequence[str], markers: Sequence[str], segment: IntArray, local: FloatArray
) -> Iterator[Element]:
    """Yield markers in the frames of their bodies, at their median distance from the plane.

    ``bodies`` are names in OpenSim, and ``markers`` are M names in the recording. ``segment`` (M,) is the index of each
    marker's body, and ``local`` (M, 2) its position in the body's frame, m.
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

    ``endings`` are the endings of the file names of the model, the coordinates and OpenSim's output. ``loads`` is that
    of the external loads; None if there are none.
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


def read_model_parts(run: RunFolder) -> tuple[SpatialSkeleton, MeasuredPoses] | str:
    """Return the chain and the poses of its segments, or a text with the reason why there can be no model."""
    tree, table = run.tree("chain.h5"), run.table("poses.parquet")
    if tree is None or table is None:
        return run.why_missing("chain.h5" if tree is None else "poses.parquet")
    skeleton = SpatialSkeleton.from_tree(tree)
    unknown = [name for name, joint in zip(skeleton.joints, skeleton.chain.joints, strict=True) if not joint.known]
    if unknown:
        return f"the motion does not determine the centre of: {', '.join(unknown)}"
    return skeleton, MeasuredPoses.from_table(table)


def export_spatial_model(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>.osim`` and ``<trial>_ik.xml`` of a trial in space; only a note if there can be no model."""
    parts = read_model_parts(run)
    if isinstance(parts, str):
        out.note(f"osim: no model: {parts}")
        return
    skeleton, chain = parts[0], parts[0].chain
    segments, girdles = opensim_bodies(skeleton.segments), [name for name in name_girdles(skeleton) if name]
    inertia = read_spatial_inertia(run, len(segments))
    light = BodyInertia(LEAST_MASS, (0.0,) * 3, (0.0,) * 6)
    bodies = [*zip(segments, inertia.bodies, strict=True), *((name, light) for name in girdles)]
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
        [f"Inertial parameters: {inertia.source}."],
        bodies=(body_element(name, body) for name, body in bodies),
        joints=map(_joint_element, model_joints(*parts)),
        markers=markers,
    )
    out.files[f"{run.name}_ik.xml"] = format_kinematics_setup(run, skeleton.markers)
    out.note(f"osim: inertial parameters: {inertia.source}")
    if girdles:
        out.note("osim: the glide of a joint is a separate coordinate, which does not depend on the elevation")


def _joint_element(joint: ModelJoint) -> Element:
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
    return element(joint.element, name=joint.name, **content)


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
