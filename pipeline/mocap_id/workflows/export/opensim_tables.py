"""MOT and STO tables: motion and torques of the joints, and external forces on the body; and a model of free bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import SampledWrench
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.recording import format_motion_table
from mocap_id.store.artefacts import JointStates, Skeleton, SpatialAngles, joint_columns
from mocap_id.workflows.export.opensim_model import (
    LEAST_RANGE,
    body_element,
    convert_planar_inertia,
    coordinate_element,
    element,
    format_document,
    format_dynamics_setup,
    format_model,
    model_joints,
    place_markers,
    planar_joint,
    read_gravity,
    read_model_parts,
)
from mocap_id.workflows.export.tables import (
    ANGLES,
    FORCES,
    FREE_MODEL,
    FREE_POSES,
    LOADS,
    MODEL,
    TORQUES,
    ExportFiles,
    make_legal,
    name_coordinates,
    note_contact,
    opensim_bodies,
    opensim_joints,
)
from mocap_id.workflows.identified_trial import MovingBodies, read_measured_bodies
from mocap_id.workflows.run_folder import RunFolder

_IN_PLANE = ("Fx", "Fy", "tauz")
_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
_Load: TypeAlias = tuple[str, int, FloatArray]
"""An external wrench: the prefix of its columns, the segment on which it acts (0 is the base), and its values (T, 3),
or in space (T, 6), about the origin, N and N·m."""


# Motion and torques of the joints.


def export_angles(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_angles.mot`` with a column for each coordinate of the exported model, degrees."""
    parts = _read_joint_states(run, out)
    if parts is not None:
        skeleton, motion = parts
        names, values = name_coordinates(skeleton), np.degrees(motion.angles)
        add_motion(out, run.name + ANGLES, "joint angles", names, values, time=motion.time, in_degrees=True)


