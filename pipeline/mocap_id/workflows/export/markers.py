"""TRC files: the markers as they were measured, and as the chain places them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording import trc_text
from mocap_id.store import LongTable
from mocap_id.workflows.export.names import legal, renamed
from mocap_id.workflows.export.parts import Parts
from mocap_id.workflows.run_folder import RunFolder


def measured_file(run: RunFolder) -> str:
    """Name of the measured markers' file."""
    return f"{run.name}.trc"


def marker_labels(run: RunFolder) -> dict[str, str]:
    """OpenSim's names of all markers of the recording."""
    planar = run.long("planar.parquet")
    return {} if planar is None else legal(sorted(planar.labels))


def depths(run: RunFolder) -> dict[str, float]:
    """How far each marker is out of the plane, m: the median; 0 where it was never seen."""
    planar = run.long("planar.parquet")
    if planar is None:
        return {}
    seen = [values[np.isfinite(values)] for values in planar.values["z"].T]
    return {label: float(np.median(z)) if len(z) else 0.0 for label, z in zip(planar.labels, seen, strict=True)}


def markers(run: RunFolder) -> Parts:
    """TRC files in the plane frame, which is OpenSim's: x along the motion, y up, z out of the plane.

    ``<trial>.trc`` holds what was measured, blank where a marker was not seen. ``<trial>_model.trc`` holds where the
    recovered chain, at the smoothed angles, places the markers of its segments, at their median distance from the
    plane.
    """
    planar, predicted = run.long("planar.parquet"), run.long("markers.parquet")
    if planar is None:
        return Parts(notes=(f"trc: no markers: {run.why_missing('planar.parquet')}",))
    labels = marker_labels(run)
    parts = Parts({measured_file(run): _text(run, planar, measured_file(run))}, renamed(labels))
    if predicted is None:
        return parts + Parts(notes=(f"trc: no modelled markers: {run.why_missing('markers.parquet')}",))
    file = f"{run.name}_model.trc"
    z = np.tile([depths(run)[label] for label in predicted.labels], (len(predicted.frames), 1))
    placed = replace(predicted, values={**predicted.values, "z": z})
    return parts + Parts({file: _text(run, placed, file)})


def _text(run: RunFolder, table: LongTable, file: str) -> bytes:
    """A long table as TRC."""
    points: FloatArray = np.stack([table.values[axis] for axis in "xyz"], axis=2)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    named = marker_labels(run)
    text = trc_text(
        file,
        [named[label] for label in table.labels],
        points,
        time=table.time,
        frames=table.frames,
        rate=float(run.facts("planar.parquet")["rate_hz"]),
    )
    return text.encode()
