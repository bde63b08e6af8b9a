"""File of Kinetics Toolkit, ``<trial>.ktk.zip``: markers and tables of a run as TimeSeries."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.recording.ktk_file import CLASS, POINTS, SERIES
from mocap_id.store import LongTable, Table
from mocap_id.store.parquet import expand_columns
from mocap_id.workflows.export.files import ExportFiles
from mocap_id.workflows.export.markers import read_predicted_markers
from mocap_id.workflows.run_folder import RunFolder

_TABLES = {
    "States": "states.parquet",
    "Angles": "angles.parquet",
    "Dynamics": "dynamics.parquet",
    "Wrench": "wrench.parquet",
}
_DATE = (1980, 1, 1, 0, 0, 0)  # date of every file in the archive, so that the same run always gives the same bytes


def export_kinetics_toolkit(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.ktk.zip``, which ``ktk.load`` reads as a dictionary of TimeSeries.

    ``Points`` and ``ModelPoints`` are the measured and the predicted markers, m, in the plane frame, or for a trial in
    space in the frame of the trial (y up). ``States``, ``Angles``, ``Dynamics`` and ``Wrench`` contain the columns of
    the artefacts with these names.
    """
    content: dict[str, Any] = {}
    for name, table in ((POINTS, run.long("planar.parquet")), ("ModelPoints", read_predicted_markers(run))):
        if table is not None and len(table.labels):
            content[name] = _format_points(table)
    for name, file in _TABLES.items():
        columns = run.table(file)
        if columns is not None and columns.length and columns.names != ["time"]:
            content[name] = _format_columns(columns)
    if not content:
        return ExportFiles(notes=(f"ktk: nothing to write: {run.why_missing('planar.parquet')}",))
    missing = [f"ktk: no {name}: {run.why_missing(file)}" for name, file in _TABLES.items() if name not in content]
    about = {"Software": "mocap-id", "Version": __version__, "FileFormat": 1.0}
    return ExportFiles({f"{run.name}.ktk.zip": _zip_content(about, content)}, tuple(missing))


def _format_points(table: LongTable) -> dict[str, Any]:
    """Return the markers as a TimeSeries of points (T, 4), whose last column is 1."""
    positions = np.stack([*(table.values[axis] for axis in "xyz"), np.ones(table.values["x"].shape)], axis=2)
    data = {str(label): positions[:, k].tolist() for k, label in enumerate(table.labels)}
    return _format_series(table.time.tolist(), data, dict.fromkeys(data, "m"))


def _format_columns(table: Table) -> dict[str, Any]:
    units = {column.name: column.unit for column in expand_columns(table.schema, table.names)}
    numbers = {name: table[name] for name in table.names if name != "time" and table[name].dtype.kind in "fiub"}
    data = {name: values.astype(np.float64).tolist() for name, values in numbers.items()}
    return _format_series(table["time"].tolist(), data, {name: units[name] for name in data if units.get(name)})


def _format_series(time: list[float], data: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    info = {"Time": {"Unit": "s"}, **{name: {"Unit": unit} for name, unit in units.items()}}
    return {CLASS: SERIES, "time": time, "info": info, "data": data, "events": []}


def _zip_content(about: Mapping[str, Any], content: Mapping[str, Any]) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in (("metadata.json", about), ("data.json", content)):
            archive.writestr(zipfile.ZipInfo(name, _DATE), json.dumps(value), zipfile.ZIP_DEFLATED)
    return made.getvalue()
