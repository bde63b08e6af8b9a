"""MOT and STO tables of the joints' motion and torques; MOT tables are in degrees, STO tables in SI units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording import format_motion_table
from mocap_id.store.spatial_views import SpatialAngles
from mocap_id.store.views import JointStates, Skeleton, joint_columns
from mocap_id.workflows.export.files import (
    ANGLES,
    TORQUES,
    ExportFiles,
    make_legal,
    name_coordinates,
    name_joints,
    note_contact,
)
from mocap_id.workflows.export.spatial_joints import list_coordinates, model_joints
from mocap_id.workflows.export.spatial_model import read_model_parts
from mocap_id.workflows.run_folder import RunFolder

_WRENCH = ("Fx", "Fy", "tauz")


def export_angles(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_angles.mot`` with a column for each coordinate of the exported model, degrees."""
    parts = _read_joints(run)
    if isinstance(parts, ExportFiles):
        return parts
    skeleton, motion = parts
    names, values = name_coordinates(skeleton), np.degrees(motion.angles)
    return format_motion(run.name + ANGLES, "joint angles", names, values, time=motion.time, in_degrees=True)


def export_states(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_states.sto`` (rad, rad/s) and ``<trial>_accelerations.sto`` (rad/s²).

    The states have the full names of OpenSim, so that OpenSim can read the file as a states trajectory.
    """
    parts = _read_joints(run)
    if isinstance(parts, ExportFiles):
        return parts
    skeleton, motion = parts
    names, time, mean = name_coordinates(skeleton), motion.time, motion.mean
    paths = [f"/jointset/{joint}/{name}" for joint, name in zip(name_joints(skeleton), names, strict=True)]
    columns = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    values = np.column_stack([mean[..., 0], mean[..., 1]])
    states = format_motion(f"{run.name}_states.sto", "joint states", columns, values, time=time)
    file = f"{run.name}_accelerations.sto"
    return states + format_motion(file, "joint accelerations", names, mean[..., 2], time=time)


def export_torques(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_torques.sto``, with OpenSim's column names, and ``<trial>_wrench.sto``."""
    table, skeleton = run.table("dynamics.parquet"), _read_skeleton(run)
    if table is None or skeleton is None:
        return ExportFiles(notes=(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}",))
    time, parts = table["time"], ExportFiles()
    columns = [name for name in (*_WRENCH, *(f"{name}_model" for name in _WRENCH)) if np.isfinite(table[name]).any()]
    if columns:
        parts += format_motion(f"{run.name}_wrench.sto", "wrench", columns, table.stack(columns), time=time)
    values = joint_columns(table, "tau", len(skeleton.joints))
    if not np.isfinite(values).any():
        note = f"sto: no torques, no modelled wrench: {run.why_missing('dynamics.h5')}"
        return parts + ExportFiles(notes=(note,))
    names = [f"{name}_moment" for name in name_coordinates(skeleton)]
    parts += note_contact(run, "sto")
    return parts + format_motion(run.name + TORQUES, "joint torques", names, values, time=time)


def export_model_motion(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_angles.mot`` in space, with a column for each coordinate of the model, degrees and m."""
    parts = read_model_parts(run)
    if isinstance(parts, str):
        return ExportFiles(notes=(f"mot: no coordinates of a model: {parts}",))
    skeleton, poses = parts
    rows = list(list_coordinates(model_joints(skeleton, poses)))
    values = np.column_stack([np.degrees(values) if is_angle else values for _, values, is_angle in rows])
    names, title = [name for name, _, _ in rows], "coordinates of the model"
    return format_motion(run.name + ANGLES, title, names, values, time=poses.time, in_degrees=True)


def export_anatomical_angles(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_joint_angles.mot`` with the angles of ``angles.parquet``, degrees."""
    table = run.table("angles.parquet")
    angles = None if table is None else SpatialAngles.from_table(table)
    if angles is None or not angles.names:
        return ExportFiles(notes=(f"mot: no joint angles: {run.why_missing('angles.parquet')}",))
    names, values = tuple(make_legal(angles.names).values()), np.degrees(angles.mean[..., 0])
    file = f"{run.name}_joint_angles.mot"
    return format_motion(file, "joint angles", names, values, time=angles.time, in_degrees=True)


def note_missing_states(run: RunFolder) -> ExportFiles:
    """Return a note that there are no states in space, because they would need the speeds of OpenSim's coordinates."""
    del run
    return ExportFiles(notes=("sto: not available in space: the CSV tables contain velocities and accelerations",))


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


def format_motion(
    file: str, title: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> ExportFiles:
    """Return a MOT or STO table, without the ``columns`` that have only unknown values and the rows that have any.

    ``values`` are (T, K), NaN where unknown. Notes list the columns and rows that are left out.
    """
    used: BoolArray = np.asarray(np.isfinite(values).any(axis=0))
    unknown = [name for name, any_known in zip(columns, used, strict=True) if not any_known]
    labels, values = [name for name in columns if name not in unknown], values[:, used]
    known, notes = find_known_rows(file, values)
    if unknown:
        notes = (f"{file}: columns left out, because all their values are unknown: {', '.join(unknown)}", *notes)
    text = format_motion_table(title, labels, values[known], time=time[known], in_degrees=in_degrees)
    return ExportFiles({file: text.encode()}, notes)


def _read_skeleton(run: RunFolder) -> Skeleton | None:
    tree = run.tree("chain.h5")
    return None if tree is None else Skeleton.from_tree(tree)


def _read_joints(run: RunFolder) -> tuple[Skeleton, JointStates] | ExportFiles:
    skeleton, table = _read_skeleton(run), run.table("states.parquet")
    if skeleton is None or table is None:
        return ExportFiles(notes=(f"mot, sto: no joint angles: {run.why_missing('states.parquet')}",))
    return skeleton, JointStates.from_table(table)
