"""Measured markers and the markers that the chain predicts: TRC files, and the file of Kinetics Toolkit."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.recording import format_trc
from mocap_id.recording.ktk_file import CLASS, POINTS, SERIES
from mocap_id.store import LongTable
from mocap_id.store.parquet import expand_columns
from mocap_id.workflows.export.files import MEASURED_MARKERS, ExportFiles, make_legal
from mocap_id.workflows.run_folder import RunFolder

_TABLES = {
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
    for name, file in _TABLES.items():
        table = run.table(file)
        if table is not None and table.length and table.names != ["time"]:
            units = {column.name: column.unit for column in expand_columns(table.schema, table.names)}
            known = [one for one in table.names if one != "time" and table[one].dtype.kind in "fiub"]
            data = {one: table[one].astype(np.float64).tolist() for one in known}
            content[name] = _format_series(table["time"], data, {one: units[one] for one in data if units.get(one)})
    if not content:
        out.note(f"ktk: nothing to write: {run.why_missing('planar.parquet')}")
        return
    out.note(*(f"ktk: no {name}: {run.why_missing(file)}" for name, file in _TABLES.items() if name not in content))
    about = {"Software": "mocap-id", "Version": __version__, "FileFormat": 1.0}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in (("metadata.json", about), ("data.json", content)):
            archive.writestr(zipfile.ZipInfo(name, _DATE), json.dumps(value), zipfile.ZIP_DEFLATED)
    out.files[f"{run.name}.ktk.zip"] = made.getvalue()


def _format_series(time: FloatArray, data: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    info = {"Time": {"Unit": "s"}, **{name: {"Unit": unit} for name, unit in units.items()}}
    return {CLASS: SERIES, "time": time.tolist(), "info": info, "data": data, "events": []}
