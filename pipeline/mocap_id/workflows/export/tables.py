"""Tables of a run: CSV with units in the headers, TRC files of the markers, and the file of Kinetics Toolkit.

First the files in memory, to which every exporter adds its own, and the names of components that OpenSim accepts.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.recording import format_trc
from mocap_id.recording.ktk_file import CLASS, POINTS, SERIES
from mocap_id.store import LongTable, Table
from mocap_id.store.artefacts import IdentifiedDynamics, Skeleton, SpatialSkeleton
from mocap_id.store.parquet import expand_columns
from mocap_id.workflows.run_folder import RunFolder

MODEL, FREE_MODEL = ".osim", "_free.osim"
MEASURED_MARKERS, ANGLES, FREE_POSES = ".trc", "_angles.mot", "_free_poses.mot"
TORQUES, FORCES, LOADS = "_torques.sto", "_grf.mot", "_external_loads.xml"

BASE = "base"  # name of the joint that connects the base segment to the ground

_ILLEGAL = re.compile(r"[^A-Za-z0-9_.\-]+")


@dataclass
class ExportFiles:
    """The files of an export, to which every exporter adds its own.

    An exporter is a function of a run and of these files. What it cannot make is a note.
    """

    files: dict[str, bytes] = field(default_factory=dict)  # contents by file name
    notes: list[str] = field(default_factory=list)  # on missing content and on assumptions, each once

    def note(self, *notes: str) -> None:
        """Add notes, unless they are known."""
        self.notes += [one for one in dict.fromkeys(notes) if one not in self.notes]


def note_contact(run: RunFolder, out: ExportFiles, file_format: str) -> None:
    """Note that torques are unknown while an unmeasured support carries the body; nothing without contact."""
    table = run.table("dynamics.parquet")
    if table is not None and "contact" in table.names and table["contact"].any():
        out.note(
            f"{file_format}: a chair or support that no plate measures carries, or may carry, the body in "
            f"{100 * table['contact'].mean():.0f} % of the samples (column `contact` of dynamics.parquet). The torques "
            "of the joints below it are unknown there: do not interpolate them"
        )


def make_legal(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """Return for each name a unique name with only letters, digits, ``_``, ``.`` and ``-``, as OpenSim requires.

    The names ``taken`` are not used.

    >>> make_legal(["joint 1", "joint/1", "hip"])
    {'joint 1': 'joint_1', 'joint/1': 'joint_1_2', 'hip': 'hip'}
    """
    legal: dict[str, str] = {}
    used = set(taken)
    for name in names:
        plain = _ILLEGAL.sub("_", name).strip("_") or "unnamed"
        chosen, number = plain, 2
        while chosen in used:
            chosen, number = f"{plain}_{number}", number + 1
        legal[name] = chosen
        used.add(chosen)
    return legal


def opensim_bodies(segments: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the segments in OpenSim, base first."""
    return tuple(make_legal(segments, taken=("ground",)).values())


def opensim_joints(skeleton: Skeleton | SpatialSkeleton) -> tuple[str, ...]:
    """Return the names of the joints in OpenSim."""
    return tuple(make_legal(skeleton.joints, taken=(BASE,)).values())


