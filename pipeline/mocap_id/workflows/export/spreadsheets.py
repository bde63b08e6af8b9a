"""CSV tables with units in their headers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.store import Table
from mocap_id.store.parquet import columns_of
from mocap_id.store.views import IdentifiedDynamics, Skeleton
from mocap_id.workflows.export.files import ExportFiles
from mocap_id.workflows.run_folder import RunFolder

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


def spreadsheets(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_markers.csv``, and likewise states, dynamics, skeleton, parameters and events.

    A table is omitted if its artefact is missing. Unknown cells are empty.
    """
    tables = {
        "markers": marker_table(run),
        "states": _states(run),
        "dynamics": _dynamics(run),
        "skeleton": _skeleton(run),
        "parameters": parameter_table(run),
        "events": artefact_table(run, "events.parquet"),
    }
    sources = {"markers": "planar.parquet", "states": "states.parquet", "skeleton": "chain.h5"}
    found = csv_files(run, tables, sources)
    if (run.facts("dynamics.h5").get("motion") or {}).get("used"):
        note = (
            "csv: torques and modelled wrench are those of bodies on their measured poses; states and base parameters "
            "are those of the chain"
        )
        return found + ExportFiles(notes=(note,))
    return found


def csv_files(run: RunFolder, tables: Mapping[str, pd.DataFrame | None], sources: Mapping[str, str]) -> ExportFiles:
    """Return a file for each table, and a note for each missing one; other sources than these are dynamics.h5."""
    files = {
        f"{run.name}_{name}.csv": table.to_csv(index=False, lineterminator="\n").encode()
        for name, table in tables.items()
        if table is not None
    }
    missing = [name for name, table in tables.items() if table is None]
    return ExportFiles(
        files, tuple(f"csv: no {name}: {run.why_missing(sources.get(name, 'dynamics.h5'))}" for name in missing)
    )


def headed(name: str, unit: str) -> str:
    """Return the header of a column: its name with its unit."""
    return name if unit in ("", "1") else f"{name} ({unit})"


def artefact_table(run: RunFolder, file: str) -> pd.DataFrame | None:
    """Return an artefact's table with units in its headers."""
    table = run.artefacts.get(file)
    if not isinstance(table, Table):
        return None
    units = _units(table)
    return table.frame.rename(columns=lambda name: headed(str(name), units.get(str(name), "")))


def _units(table: Table) -> dict[str, str]:
    return {column.name: column.unit for column in columns_of(table.schema, table.names)}


def marker_table(run: RunFolder) -> pd.DataFrame | None:
    """Return the measured markers; None without them."""
    table = run.long("planar.parquet")
    if table is None:
        return None
    columns: dict[str, Any] = {"frame": table.frames, "time (s)": table.time}
    for k, label in enumerate(table.labels):
        columns |= {f"{label} {axis} (m)": table.values[axis][:, k] for axis in "xyz"}
    return pd.DataFrame(columns)


def _states(run: RunFolder) -> pd.DataFrame | None:
    table, tree = run.artefacts.get("states.parquet"), run.tree("chain.h5")
    if not isinstance(table, Table) or tree is None:
        return None
    units, columns = _units(table), {"time (s)": table["time"]}
    for j, joint in enumerate(Skeleton.from_tree(tree).joints, start=1):
        for symbol, word in _STATES.items():
            columns[headed(f"{joint} {word}", units[f"{symbol}_{j}"])] = table[f"{symbol}_{j}"]
    return pd.DataFrame(columns)


def _dynamics(run: RunFolder) -> pd.DataFrame | None:
    """Return wrenches and torques with the joints' names, or only the measured wrench if there is no dynamics."""
    found = artefact_table(run, "dynamics.parquet")
    if found is None:
        return artefact_table(run, "wrench.parquet")
    tree = run.tree("chain.h5")
    joints = () if tree is None else Skeleton.from_tree(tree).joints
    for j, joint in enumerate(joints, start=1):
        names = {f"tau_{j} (N*m)": f"{joint} torque (N*m)", f"sd_tau_{j} (N*m)": f"{joint} torque sd (N*m)"}
        found = found.rename(columns=names)
    return found


def _skeleton(run: RunFolder) -> pd.DataFrame | None:
    """Return a row for each joint; the length is that of the segment that it moves (unknown for the last)."""
    tree = run.tree("chain.h5")
    if tree is None:
        return None
    chain = Skeleton.from_tree(tree)
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


def parameter_table(run: RunFolder) -> pd.DataFrame | None:
    """Return the identified base parameters; None without them."""
    tree = run.tree("dynamics.h5")
    if tree is None:
        return None
    found = IdentifiedDynamics.from_tree(tree)
    verdicts = found.verdicts or ("",) * len(found.names)
    return pd.DataFrame(
        {"base parameter": found.names, "value": found.value, "sd": found.sd, "unit": found.units, "verdict": verdicts}
    )
