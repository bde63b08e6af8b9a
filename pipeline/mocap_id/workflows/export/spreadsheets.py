"""CSV tables with units in their headers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.store import Table
from mocap_id.store.parquet import expand_columns
from mocap_id.store.views import IdentifiedDynamics, Skeleton, SpatialSkeleton
from mocap_id.workflows.export.files import ExportFiles, note_contact
from mocap_id.workflows.run_folder import RunFolder

_SOURCES = {
    "markers": "planar.parquet",
    "states": "states.parquet",
    "angles": "angles.parquet",
    "poses": "poses.parquet",
    "skeleton": "chain.h5",
    "landmarks": "chain.h5",
    "wrench": "wrench.parquet",
}
"""Artefact from which each table is made; the other tables are made from dynamics.h5."""

_STATES = {
    "theta": "angle",
    "dtheta": "velocity",
    "ddtheta": "acceleration",
    "dddtheta": "jerk",
    "sd_theta": "angle sd",
    "sd_dtheta": "velocity sd",
    "sd_ddtheta": "acceleration sd",
    "observed": "observed",
}


def export_tables(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_markers.csv``, and the same for states, dynamics, skeleton, parameters and events.

    A table is omitted if its artefact is missing. Unknown cells are empty.
    """
    tree = run.tree("chain.h5")
    chain = None if tree is None else Skeleton.from_tree(tree)
    tables = {
        "markers": _marker_table(run),
        "states": _state_table(run, chain),
        "dynamics": _dynamics_table(run, chain),
        "skeleton": None if chain is None else _skeleton_table(chain),
        "parameters": parameter_table(run),
        "events": _artefact_table(run, "events.parquet"),
    }
    _add_tables(run, out, tables)
    note_contact(run, out, "csv")
    if (run.facts("dynamics.h5").get("motion") or {}).get("used"):
        out.note(
            "csv: torques and modelled wrench belong to bodies on their measured poses; states and base parameters "
            "belong to the chain"
        )


