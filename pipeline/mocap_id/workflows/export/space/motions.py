"""MOT tables of a trial in space: coordinates of the model, and angles."""

from __future__ import annotations

import numpy as np

from mocap_id.store.spatial_views import SpatialAngles
from mocap_id.workflows.export.files import ExportFiles, angles_file
from mocap_id.workflows.export.motions import sampled
from mocap_id.workflows.export.names import legal
from mocap_id.workflows.export.space.joints import coordinates, model_joints
from mocap_id.workflows.export.space.model import parts_of_model
from mocap_id.workflows.run_folder import RunFolder


def model_motion(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_angles.mot`` with a column for each coordinate of the exported model, degrees and m."""
    found = parts_of_model(run)
    if isinstance(found, str):
        return ExportFiles(notes=(f"mot: no coordinates of a model: {found}",))
    skeleton, poses = found
    rows = list(coordinates(model_joints(skeleton, poses)))
    values = np.column_stack([np.degrees(values) if is_angle else values for _, values, is_angle in rows])
    names = [name for name, _, _ in rows]
    return sampled(angles_file(run), "coordinates of the model", names, values, time=poses.time, in_degrees=True)


def joint_angles(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_joint_angles.mot`` with the angles of ``angles.parquet``, degrees."""
    table = run.table("angles.parquet")
    found = None if table is None else SpatialAngles.from_table(table)
    if found is None or not found.names:
        return ExportFiles(notes=(f"mot: no joint angles: {run.why_missing('angles.parquet')}",))
    values, names = np.degrees(found.mean[..., 0]), tuple(legal(found.names).values())
    return sampled(f"{run.name}_joint_angles.mot", "joint angles", names, values, time=found.time, in_degrees=True)


def states(run: RunFolder) -> ExportFiles:
    """Return no file: OpenSim's states need the speeds of its own coordinates."""
    return ExportFiles(notes=("sto: not for a trial in space: the CSV tables have velocities and accelerations",))
