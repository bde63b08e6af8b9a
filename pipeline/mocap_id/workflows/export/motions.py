"""MOT and STO tables of the joints: angles in degrees, states and torques in SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording import motion_text
from mocap_id.reporting.views import Motion, Skeleton
from mocap_id.workflows.export.names import coordinate_names, joint_names
from mocap_id.workflows.export.parts import Parts
from mocap_id.workflows.run_folder import RunFolder

WRENCH = ("Fx", "Fy", "tauz", "cop_x")


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
    return _table(
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
    kinematics = _table(f"{run.name}_states.sto", "joint states", columns, values, time=motion.time)
    return kinematics + _table(
        f"{run.name}_accelerations.sto",
        "joint accelerations",
        coordinate_names(skeleton),
        motion.mean[..., 2],
        time=motion.time,
    )


def torques(run: RunFolder) -> Parts:
    """``<trial>_torques.sto``, named as OpenSim's inverse dynamics does, and ``<trial>_wrench.sto``; N, N·m, m."""
    frame, skeleton = run.frame("dynamics.parquet"), _skeleton(run)
    if frame is None or skeleton is None:
        return Parts(notes=(f"sto: no torques, no wrench: {run.why_missing('dynamics.parquet')}",))
    time = frame["time"].to_numpy(dtype=np.float64)
    columns = [name for name in (*WRENCH, *(f"{name}_model" for name in WRENCH)) if frame[name].notna().any()]
    notes: tuple[str, ...] = ()
    parts = Parts()
    if columns:
        parts += _table(f"{run.name}_wrench.sto", "wrench", columns, frame[columns].to_numpy(np.float64), time=time)
    values = frame[[f"tau_{j}" for j in range(1, len(skeleton.joints) + 1)]].to_numpy(dtype=np.float64)
    if np.isfinite(values).any():
        names = [f"{name}_moment" for name in coordinate_names(skeleton)]
        parts += _table(f"{run.name}_torques.sto", "joint torques", names, values, time=time)
    else:
        notes = (f"sto: no torques, no modelled wrench: {run.why_missing('dynamics.h5')}",)
    return parts + Parts(notes=notes)


def known_rows(file: str, values: FloatArray) -> tuple[slice, tuple[str, ...]]:
    """Rows from the first to the last that is known, and a sentence where some between them are not."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(known):
        return slice(0, len(values)), (f"{file}: no row is known as a whole; unknown cells are nan",)
    rows = slice(int(known[0]), int(known[-1]) + 1)
    lost, between = len(values) - (rows.stop - rows.start), rows.stop - rows.start - len(known)
    said = []
    if lost:
        said.append(f"rows left out at its ends, where values are unknown: {lost}")
    if between:
        said.append(f"rows that hold nan: {between}; choose a time range without them in OpenSim")
    return rows, tuple(f"{file}: {sentence}" for sentence in said)


def _table(
    file: str, title: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> Parts:
    told = np.isfinite(values).any(axis=0)  # a centre of pressure is unknown whenever the plate is unloaded
    decisive = values[:, told & ~np.char.startswith(np.array(columns), "cop_x")]
    rows, notes = known_rows(file, decisive if decisive.size else values)
    text = motion_text(title, columns, values[rows], time=time[rows], in_degrees=in_degrees)
    return Parts({file: text.encode()}, notes)


def _skeleton(run: RunFolder) -> Skeleton | None:
    tree = run.tree("chain.h5")
    return None if tree is None else Skeleton.from_tree(tree)


def _joints(run: RunFolder) -> tuple[Skeleton, Motion] | Parts:
    skeleton, frame = _skeleton(run), run.frame("states.parquet")
    if skeleton is None or frame is None:
        return Parts(notes=(f"mot, sto: no joint angles: {run.why_missing('states.parquet')}",))
    return skeleton, Motion.from_frame(frame)
