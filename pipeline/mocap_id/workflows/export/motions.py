"""MOT and STO tables of the joints: angles in degrees, states and torques in SI units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording import format_motion_table
from mocap_id.store.views import JointStates, Skeleton, joint_columns
from mocap_id.workflows.export.files import ExportFiles, angles_file, torques_file
from mocap_id.workflows.export.names import coordinate_names, joint_names
from mocap_id.workflows.run_folder import RunFolder

WRENCH = ("Fx", "Fy", "tauz")


def angles(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_angles.mot`` with a column for each coordinate of the exported model, degrees."""
    found = _joints(run)
    if isinstance(found, ExportFiles):
        return found
    skeleton, motion = found
    values = np.degrees(motion.angles)
    return sampled(
        angles_file(run), "joint angles", coordinate_names(skeleton), values, time=motion.time, in_degrees=True
    )


def states(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_states.sto`` and ``<trial>_accelerations.sto``, rad, rad/s and rad/s².

    The states have OpenSim's full names, so that OpenSim can read the file as a states trajectory.
    """
    found = _joints(run)
    if isinstance(found, ExportFiles):
        return found
    skeleton, motion = found
    paths = [
        f"/jointset/{joint}/{coordinate}"
        for joint, coordinate in zip(joint_names(skeleton), coordinate_names(skeleton), strict=True)
    ]
    columns = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    values = np.column_stack([motion.mean[..., 0], motion.mean[..., 1]])
    kinematics = sampled(f"{run.name}_states.sto", "joint states", columns, values, time=motion.time)
    return kinematics + sampled(
        f"{run.name}_accelerations.sto",
        "joint accelerations",
        coordinate_names(skeleton),
        motion.mean[..., 2],
        time=motion.time,
    )


def torques(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_torques.sto``, with OpenSim's column names, and ``<trial>_wrench.sto``."""
    table, skeleton = run.table("dynamics.parquet"), _skeleton(run)
    if table is None or skeleton is None:
        return ExportFiles(notes=(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}",))
    time = table["time"]
    columns = [name for name in (*WRENCH, *(f"{name}_model" for name in WRENCH)) if np.isfinite(table[name]).any()]
    notes: tuple[str, ...] = ()
    parts = ExportFiles()
    if columns:
        parts += sampled(f"{run.name}_wrench.sto", "wrench", columns, table.stack(columns), time=time)
    values = joint_columns(table, "tau", len(skeleton.joints))
    if np.isfinite(values).any():
        names = [f"{name}_moment" for name in coordinate_names(skeleton)]
        parts += sampled(torques_file(run), "joint torques", names, values, time=time)
    else:
        notes = (f"sto: no torques, no modelled wrench: {run.why_missing('dynamics.h5')}",)
    return parts + ExportFiles(notes=notes)


def known_rows(file: str, values: FloatArray) -> tuple[BoolArray, tuple[str, ...]]:
    """Return which rows (T,) have only known values, and notes on the others.

    OpenSim's tools silently stop reading at the first `nan`, so rows with unknown values are not written; OpenSim
    interpolates between the rows around a gap.
    """
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    inside = np.flatnonzero(known)
    within = int(np.sum(~known[inside[0] : inside[-1]])) if len(inside) else 0
    notes = []
    if not known.all():
        notes.append(f"{file}: rows left out, because a value in them is unknown: {int(np.sum(~known))}")
    if within:
        notes.append(f"{file}: {within} of them lie between others, and OpenSim interpolates over them")
    return known, tuple(notes)


def sampled(
    file: str, title: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> ExportFiles:
    """Return a table of the columns that have values, and of the rows in which all of these are known."""
    used: BoolArray = np.asarray(np.isfinite(values).any(axis=0))
    unknown = [name for name, any_known in zip(columns, used, strict=True) if not any_known]
    labels, values = [name for name in columns if name not in unknown], values[:, used]
    known, notes = known_rows(file, values)
    if unknown:
        notes = (f"{file}: columns left out, because nothing in them is known: {', '.join(unknown)}", *notes)
    text = format_motion_table(title, labels, values[known], time=time[known], in_degrees=in_degrees)
    return ExportFiles({file: text.encode()}, notes)


def _skeleton(run: RunFolder) -> Skeleton | None:
    tree = run.tree("chain.h5")
    return None if tree is None else Skeleton.from_tree(tree)


def _joints(run: RunFolder) -> tuple[Skeleton, JointStates] | ExportFiles:
    skeleton, table = _skeleton(run), run.table("states.parquet")
    if skeleton is None or table is None:
        return ExportFiles(notes=(f"mot, sto: no joint angles: {run.why_missing('states.parquet')}",))
    return skeleton, JointStates.from_table(table)
