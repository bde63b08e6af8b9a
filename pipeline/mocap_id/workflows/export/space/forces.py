"""Six-component wrench of the ground on the base for OpenSim."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.store.spatial_views import SpatialSkeleton
from mocap_id.workflows.export.files import ExportFiles, forces_file, loads_file
from mocap_id.workflows.export.forces import GROUND, Load, columns_of_load, external_loads
from mocap_id.workflows.export.motions import sampled
from mocap_id.workflows.export.space.joints import ModelBodies
from mocap_id.workflows.run_folder import RunFolder

_WRENCH = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")


def forces(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_grf.mot`` and ``<trial>_external_loads.xml``, in the frame of the trial."""
    tables = (run.table("dynamics.parquet"), run.table("wrench.parquet"))
    table = next((one for one in tables if one is not None and set(_WRENCH) <= set(one.names)), None)
    if table is None or not np.isfinite(table.stack(_WRENCH)).all(axis=1).any():
        why = run.facts("wrench.parquet").get("why") or run.why_missing("wrench.parquet")
        return ExportFiles(notes=(f"mot: no forces: {why}",))
    wrench = table.stack(_WRENCH)
    threshold = float(run.facts("wrench.parquet").get("cop_threshold_N") or 0.0)
    title = "forces of the surroundings on the body"
    made = sampled(forces_file(run), title, columns_of_load(GROUND), acting(wrench, threshold), time=table["time"])
    tree = run.tree("chain.h5")
    if tree is None:
        return made
    bodies = ModelBodies.of(SpatialSkeleton.from_tree(tree)).segments
    return made + ExportFiles({loads_file(run): external_loads(run, [Load(GROUND, 0, wrench)], bodies)})


def acting(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return force, point and free moment (T, 9) equivalent to a wrench about the origin (T, 6).

    The point is the centre of pressure on y = 0; where the force does not define it, it is the origin.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.abs(force[:, 1]) > max(threshold, 1e-9)
    divisor = np.where(loaded, force[:, 1], 1.0)
    point = np.zeros_like(force)
    point[:, 0] = np.where(loaded, moment[:, 2] / divisor, 0.0 * moment[:, 2])
    point[:, 2] = np.where(loaded, -moment[:, 0] / divisor, 0.0 * moment[:, 0])
    return np.column_stack([force, point, moment - np.cross(point, force)])