def name_coordinates(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the names of the joint angles in OpenSim, such as ``ankle_angle``."""
    return tuple(f"{joint}_angle" for joint in opensim_joints(skeleton))


# CSV tables.

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
    tree, states, dynamics = run.tree("chain.h5"), run.table("states.parquet"), run.table("dynamics.parquet")
    state_table = skeleton_table = None
    torques: dict[str, str] = {}  # names of the torques with those of the joints
    if tree is not None:
        chain = Skeleton(tree)
        for j, joint in enumerate(chain.joints, start=1):
            torques |= {f"tau_{j}": f"{joint} torque", f"sd_tau_{j}": f"{joint} torque sd"}
        # A row for each joint; the length is that of the segment that it moves, NaN for the last.
        lengths, sds = ([*values, float("nan")] for values in (chain.lengths, chain.lengths_sd))
        skeleton_table = pd.DataFrame(
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
        if states is not None:
            units, columns = _read_units(states), {"time (s)": states["time"]}
            for j, joint in enumerate(chain.joints, start=1):
                for symbol, word in _STATES.items():
                    columns[_add_unit(f"{joint} {word}", units[f"{symbol}_{j}"])] = states[f"{symbol}_{j}"]
            state_table = pd.DataFrame(columns)
    tables = {
        "markers": _marker_table(run),
        "states": state_table,
        # Without dynamics.parquet, only the measured wrench.
        "dynamics": _artefact_table(run, "wrench.parquet" if dynamics is None else "dynamics.parquet", torques),
        "skeleton": skeleton_table,
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
    skeleton_table = landmark_table = None
    if tree is not None:
        skeleton = SpatialSkeleton(tree)
        landmarks = {
            "landmark": skeleton.landmarks,
            "in the frame of": [skeleton.segments[k] for k in skeleton.landmark_segment],
            **{f"{axis} (m)": skeleton.landmark_local[:, k] for k, axis in enumerate("xyz")},
            "sd (m)": skeleton.landmark_sd,
        }
        skeleton_table, landmark_table = _spatial_skeleton_table(skeleton), pd.DataFrame(landmarks)
    tables = {
        "markers": _marker_table(run),
        "angles": _artefact_table(run, "angles.parquet"),
        "poses": _artefact_table(run, "poses.parquet"),
        "skeleton": skeleton_table,
        "landmarks": landmark_table,
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
    found = IdentifiedDynamics(tree)
    verdicts = found.verdicts or ("",) * len(found.names)
    return pd.DataFrame(
        {"base parameter": found.names, "value": found.value, "sd": found.sd, "unit": found.units, "verdict": verdicts}
    )


def _add_unit(name: str, unit: str) -> str:
    """Return the header of a column: its name, with its unit in brackets if it has one."""
    return name if unit in ("", "1") else f"{name} ({unit})"


def _artefact_table(run: RunFolder, file: str, names: Mapping[str, str] | None = None) -> pd.DataFrame | None:
    """Return an artefact's table with units in its headers, and other ``names`` of columns; None if it is missing."""
    table = run.table(file)
    if table is None:
        return None
    units, heads = _read_units(table), names or {}
    return table.frame.rename(columns=lambda one: _add_unit(heads.get(str(one), str(one)), units.get(str(one), "")))


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


# Measured markers and the markers that the chain predicts: TRC files, and the file of Kinetics Toolkit.

_KTK_TABLES = {
    "States": "states.parquet",
    "Angles": "angles.parquet",
    "Dynamics": "dynamics.parquet",
    "Wrench": "wrench.parquet",
}
_DATE = (1980, 1, 1, 0, 0, 0)  # date of every file in the archive, so that the same run always gives the same bytes


def rename_markers(run: RunFolder) -> dict[str, str]:
    """Return the name in OpenSim of each marker that the run uses, by its label."""
    planar = run.long("planar.parquet")
    return {} if planar is None else make_legal(sorted(planar.labels))


def measure_depths(run: RunFolder) -> dict[str, float]:
    """Return the median distance of each marker from the plane, m, by its label; 0 if the marker is never visible."""
    planar = run.long("planar.parquet")
    if planar is None:
        return {}
    visible = [values[np.isfinite(values)] for values in planar.values["z"].T]
    return {label: float(np.median(z)) if len(z) else 0.0 for label, z in zip(planar.labels, visible, strict=True)}


def _read_predicted_markers(run: RunFolder) -> LongTable | None:
    """Return the markers that the chain predicts, in the plane at their median distance from it; None without them."""
    predicted = run.long("markers.parquet")
    if predicted is None or run.in_space:
        return predicted
    depths = measure_depths(run)
    z = np.tile([depths[label] for label in predicted.labels], (len(predicted.frames), 1))
    return replace(predicted, values={**predicted.values, "z": z})


def export_markers(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>.trc`` with the measured markers, and ``<trial>_model.trc`` with the predicted markers.

    In the plane, x is along the motion, y up, and z out of the plane, as in OpenSim. In space, the axes are those of
    the trial, with y up. The cells of a measured marker are empty where it was not visible.
    """
    planar, predicted = run.long("planar.parquet"), _read_predicted_markers(run)
    if planar is None:
        out.note(f"trc: no markers: {run.why_missing('planar.parquet')}")
        return
    names, rate = rename_markers(run), float(run.facts("planar.parquet")["rate_hz"])
    changed = [f"{old} → {new}" for old, new in names.items() if old != new]
    if changed:
        out.note(f"names that OpenSim does not accept were changed: {', '.join(changed)}")
    if run.facts("planar.parquet").get("side") == "left":
        out.note("the arm is a left arm, mirrored as in the run: z points to the left")
    if predicted is None:
        out.note(f"trc: no modelled markers: {run.why_missing('markers.parquet')}")
    for table, file in ((planar, run.name + MEASURED_MARKERS), (predicted, f"{run.name}_model.trc")):
        if table is not None:
            points: FloatArray = np.stack([table.values[axis] for axis in "xyz"], axis=2)
            points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
            labels = [names[label] for label in table.labels]
            text = format_trc(file, labels, points, time=table.time, frames=table.frames, rate=rate)
            out.files[file] = text.encode()


def export_kinetics_toolkit(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>.ktk.zip``, which ``ktk.load`` reads as a dictionary of TimeSeries.

    ``Points`` and ``ModelPoints`` are the measured and the predicted markers, m, in the plane frame, or for a trial in
    space in the frame of the trial (y up). ``States``, ``Angles``, ``Dynamics`` and ``Wrench`` contain the columns of
    the artefacts with these names.
    """
    content: dict[str, Any] = {}
    for name, points in ((POINTS, run.long("planar.parquet")), ("ModelPoints", _read_predicted_markers(run))):
        if points is not None and len(points.labels):
            # Points (T, 4), whose last column is 1.
            positions = [*(points.values[axis] for axis in "xyz"), np.ones(points.values["x"].shape)]
            stacked = np.stack(positions, axis=2)
            data = {str(label): stacked[:, k].tolist() for k, label in enumerate(points.labels)}
            content[name] = _format_series(points.time, data, dict.fromkeys(data, "m"))
    for name, file in _KTK_TABLES.items():
        table = run.table(file)
        if table is not None and table.length and table.names != ["time"]:
            units = {column.name: column.unit for column in expand_columns(table.schema, table.names)}
            known = [one for one in table.names if one != "time" and table[one].dtype.kind in "fiub"]
            data = {one: table[one].astype(np.float64).tolist() for one in known}
            content[name] = _format_series(table["time"], data, {one: units[one] for one in data if units.get(one)})
    if not content:
        out.note(f"ktk: nothing to write: {run.why_missing('planar.parquet')}")
        return
    out.note(*(f"ktk: no {name}: {run.why_missing(file)}" for name, file in _KTK_TABLES.items() if name not in content))
    about = {"Software": "mocap-id", "Version": __version__, "FileFormat": 1.0}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in (("metadata.json", about), ("data.json", content)):
            archive.writestr(zipfile.ZipInfo(name, _DATE), json.dumps(value), zipfile.ZIP_DEFLATED)
    out.files[f"{run.name}.ktk.zip"] = made.getvalue()


def _format_series(time: FloatArray, data: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    info = {"Time": {"Unit": "s"}, **{name: {"Unit": unit} for name, unit in units.items()}}
    return {CLASS: SERIES, "time": time.tolist(), "info": info, "data": data, "events": []}
