"""TRC files of the measured markers and of the markers that the chain predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording import format_trc
from mocap_id.store import LongTable
from mocap_id.workflows.export.files import MEASURED_MARKERS, ExportFiles, make_legal, note_changed_names
from mocap_id.workflows.run_folder import RunFolder


def name_markers(run: RunFolder) -> dict[str, str]:
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


def read_predicted_markers(run: RunFolder) -> LongTable | None:
    """Return the markers that the chain predicts; None if they are missing.

    In the plane, each has its median distance from the plane as z.
    """
    predicted = run.long("markers.parquet")
    if predicted is None or run.in_space:
        return predicted
    depths = measure_depths(run)
    z = np.tile([depths[label] for label in predicted.labels], (len(predicted.frames), 1))
    return replace(predicted, values={**predicted.values, "z": z})


def export_markers(run: RunFolder) -> ExportFiles:
    """Return ``<trial>.trc`` with the measured markers, and ``<trial>_model.trc`` with the predicted markers.

    In the plane, x is along the motion, y up, and z out of the plane, as in OpenSim. In space, the axes are those of
    the trial, with y up. The cells of a measured marker are empty where it was not visible.
    """
    planar, predicted = run.long("planar.parquet"), read_predicted_markers(run)
    if planar is None:
        return ExportFiles(notes=(f"trc: no markers: {run.why_missing('planar.parquet')}",))
    notes = note_changed_names(name_markers(run))
    if run.facts("planar.parquet").get("side") == "left":
        notes = (*notes, "the arm is a left arm, mirrored as in the run: z points to the left")
    parts = _format_markers(run, planar, run.name + MEASURED_MARKERS) + ExportFiles(notes=notes)
    if predicted is None:
        return parts + ExportFiles(notes=(f"trc: no modelled markers: {run.why_missing('markers.parquet')}",))
    return parts + _format_markers(run, predicted, f"{run.name}_model.trc")


def _format_markers(run: RunFolder, table: LongTable, file: str) -> ExportFiles:
    points: FloatArray = np.stack([table.values[axis] for axis in "xyz"], axis=2)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    names = name_markers(run)
    text = format_trc(
        file,
        [names[label] for label in table.labels],
        points,
        time=table.time,
        frames=table.frames,
        rate=float(run.facts("planar.parquet")["rate_hz"]),
    )
    return ExportFiles({file: text.encode()})
