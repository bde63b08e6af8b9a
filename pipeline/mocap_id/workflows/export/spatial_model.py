"""The recovered chain in space as an OpenSim model with bodies, joints and markers; its base moves freely.

OpenSim's ground is the frame of the trial (y up).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.store.spatial_views import SegmentPoses, SpatialSkeleton
from mocap_id.workflows.export.files import MODEL, ExportFiles, name_bodies
from mocap_id.workflows.export.inertia import LEAST_MASS, BodyInertia, ModelInertia, read_spatial_inertia
from mocap_id.workflows.export.markers import name_markers
from mocap_id.workflows.export.model import LEAST_RANGE, format_kinematics_setup, format_model
from mocap_id.workflows.export.spatial_joints import ModelJoint, euler_angles, model_joints, name_girdles
from mocap_id.workflows.export.xml import (
    Element,
    body_element,
    coordinate_element,
    element,
    format_numbers,
    marker_element,
    offset_frame,
)
from mocap_id.workflows.run_folder import RunFolder


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
        run.name + MODEL: _format_chain(run, skeleton, model_joints(skeleton, poses), inertia),
        f"{run.name}_ik.xml": format_kinematics_setup(run, skeleton.markers),
    }
    notes = [f"osim: inertial parameters: {inertia.source}"]
    if any(name_girdles(skeleton)):
        notes.append("osim: the glide of a joint is a separate coordinate, which does not depend on the elevation")
    return ExportFiles(files, tuple(notes))


def _format_chain(run: RunFolder, skeleton: SpatialSkeleton, joints: list[ModelJoint], inertia: ModelInertia) -> bytes:
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
