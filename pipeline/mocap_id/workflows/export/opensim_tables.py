"""MOT and STO tables: motion and torques of the joints, and external forces on the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import SampledWrench
from mocap_id.recording import format_motion_table
from mocap_id.store.views import JointStates, Skeleton, SpatialAngles, joint_columns
from mocap_id.workflows.export.files import (
    ANGLES,
    FORCES,
    LOADS,
    TORQUES,
    ExportFiles,
    make_legal,
    name_coordinates,
    note_contact,
    opensim_bodies,
    opensim_joints,
)
from mocap_id.workflows.export.opensim_model import element, format_document, model_joints, read_model_parts
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
    return Skeleton.from_tree(tree), JointStates.from_table(table)


def export_torques(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_torques.sto``, with OpenSim's column names, and ``<trial>_wrench.sto``."""
    table, tree = run.table("dynamics.parquet"), run.tree("chain.h5")
    if table is None or tree is None:
        out.note(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}")
        return
    skeleton, time = Skeleton.from_tree(tree), table["time"]
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
    angles = None if table is None else SpatialAngles.from_table(table)
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
                    wrench = SampledWrench.of(found["time"], wrench)(found["time"] - offset)
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
