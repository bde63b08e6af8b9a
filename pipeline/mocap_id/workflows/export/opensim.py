"""The OpenSim model, with set-up files for its inverse kinematics and dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.store.views import Skeleton
from mocap_id.workflows.export.files import ExportFiles, angles_file, loads_file, measured_file, model_file
from mocap_id.workflows.export.inertia import bodies
from mocap_id.workflows.export.markers import marker_labels
from mocap_id.workflows.export.model import model
from mocap_id.workflows.export.names import legal
from mocap_id.workflows.export.xml import document, element, numbers
from mocap_id.workflows.run_folder import RunFolder

_ACCURACY = "1e-8"
"""OpenSim's default of 1e-5 stops 0.2° rms, at worst 0.8°, before the least-squares solution."""


def opensim(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.osim``, ``<trial>_ik.xml`` and ``<trial>_id.xml``."""
    tree = run.tree("chain.h5")
    if tree is None:
        return ExportFiles(notes=(f"osim: no model: {run.why_missing('chain.h5')}",))
    skeleton = Skeleton.from_tree(tree)
    inertia = bodies(run, len(skeleton.segments))
    files = {
        model_file(run): model(run, skeleton, inertia),
        f"{run.name}_ik.xml": kinematics_setup(run, skeleton.markers),
    }
    if run.table("states.parquet") is not None and inertia.known:
        files[f"{run.name}_id.xml"] = _dynamics(run)
    return ExportFiles(files, (f"osim: inertial parameters: {inertia.source}",))


def kinematics_setup(run: RunFolder, markers: Sequence[str]) -> bytes:
    """Return the set-up of inverse kinematics, with equal weights for all markers of the chain."""
    labels = marker_labels(run)
    tasks = [
        element("IKMarkerTask", name=labels.get(label, label), children=[element("weight", text="1")])
        for label in markers
    ]
    children = [
        element("model_file", text=model_file(run)),
        element("IKTaskSet", children=[element("objects", children=tasks)]),
        element("marker_file", text=measured_file(run)),
        element("accuracy", text=_ACCURACY),
        element("time_range", text=numbers(_span(run))),  # without it, OpenSim stops after two seconds
        element("output_motion_file", text=f"{run.name}_opensim_ik.mot"),
    ]
    return document(element("InverseKinematicsTool", name=legal([run.name])[run.name], children=children))


def _span(run: RunFolder) -> tuple[float, float]:
    """Return the first and last time of the markers, s."""
    planar = run.long("planar.parquet")
    assert planar is not None
    return float(planar.time[0]), float(planar.time[-1])


def _dynamics(run: RunFolder) -> bytes:
    """Return the set-up of inverse dynamics for our angles and the measured forces, if any."""
    table = run.table("wrench.parquet")
    forces = table is not None and bool(np.isfinite(table["Fy"]).any())
    children = [
        element("model_file", text=model_file(run)),
        element("coordinates_file", text=angles_file(run)),
        element("output_gen_force_file", text=f"{run.name}_opensim_id.sto"),
    ]
    if forces:
        children.append(element("external_loads_file", text=loads_file(run)))
    return document(element("InverseDynamicsTool", name=legal([run.name])[run.name], children=children))
