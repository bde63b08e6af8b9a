"""TRC files of the measured markers and of the markers that the chain predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording import format_trc
from mocap_id.store import LongTable
from mocap_id.workflows.export.files import ExportFiles, measured_file
from mocap_id.workflows.export.names import legal, renamed
from mocap_id.workflows.run_folder import RunFolder


def marker_labels(run: RunFolder) -> dict[str, str]:
    """Return OpenSim's name of each marker that the run uses, by its label."""
    planar = run.long("planar.parquet")
    return {} if planar is None else legal(sorted(planar.labels))


def depths(run: RunFolder) -> dict[str, float]:
    """Return the median distance of each marker from the plane, m; 0 if it was never seen."""
    planar = run.long("planar.parquet")
    if planar is None:
        return {}
    seen = [values[np.isfinite(values)] for values in planar.values["z"].T]
    return {label: float(np.median(z)) if len(z) else 0.0 for label, z in zip(planar.labels, seen, strict=True)}


def predicted_markers(run: RunFolder) -> LongTable | None:
    """Return the markers predicted by the chain, in the plane at their median distance from it; None without them."""
    predicted = run.long("markers.parquet")
    if predicted is None or run.in_space:
        return predicted
    z = np.tile([depths(run)[label] for label in predicted.labels], (len(predicted.frames), 1))
    return replace(predicted, values={**predicted.values, "z": z})


def markers(run: RunFolder) -> ExportFiles:
    """Return TRC files in the plane frame, which has OpenSim's axes: x along the motion, y up, z out of the plane.

    In space they are in the frame of the trial, with y up.

    ``<trial>.trc`` holds the measured markers, blank where a marker was not seen. ``<trial>_model.trc`` holds the
    markers as predicted by the chain at the smoothed angles, at their median distance from the plane.
    """
    planar, predicted = run.long("planar.parquet"), predicted_markers(run)
    if planar is None:
        return ExportFiles(notes=(f"trc: no markers: {run.why_missing('planar.parquet')}",))
    labels = marker_labels(run)
    mirrored = run.facts("planar.parquet").get("side") == "left"
    notes = ("the arm is a left one, mirrored as in the run: z points to the left",) if mirrored else ()
    parts = ExportFiles({measured_file(run): _text(run, planar, measured_file(run))}, (*renamed(labels), *notes))
    if predicted is None:
        return parts + ExportFiles(notes=(f"trc: no modelled markers: {run.why_missing('markers.parquet')}",))
    file = f"{run.name}_model.trc"
    return parts + ExportFiles({file: _text(run, predicted, file)})


def _text(run: RunFolder, table: LongTable, file: str) -> bytes:
    """Return a long table as TRC."""
    points: FloatArray = np.stack([table.values[axis] for axis in "xyz"], axis=2)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    names = marker_labels(run)
    text = format_trc(
        file,
        [names[label] for label in table.labels],
        points,
        time=table.time,
        frames=table.frames,
        rate=float(run.facts("planar.parquet")["rate_hz"]),
    )
    return text.encode()
