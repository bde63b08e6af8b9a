"""The recovered chain as an OpenSim model (bodies, pin joints about z, markers), and set-up files of OpenSim's tools.

OpenSim's ground is the plane frame: x along the motion, y up, z out of the plane. The base segment is fixed to it by a
planar joint, whose three coordinates are locked at zero. For these coordinates, inverse dynamics gives the required
ground wrench minus the external loads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.store.views import JointStates, Skeleton
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
from mocap_id.workflows.export.inertia import ModelInertia, read_planar_inertia
from mocap_id.workflows.export.markers import measure_depths, name_markers
from mocap_id.workflows.export.xml import (
    Element,
    body_element,
    comment,
    coordinate_element,
    element,
    format_document,
    format_numbers,
    marker_element,
    object_set,
    offset_frame,
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