def export_spatial_tables(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_markers.csv``, and the same for angles, poses, skeleton, landmarks, wrench and parameters.

    A table is omitted if its artefact is missing. Unknown cells are empty.
    """
    tree = run.tree("chain.h5")
    skeleton = None if tree is None else SpatialSkeleton.from_tree(tree)
    tables = {
        "markers": _marker_table(run),
        "angles": _artefact_table(run, "angles.parquet"),
        "poses": _artefact_table(run, "poses.parquet"),
        "skeleton": None if skeleton is None else _spatial_skeleton_table(skeleton),
        "landmarks": None if skeleton is None else _landmark_table(skeleton),
        "wrench": _artefact_table(run, "wrench.parquet"),
        "parameters": parameter_table(run),
    }
    _add_tables(run, out, tables)


def _add_tables(run: RunFolder, out: ExportFiles, tables: Mapping[str, pd.DataFrame | None]) -> None:
    """Add a CSV file for each table; where a table is None, add a note that it is missing."""
    for name, table in tables.items():
        if table is None:
            out.note(f"csv: no {name}: {run.why_missing(_SOURCES.get(name, 'dynamics.h5'))}")
        else:
            out.files[f"{run.name}_{name}.csv"] = table.to_csv(index=False, lineterminator="\n").encode()


def parameter_table(run: RunFolder) -> pd.DataFrame | None:
    """Return the table of the identified base parameters; None if the run has no dynamics.h5."""
    tree = run.tree("dynamics.h5")
    if tree is None:
        return None
    found = IdentifiedDynamics.from_tree(tree)
    verdicts = found.verdicts or ("",) * len(found.names)
    return pd.DataFrame(
        {"base parameter": found.names, "value": found.value, "sd": found.sd, "unit": found.units, "verdict": verdicts}
    )


def _add_unit(name: str, unit: str) -> str:
    """Return the header of a column: its name, with its unit in brackets if it has one."""
    return name if unit in ("", "1") else f"{name} ({unit})"


def _artefact_table(run: RunFolder, file: str) -> pd.DataFrame | None:
    """Return an artefact's table with units in its headers; None if the artefact is missing or is no table."""
    table = run.artefacts.get(file)
    if not isinstance(table, Table):
        return None
    units = _read_units(table)
    return table.frame.rename(columns=lambda name: _add_unit(str(name), units.get(str(name), "")))


def _read_units(table: Table) -> dict[str, str]:
    return {column.name: column.unit for column in expand_columns(table.schema, table.names)}


def _marker_table(run: RunFolder) -> pd.DataFrame | None:
    table = run.long("planar.parquet")
    if table is None:
        return None
    columns: dict[str, Any] = {"frame": table.frames, "time (s)": table.time}
    for k, label in enumerate(table.labels):
        columns |= {f"{label} {axis} (m)": table.values[axis][:, k] for axis in "xyz"}
    return pd.DataFrame(columns)


def _state_table(run: RunFolder, chain: Skeleton | None) -> pd.DataFrame | None:
    table = run.artefacts.get("states.parquet")
    if not isinstance(table, Table) or chain is None:
        return None
    units, columns = _read_units(table), {"time (s)": table["time"]}
    for j, joint in enumerate(chain.joints, start=1):
        for symbol, word in _STATES.items():
            columns[_add_unit(f"{joint} {word}", units[f"{symbol}_{j}"])] = table[f"{symbol}_{j}"]
    return pd.DataFrame(columns)


def _dynamics_table(run: RunFolder, chain: Skeleton | None) -> pd.DataFrame | None:
    """Return wrenches and torques with the joints' names; without dynamics.parquet, only the measured wrench."""
    table = _artefact_table(run, "dynamics.parquet")
    if table is None:
        return _artefact_table(run, "wrench.parquet")
    for j, joint in enumerate(() if chain is None else chain.joints, start=1):
        names = {f"tau_{j} (N*m)": f"{joint} torque (N*m)", f"sd_tau_{j} (N*m)": f"{joint} torque sd (N*m)"}
        table = table.rename(columns=names)
    return table


def _skeleton_table(chain: Skeleton) -> pd.DataFrame:
    """Return a table with a row for each joint; the length is that of the segment that it moves, NaN for the last."""
    lengths, sds = ([*values, float("nan")] for values in (chain.lengths, chain.lengths_sd))
    return pd.DataFrame(
        {
            "joint": chain.joints,
            "in the frame of": [chain.segments[int(parent)] for parent in chain.parents],
            "x (m)": chain.centres[:, 0],
            "y (m)": chain.centres[:, 1],
            "x sd (m)": chain.centre_sd[:, 0],
            "y sd (m)": chain.centre_sd[:, 1],
            "arc (rad)": chain.arc,
            "moves": chain.segments[1:],
            "length (m)": lengths,
            "length sd (m)": sds,
        }
    )


def _spatial_skeleton_table(skeleton: SpatialSkeleton) -> pd.DataFrame:
    """Return a table with one row for each joint; the length is that of the segment that the joint moves."""
    joints = skeleton.chain.joints
    lengths = [skeleton.lengths.get(name, (np.nan, np.nan)) for name in skeleton.segments[1:]]
    columns: dict[str, object] = {
        "joint": skeleton.joints,
        "kind": [joint.kind for joint in joints],
        "in the frame of": [skeleton.segments[joint.parent] for joint in joints],
        "moves": skeleton.segments[1:],
    }
    centre = np.array([joint.centre if joint.known else np.full(3, np.nan) for joint in joints]).reshape(-1, 3)
    variance = np.array([np.diagonal(joint.covariance) for joint in joints]).reshape(-1, 3)
    sd = np.sqrt(np.where((variance >= 0) & np.isfinite(centre), variance, np.nan))
    columns |= {f"{axis} (m)": centre[:, k] for k, axis in enumerate("xyz")}
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


def _landmark_table(skeleton: SpatialSkeleton) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "landmark": skeleton.landmarks,
            "in the frame of": [skeleton.segments[k] for k in skeleton.landmark_segment],
            **{f"{axis} (m)": skeleton.landmark_local[:, k] for k, axis in enumerate("xyz")},
            "sd (m)": skeleton.landmark_sd,
        }
    )