def export_states(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_states.sto`` (rad, rad/s; OpenSim's full names) and ``<trial>_accelerations.sto`` (rad/s²)."""
    parts = _read_joint_states(run, out)
    if parts is not None:
        skeleton, motion = parts
        names, time, mean = name_coordinates(skeleton), motion.time, motion.mean
        paths = [f"/jointset/{joint}/{name}" for joint, name in zip(opensim_joints(skeleton), names, strict=True)]
        columns = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
        values = np.column_stack([mean[..., 0], mean[..., 1]])
        add_motion(out, f"{run.name}_states.sto", "joint states", columns, values, time=time)
        add_motion(out, f"{run.name}_accelerations.sto", "joint accelerations", names, mean[..., 2], time=time)


def _read_joint_states(run: RunFolder, out: ExportFiles) -> tuple[Skeleton, JointStates] | None:
    tree, table = run.tree("chain.h5"), run.table("states.parquet")
    if tree is None or table is None:
        out.note(f"mot, sto: no joint angles: {run.why_missing('states.parquet')}")
        return None
    return Skeleton(tree), JointStates.from_table(table)


def export_torques(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_torques.sto``, with OpenSim's column names, and ``<trial>_wrench.sto``."""
    table, tree = run.table("dynamics.parquet"), run.tree("chain.h5")
    if table is None or tree is None:
        out.note(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}")
        return
    skeleton, time = Skeleton(tree), table["time"]
    wrench = [*_IN_PLANE, *(f"{name}_model" for name in _IN_PLANE)]
    columns = [name for name in wrench if np.isfinite(table[name]).any()]
    if columns:
        add_motion(out, f"{run.name}_wrench.sto", "wrench", columns, table.stack(columns), time=time)
    values = joint_columns(table, "tau", len(skeleton.joints))
    if not np.isfinite(values).any():
        out.note(f"sto: no torques, no modelled wrench: {run.why_missing('dynamics.h5')}")
        return
    names = [f"{name}_moment" for name in name_coordinates(skeleton)]
    note_contact(run, out, "sto")
    add_motion(out, run.name + TORQUES, "joint torques", names, values, time=time)


def export_model_motion(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_angles.mot`` in space, with a column for each coordinate of the model, degrees and m."""
    parts = read_model_parts(run)
    if isinstance(parts, str):
        out.note(f"mot: no coordinates of a model: {parts}")
        return
    names, columns = list[str](), list[FloatArray]()
    for joint in model_joints(*parts):
        for k, name in enumerate(joint.coordinates):
            is_length = joint.slides or (joint.element == "FreeJoint" and k >= 3)
            names.append(name)
            columns.append(joint.values[:, k] if is_length else np.degrees(joint.values[:, k]))
    file, title, time = run.name + ANGLES, "coordinates of the model", parts[1].time
    add_motion(out, file, title, names, np.column_stack(columns), time=time, in_degrees=True)


def export_anatomical_angles(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_joint_angles.mot`` with the angles of ``angles.parquet``, degrees."""
    table = run.table("angles.parquet")
    angles = None if table is None else SpatialAngles(table)
    if angles is None or not angles.names:
        out.note(f"mot: no joint angles: {run.why_missing('angles.parquet')}")
        return
    names, values = tuple(make_legal(angles.names).values()), np.degrees(angles.mean[..., 0])
    file = f"{run.name}_joint_angles.mot"
    add_motion(out, file, "joint angles", names, values, time=angles.time, in_degrees=True)


def find_known_rows(file: str, values: FloatArray) -> tuple[BoolArray, tuple[str, ...]]:
    """Return which rows (T,) of ``values`` (T, K) have only known values, and notes on the other rows of ``file``.

    Rows with unknown values are not written, because OpenSim's tools stop reading at the first `nan` without a message.
    OpenSim interpolates between the rows around a gap.
    """
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    inside = np.flatnonzero(known)
    within = int(np.sum(~known[inside[0] : inside[-1]])) if len(inside) else 0
    notes = []
    if not known.all():
        notes.append(f"{file}: {int(np.sum(~known))} rows are left out, because they contain unknown values")
    if within:
        notes.append(f"{file}: {within} of these rows are between known rows, where OpenSim interpolates")
    return known, tuple(notes)


def add_motion(
    out: ExportFiles,
    file: str,
    title: str,
    columns: Sequence[str],
    values: FloatArray,
    *,
    time: FloatArray,
    in_degrees: bool = False,
) -> None:
    """Add a MOT or STO table, without the ``columns`` that have only unknown values and the rows that have any.

    ``values`` are (T, K), NaN where unknown. Notes list the columns and rows that are left out.
    """
    used: BoolArray = np.asarray(np.isfinite(values).any(axis=0))
    unknown = [name for name, any_known in zip(columns, used, strict=True) if not any_known]
    labels, values = [name for name in columns if name not in unknown], values[:, used]
    known, notes = find_known_rows(file, values)
    if unknown:
        out.note(f"{file}: columns left out, because all their values are unknown: {', '.join(unknown)}")
    out.note(*notes)
    text = format_motion_table(title, labels, values[known], time=time[known], in_degrees=in_degrees)
    out.files[file] = text.encode()


# External forces on the body.


def export_forces(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_grf.mot`` and ``<trial>_external_loads.xml``.

    They contain the measured ground wrench on the base segment at the cameras' times, in the plane frame, or for a
    trial in space in the frame of the trial. In the plane, chair and force sensors have columns of their own.
    """
    components = _IN_SPACE if run.in_space else _IN_PLANE
    tables = (run.table("dynamics.parquet"), run.table("wrench.parquet"))
    table = next((each for each in tables if each is not None and set(components) <= set(each.names)), None)
    if table is None or not np.isfinite(table.stack(components)).all(axis=1).any():
        why = run.facts("wrench.parquet").get("why") or run.why_missing("wrench.parquet")
        out.note(f"mot: no forces: {why}")
        return
    loads: list[_Load] = [("ground_force", 0, table.stack(components))]
    if not run.in_space:
        # The wrenches of chair and force sensors that the identification used, at the cameras' times.
        others: list[_Load] = []
        found, facts = run.table("wrench.parquet"), run.facts("dynamics.h5")
        segments = {str(fact["name"]): int(fact["segment"]) for fact in facts.get("external") or ()}
        # The clock offset that is corrected in dynamics.parquet but not in wrench.parquet, s.
        offset = float((facts.get("clock") or {}).get("applied_s") or 0.0)
        for fact in run.facts("wrench.parquet").get("external") or ():
            if found is not None and str(fact["name"]) in segments:
                wrench = found.stack([f"{each}_{fact['columns']}" for each in _IN_PLANE])
                if fact["clock"] == "plates":
                    wrench = SampledWrench(found["time"], wrench)(found["time"] - offset)
                others.append((str(fact["name"]), segments[str(fact["name"])], wrench))
        measured = {str(fact["name"]) for fact in run.facts("wrench.parquet").get("external") or ()}
        unused = sorted(measured - {name for name, _, _ in others})
        out.note(*(f"mot: {name} is omitted, because the identification did not use it" for name in unused))
        names = make_legal((name for name, _, _ in others), taken=("ground",))
        loads += [(f"{names[name]}_force", segment, wrench) for name, segment, wrench in others]
    threshold = float(run.facts("wrench.parquet").get("cop_threshold_N") or 0.0)
    columns = [f"{name}_{kind}{axis}" for name, _, _ in loads for kind in "vpm" for axis in "xyz"]
    convert = convert_spatial_wrench if run.in_space else convert_planar_wrench
    values = np.column_stack([convert(wrench, threshold) for _, _, wrench in loads])
    file = run.name + FORCES
    rows, missing = find_known_rows(file, values)
    text = format_motion_table("external forces on the body", columns, values[rows], time=table["time"][rows])
    out.files[file] = text.encode()
    out.note(*missing)
    tree = run.tree("chain.h5")
    if tree is None:
        return
    bodies = opensim_bodies(tree.texts("segments/name"))
    # The file of external loads refers to the columns of the table.
    objects = [
        element(
            "ExternalForce",
            name=name,
            applied_to_body=bodies[segment],
            force_expressed_in_body="ground",
            point_expressed_in_body="ground",
            force_identifier=f"{name}_v",
            point_identifier=f"{name}_p",
            torque_identifier=f"{name}_m",
        )
        for name, segment, _ in loads
    ]
    out.files[run.name + LOADS] = format_document("ExternalLoads", run.name, objects=objects, datafile=file)


def convert_planar_wrench(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) that are equivalent to a wrench Fx, Fy, tauz (T, 3) about the origin.

    The point is the centre of pressure on y = 0. Where the absolute value of Fy is not above ``threshold``, N, the
    point keeps its last value, and the free moment makes the wrench exact.
    """
    force, moment = wrench[:, :2], wrench[:, 2]
    loaded = np.abs(force[:, 1]) > max(threshold, 1e-9)
    x = np.where(loaded, moment / np.where(loaded, force[:, 1], 1.0), np.nan)
    known = np.flatnonzero(np.isfinite(x))
    if len(known):
        before = np.searchsorted(known, np.arange(len(x)), side="right") - 1
        x = x[known[np.maximum(before, 0)]]
    else:
        x = np.zeros(len(x))
    zero = np.zeros(len(x))
    free = np.where(loaded, 0.0 * moment, moment - x * force[:, 1])
    return np.column_stack([force, zero, x, zero, zero, zero, zero, free])


def convert_spatial_wrench(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) that are equivalent to a wrench (T, 6) about the origin.

    The point is the centre of pressure on y = 0, or the origin where the absolute value of Fy is not above
    ``threshold``, N.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.abs(force[:, 1]) > max(threshold, 1e-9)
    divisor = np.where(loaded, force[:, 1], 1.0)
    point = np.zeros_like(force)
    point[:, 0] = np.where(loaded, moment[:, 2] / divisor, 0.0 * moment[:, 2])
    point[:, 2] = np.where(loaded, -moment[:, 0] / divisor, 0.0 * moment[:, 0])
    return np.column_stack([force, point, moment - np.cross(point, force)])


# Free bodies, for trials identified on measured poses. The model of the chain has pin joints and cannot represent these
# bodies, which separate at the joints. In a second model, every body has a planar joint to the ground and no joint to
# another body. Inverse dynamics then gives the force and the moment that each body requires for its motion. The torque
# of a joint is the moment of these forces on all bodies beyond it, about the joint's centre.

_COORDINATES = ("rz", "tx", "ty")  # OpenSim's order in a planar joint


@dataclass(frozen=True)
class _FreeBodies:
    """K free bodies with their motion at T times and their parameters."""

    names: tuple[str, ...]  # of the bodies in OpenSim
    joints: tuple[str, ...]  # names of the chain's n joints in OpenSim
    parted: list[int]  # indices of the joints between two bodies
    time: FloatArray  # (T,) s
    moving: MovingBodies
    parameters: FloatArray  # (K, 4) m, mx, my, Izz about the origin of each body's frame

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates: angle, x and y of every body."""
        return [f"{name}_{each}" for name in self.names for each in _COORDINATES]


def _read_free_bodies(run: RunFolder) -> _FreeBodies | None:
    """Return the free bodies of a run; None if it was identified on the chain, or not at all."""
    chain, identified, poses = run.tree("chain.h5"), run.tree("dynamics.h5"), run.table("poses.parquet")
    chosen = run.facts("dynamics.h5").get("motion") or {}
    if chain is None or identified is None or poses is None or not chosen.get("used"):
        return None
    skeleton, cutoffs = Skeleton(chain), chosen["bands_hz"]
    bands = (float(cutoffs["x"]), float(cutoffs["y"]), float(cutoffs["angle"]))
    moving = read_measured_bodies(poses, skeleton, chosen, bands, read_gravity(run))
    return _FreeBodies(
        names=opensim_bodies(moving.skeleton.segments),
        joints=opensim_joints(skeleton),
        parted=np.flatnonzero(np.isfinite(moving.motion.joint).any(axis=(0, 2))).tolist(),
        time=poses["time"],
        moving=moving,
        parameters=identified.numbers("bodies/value", (-1, len(PLANAR_PARAMETERS))),
    )


def export_free_poses(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free_poses.mot`` with all coordinates of free bodies, degrees and m; nothing without them."""
    bodies = _read_free_bodies(run)
    if bodies is not None:
        values = _join_columns(np.degrees(bodies.moving.motion.angle), bodies.moving.motion.origin)
        file, title = run.name + FREE_POSES, "poses of the bodies"
        add_motion(out, file, title, bodies.coordinates, values, time=bodies.time, in_degrees=True)


def export_free_states(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free_states.sto``, ``_free_accelerations.sto`` and ``_free_joints.sto`` (joint centres).

    A note says that the torques and the modelled wrench belong to this motion. Without free bodies, nothing is added.
    """
    bodies = _read_free_bodies(run)
    if bodies is None:
        return
    motion, time, parted = bodies.moving.motion, bodies.time, bodies.parted
    paths = [f"/jointset/{name}_pose/{name}_{each}" for name in bodies.names for each in _COORDINATES]
    velocity = np.gradient(motion.origin, time, axis=0)  # of the origins; no force depends on it
    states = np.hstack([_join_columns(motion.angle, motion.origin), _join_columns(motion.omega, velocity)])
    labels = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    add_motion(out, f"{run.name}_free_states.sto", "states of the bodies", labels, states, time=time)
    accelerations = _join_columns(motion.alpha, motion.acceleration)
    file, title = f"{run.name}_free_accelerations.sto", "accelerations of the bodies"
    add_motion(out, file, title, bodies.coordinates, accelerations, time=time)
    centres = motion.joint[:, parted].reshape(len(time), -1)
    labels = [f"{bodies.joints[j]}_{axis}" for j in parted for axis in "xy"]
    add_motion(out, f"{run.name}_free_joints.sto", "centres of the joints", labels, centres, time=time)
    out.note(
        f"sto: torques and modelled wrench belong to bodies on their measured poses ({run.name}_free_states.sto), "
        f"not to the chain ({run.name}_states.sto)"
    )


def export_free_model(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free.osim`` and ``<trial>_free_id.xml`` with a note; nothing without free bodies."""
    bodies = _read_free_bodies(run)
    if bodies is None:
        return
    motion, skeleton = bodies.moving.motion, bodies.moving.skeleton
    comments = [
        "The bodies on which the trial was identified. They have no joints between them: each moves as its markers "
        "were measured. For each body, inverse dynamics gives the required force (tx, ty) and the required moment "
        "about the origin of its frame (rz)."
    ]
    # How the torque of each joint follows from the forces on the bodies.
    others = run.facts("dynamics.h5").get("external") or ()
    less = ", minus the moment of chair and sensors on them" if others else ""
    for j in bodies.parted:
        beyond = [name for name, is_beyond in zip(bodies.names, motion.beyond[j], strict=True) if is_beyond]
        comments.append(
            f"Torque of {bodies.joints[j]}: the moment, about its centre in {run.name}_free_joints.sto, of the "
            f"forces that these bodies require together: {', '.join(beyond)}{less}."
        )
    # The joints between the ground and each body; their default values are the first known pose of the body.
    joints = []
    for k, name in enumerate(bodies.names):
        poses = _join_columns(motion.angle[:, [k]], motion.origin[:, [k]])
        known = poses[np.isfinite(poses).all(axis=1)]
        first = known[0] if len(known) else np.zeros(3)
        coordinates = [
            coordinate_element(f"{name}_{each}", float(value), (-LEAST_RANGE, LEAST_RANGE))
            for each, value in zip(_COORDINATES, first, strict=True)
        ]
        joints.append(planar_joint(f"{name}_pose", name, coordinates))
    elements = [
        body_element(name, convert_planar_inertia(block))
        for name, block in zip(bodies.names, bodies.parameters, strict=True)
    ]
    markers = list(place_markers(run, bodies.names, skeleton.markers, skeleton.segment, skeleton.local))
    parts = {"bodies": elements, "joints": joints, "markers": markers}
    out.files[run.name + FREE_MODEL] = format_model(run, "the plane frame", comments, **parts)
    setup = format_dynamics_setup(run, (FREE_MODEL, FREE_POSES, "_opensim_free_id.sto"))
    out.files[f"{run.name}_free_id.xml"] = setup
    out.note(
        f"osim: this trial was identified on the measured poses of its bodies, which separate at the joints. "
        f"{run.name}{MODEL} is the chain of pin joints: its inverse dynamics does not give {run.name}{TORQUES}. "
        f"{run.name}{FREE_MODEL} has these bodies without joints between them: the torque of a joint is the moment, "
        "about its centre, of the forces that the bodies beyond it require"
    )


def _join_columns(angle: FloatArray, position: FloatArray) -> FloatArray:
    """Return angles (T, K) and positions (T, K, 2) of K bodies as columns (T, 3K), body by body."""
    return np.concatenate([angle[..., None], position], axis=-1).reshape(len(angle), -1)
