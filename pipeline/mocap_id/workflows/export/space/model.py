"""The recovered chain in space as an OpenSim model: bodies, joints, markers and landmarks on a free base.

OpenSim's ground is the frame of the trial: y up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import LINK_PARAMETERS
from mocap_id.geometry.so3 import hat
from mocap_id.store.spatial_views import SegmentPoses, SpatialSkeleton
from mocap_id.workflows.export.files import ExportFiles, model_file
from mocap_id.workflows.export.inertia import LEAST_MASS
from mocap_id.workflows.export.markers import marker_labels
from mocap_id.workflows.export.model import coordinate_element, gravity, object_set
from mocap_id.workflows.export.names import legal
from mocap_id.workflows.export.opensim import kinematics_setup
from mocap_id.workflows.export.space.joints import ModelBodies, ModelJoint, euler_angles, model_joints
from mocap_id.workflows.export.xml import Element, body_element, document, element, numbers, offset_frame, remark
from mocap_id.workflows.run_folder import RunFolder

_PLACEHOLDER = "1 kg and 0.01 kg·m² a body"
_REACH = 2 * np.pi  # rad or m, at least, of every coordinate


@dataclass(frozen=True)
class SpatialInertia:
    """Inertia of a body about its centre of mass.

    Parameters
    ----------
    mass : float
        kg.
    centre : (3,) array
        Centre of mass in the segment's frame, m.
    inertia : (6,) array
        Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, kg·m².
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray


def parts_of_model(run: RunFolder) -> tuple[SpatialSkeleton, SegmentPoses] | str:
    """Return chain and poses for a model, or why there is none."""
    tree, table = run.tree("chain.h5"), run.table("poses.parquet")
    if tree is None or table is None:
        return run.why_missing("chain.h5" if tree is None else "poses.parquet")
    skeleton = SpatialSkeleton.from_tree(tree)
    unknown = [name for name, joint in zip(skeleton.joints, skeleton.chain.joints, strict=True) if not joint.known]
    if unknown:
        return f"the motion does not show the centre of: {', '.join(unknown)}"
    return skeleton, SegmentPoses.from_table(table)


