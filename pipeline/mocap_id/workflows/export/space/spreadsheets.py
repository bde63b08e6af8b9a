"""CSV tables of a trial in space, with units in their headers."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.store.spatial_views import SpatialSkeleton
from mocap_id.workflows.export.files import ExportFiles
from mocap_id.workflows.export.spreadsheets import artefact_table, csv_files, marker_table, parameter_table
from mocap_id.workflows.run_folder import RunFolder

_SOURCES = {
    "markers": "planar.parquet",
    "angles": "angles.parquet",
    "poses": "poses.parquet",
    "skeleton": "chain.h5",
    "landmarks": "chain.h5",
    "wrench": "wrench.parquet",
    "parameters": "dynamics.h5",
}


def spreadsheets(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_markers.csv``, and likewise angles, poses, skeleton, landmarks, wrench and parameters.

    A table is omitted if its artefact is missing. Unknown cells are empty.
    """
    tables = {
        "markers": marker_table(run),
        "angles": artefact_table(run, "angles.parquet"),
        "poses": artefact_table(run, "poses.parquet"),
        "skeleton": _skeleton(run),
        "landmarks": _landmarks(run),
        "wrench": artefact_table(run, "wrench.parquet"),
        "parameters": parameter_table(run),
    }
    return csv_files(run, tables, _SOURCES)


def _skeleton(run: RunFolder) -> pd.DataFrame | None:
    """Return a row for each joint; the length is that of the segment that it moves."""
    tree = run.tree("chain.h5")
    if tree is None:
        return None
    skeleton = SpatialSkeleton.from_tree(tree)
    joints = skeleton.chain.joints
    nothing = (np.nan, np.nan)
    lengths = [skeleton.lengths.get(name, nothing) for name in skeleton.segments[1:]]
    columns: dict[str, object] = {
        "joint": skeleton.joints,
        "kind": [joint.kind for joint in joints],
        "in the frame of": [skeleton.segments[joint.parent] for joint in joints],
        "moves": skeleton.segments[1:],
    }
    shown = np.array([joint.centre if joint.known else np.full(3, np.nan) for joint in joints]).reshape(-1, 3)
    variance = np.array([np.diagonal(joint.covariance) for joint in joints]).reshape(-1, 3)
    sd = np.sqrt(np.where((variance >= 0) & np.isfinite(shown), variance, np.nan))
    columns |= {f"{axis} (m)": shown[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"{axis} sd (m)": sd[:, k] for k, axis in enumerate("xyz")}
    for number, kinds in ((1, ("hinge", "two-axis")), (2, ("two-axis",))):
        axes = [(joint.first_axis, joint.second_axis)[number - 1] for joint in joints]
        has = [joint.kind in kinds for joint in joints]
        columns |= {
            f"axis {number} {name}": [axis[k] if one else np.nan for axis, one in zip(axes, has, strict=True)]
            for k, name in enumerate("xyz")
        }
    columns |= {f"glide {axis} (m)": [joint.glide[k] for joint in joints] for k, axis in enumerate("xyz")}
    columns |= {"arc (rad)": skeleton.arc}
    columns |= {"length (m)": [value for value, _ in lengths], "length sd (m)": [each for _, each in lengths]}
    return pd.DataFrame(columns)


def _landmarks(run: RunFolder) -> pd.DataFrame | None:
    tree = run.tree("chain.h5")
    if tree is None:
        return None
    skeleton = SpatialSkeleton.from_tree(tree)
    return pd.DataFrame(
        {
            "landmark": skeleton.landmarks,
            "in the frame of": [skeleton.segments[k] for k in skeleton.landmark_segment],
            **{f"{axis} (m)": skeleton.landmark_local[:, k] for k, axis in enumerate("xyz")},
            "sd (m)": skeleton.landmark_sd,
        }
    )
