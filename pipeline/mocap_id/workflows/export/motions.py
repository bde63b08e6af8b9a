"""MOT and STO tables of the joints: angles in degrees, states and torques in SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording import motion_text
from mocap_id.reporting.views import Motion, Skeleton
from mocap_id.workflows.export.names import coordinate_names, joint_names
from mocap_id.workflows.export.parts import Parts
from mocap_id.workflows.run_folder import RunFolder

WRENCH = ("Fx", "Fy", "tauz")


def angles_file(run: RunFolder) -> str:
    """Name of the joint angles' file."""
    return f"{run.name}_angles.mot"


def angles(run: RunFolder) -> Parts:
    """``<trial>_angles.mot``: one column a coordinate of the exported model, degrees."""
    found = _joints(run)
    if isinstance(found, Parts):
        return found
    skeleton, motion = found
    values = np.degrees(motion.angles)
    return sampled(
        angles_file(run), "joint angles", coordinate_names(skeleton), values, time=motion.time, in_degrees=True
    )


def states(run: RunFolder) -> Parts:
    """``<trial>_states.sto`` and ``<trial>_accelerations.sto``, rad, rad/s and rad/s².

    The states' columns have OpenSim's full names, so that a states' trajectory can be made of the file.
    """
    found = _joints(run)
    if isinstance(found, Parts):
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


def torques_file(run: RunFolder) -> str:
    """Name of the joint torques' file."""
    return f"{run.name}_torques.sto"


def torques(run: RunFolder) -> Parts:
    """``<trial>_torques.sto``, named as OpenSim's inverse dynamics does, and ``<trial>_wrench.sto``; N, N·m, m."""
    table, skeleton = run.table("dynamics.parquet"), _skeleton(run)
    if table is None or skeleton is None:
        return Parts(notes=(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}",))
    time = table["time"]
    columns = [name for name in (*WRENCH, *(f"{name}_model" for name in WRENCH)) if np.isfinite(table[name]).any()]
    notes: tuple[str, ...] = ()
    parts = Parts()
    if columns:
        parts += sampled(f"{run.name}_wrench.sto", "wrench", columns, table.stack(columns), time=time)
    values = table.stack([f"tau_{j}" for j in range(1, len(skeleton.joints) + 1)])
    if np.isfinite(values).any():
        names = [f"{name}_moment" for name in coordinate_names(skeleton)]
        parts += sampled(torques_file(run), "joint torques", names, values, time=time)
    else:
        notes = (f"sto: no torques, no modelled wrench: {run.why_missing('dynamics.h5')}",)
    return parts + Parts(notes=notes)


def known_rows(file: str, values: FloatArray) -> tuple[BoolArray, tuple[str, ...]]:
    """Rows (T,) whose cells are all known, and a sentence on the others.

    OpenSim's tools read a table up to its first `nan` and take that for its end without a word, so no such row is
    written; between the rows around a gap they interpolate.
    """
    known: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    inside = np.flatnonzero(known)
    within = int(np.sum(~known[inside[0] : inside[-1]])) if len(inside) else 0
    said = []
    if not known.all():
        said.append(f"{file}: rows left out, because a value in them is unknown: {int(np.sum(~known))}")
    if within:
        said.append(f"{file}: {within} of them lie between others, and OpenSim interpolates over them")
    return known, tuple(said)


def sampled(
    file: str, title: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> Parts:
    """A table of the columns that have values, and of the rows in which all of these are known."""
    said: BoolArray = np.asarray(np.isfinite(values).any(axis=0))
    silent = [name for name, any_known in zip(columns, said, strict=True) if not any_known]
    labels, values = [name for name in columns if name not in silent], values[:, said]
    known, notes = known_rows(file, values)
    if silent:
        notes = (f"{file}: columns left out, because nothing in them is known: {', '.join(silent)}", *notes)
    text = motion_text(title, labels, values[known], time=time[known], in_degrees=in_degrees)
    return Parts({file: text.encode()}, notes)


def _skeleton(run: RunFolder) -> Skeleton | None:
    tree = run.tree("chain.h5")
    return None if tree is None else Skeleton.from_tree(tree)


def _joints(run: RunFolder) -> tuple[Skeleton, Motion] | Parts:
    skeleton, table = _skeleton(run), run.table("states.parquet")
    if skeleton is None or table is None:
        return Parts(notes=(f"mot, sto: no joint angles: {run.why_missing('states.parquet')}",))
    return skeleton, Motion.from_table(table)