def opensim(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.osim`` and ``<trial>_ik.xml``."""
    found = parts_of_model(run)
    if isinstance(found, str):
        return ExportFiles(notes=(f"osim: no model: {found}",))
    skeleton, poses = found
    inertia, source = inertias(run, len(skeleton.segments))
    files = {
        model_file(run): _model(run, skeleton, model_joints(skeleton, poses), inertia, source),
        f"{run.name}_ik.xml": kinematics_setup(run, skeleton.markers),
    }
    notes = [f"osim: inertial parameters: {source}"]
    if any(ModelBodies.of(skeleton).girdles):
        notes.append(
            "osim: the glide of a joint is a coordinate of its own, which OpenSim does not tie to the elevation"
        )
    return ExportFiles(files, tuple(notes))


def _model(
    run: RunFolder, skeleton: SpatialSkeleton, joints: list[ModelJoint], inertia: list[SpatialInertia], source: str
) -> bytes:
    bodies = ModelBodies.of(skeleton)
    girdles = [name for name in bodies.girdles if name]
    light = SpatialInertia(LEAST_MASS, np.zeros(3), np.full(6, 0.0))
    named = [*zip(bodies.segments, inertia, strict=True), *((name, light) for name in girdles)]
    children = [
        remark(f"Made by mocap-id {__version__} from the trial {run.name}. Ground is the frame of the trial."),
        remark(f"Inertial parameters: {source}."),
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=numbers([0.0, -gravity(run), 0.0])),
        object_set(
            "BodySet",
            (body_element(name, each.mass, each.centre.tolist(), each.inertia.tolist()) for name, each in named),
        ),
        object_set("JointSet", map(_joint, joints)),
        object_set("MarkerSet", _markers(run, skeleton, bodies)),
    ]
    return document(element("Model", name=legal([run.name])[run.name], children=children))


def _joint(joint: ModelJoint) -> Element:
    parent = joint.parent if joint.parent.startswith("/") else f"/bodyset/{joint.parent}"
    frames = [
        offset_frame(f"{joint.name}_on_parent", parent, joint.at.tolist(), _angles(joint.parent_rotation)),
        offset_frame(f"{joint.name}_on_child", f"/bodyset/{joint.child}", [0.0] * 3, _angles(joint.child_rotation)),
    ]
    children = [
        element("socket_parent_frame", text=f"{joint.name}_on_parent"),
        element("socket_child_frame", text=f"{joint.name}_on_child"),
        element("coordinates", children=_coordinates(joint)),
        element("frames", children=frames),
    ]
    if joint.element == "CustomJoint":
        children.append(_transform(joint))
    return element(joint.element, name=joint.name, children=children)


def _coordinates(joint: ModelJoint) -> Iterator[Element]:
    """Yield the coordinates with their first known value, and a range that contains all of them."""
    for name, values in zip(joint.coordinates, joint.values.T, strict=True):
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        first = float(known[0]) if len(known) else 0.0
        yield coordinate_element(name, first, (min(low - 1.0, -_REACH), max(high + 1.0, _REACH)))


def _angles(rotation: FloatArray) -> list[float]:
    return list(euler_angles(rotation[None])[0].tolist())


def _transform(joint: ModelJoint) -> Element:
    """Return the spatial transform of a custom joint: its axes first, then axes that do not move."""
    turning, sliding = ((), joint.axes) if joint.slides else (joint.axes, ())
    rows = [*_rows("rotation", joint, turning), *_rows("translation", joint, sliding)]
    return element("SpatialTransform", children=rows)


def _rows(kind: str, joint: ModelJoint, axes: Sequence[FloatArray]) -> Iterator[Element]:
    """Yield the three rows of one kind; all rotation axes must be independent, also of a rotation that is fixed."""
    spare = _spare(axes)
    for k in range(3):
        moves = k < len(axes)
        function = element("LinearFunction", name="function", children=[element("coefficients", text="1 0")])
        still = element("Constant", name="function", children=[element("value", text="0")])
        yield element(
            "TransformAxis",
            name=f"{kind}{k + 1}",
            children=[
                element("coordinates", text=joint.coordinates[k] if moves else ""),
                element("axis", text=numbers((axes[k] if moves else spare[k - len(axes)]).tolist())),
                function if moves else still,
            ],
        )


def _spare(axes: Sequence[FloatArray]) -> FloatArray:
    """Return unit vectors across the axes, (3 - d, 3)."""
    if not axes:
        return np.eye(3)
    return np.asarray(np.linalg.svd(np.stack(axes), full_matrices=True)[2][len(axes) :])


def _markers(run: RunFolder, skeleton: SpatialSkeleton, bodies: ModelBodies) -> Iterator[Element]:
    """Yield the markers of the chain; those that move with a glide are on its body."""
    labels, chain = marker_labels(run), skeleton.chain
    girdle = next((name for name in bodies.girdles if name), "")
    rows = zip(skeleton.markers, chain.segment, chain.local, chain.on_glide, strict=True)
    for label, segment, local, on_glide in rows:
        body = girdle if on_glide and girdle else bodies.segments[int(segment)]
        yield element(
            "Marker",
            name=labels.get(label, label),
            children=[
                element("socket_parent_frame", text=f"/bodyset/{body}"),
                element("location", text=numbers(local.tolist())),
            ],
        )


def inertias(run: RunFolder, count: int) -> tuple[list[SpatialInertia], str]:
    """Return the inertia of every segment, base first, and its source: identified, or placeholders."""
    placeholder = SpatialInertia(1.0, np.zeros(3), np.array([0.01, 0.01, 0.01, 0.0, 0.0, 0.0]))
    tree = run.tree("dynamics.h5")
    blocks = np.zeros((0, 0)) if tree is None else tree.numbers("full/value").reshape(-1)
    width = len(LINK_PARAMETERS)
    if blocks.size in (width * count, width * (count - 1)) and np.isfinite(blocks).all():
        found = [about_centre(block) for block in blocks.reshape(-1, width)]
        base = [placeholder] * (count - len(found))
        also = "; the base has a placeholder" if base else ""
        return [*base, *found], f"one of the physically possible bodies with the identified base parameters{also}"
    why = run.why_missing("dynamics.h5")
    return [placeholder] * count, (
        f"placeholders of {_PLACEHOLDER}, which OpenSim needs to load a chain; none is identified ({why}). Use this "
        "model for kinematics only"
    )


def about_centre(block: FloatArray) -> SpatialInertia:
    """Convert m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin (10,) to the centre of mass.

    Examples
    --------
    >>> about_centre(np.array([2.0, 0.0, 1.0, 0.0, 0.75, 0.1, 0.75, 0.0, 0.0, 0.0])).inertia
    array([0.25, 0.1 , 0.25, 0.  , 0.  , 0.  ])
    """
    mass, moment = float(block[0]), block[1:4]
    if mass <= 0.0:
        return SpatialInertia(LEAST_MASS, np.zeros(3), np.clip(block[4:], 0.0, None) * [1, 1, 1, 0, 0, 0])
    xx, yy, zz, xy, xz, yz = block[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    own = about_origin + hat(moment) @ hat(moment) / mass
    return SpatialInertia(mass, moment / mass, own[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] + 0.0)
