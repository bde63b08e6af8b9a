"""TRC files: the markers as they were measured, and as the chain places them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.recording import trc_text
from mocap_id.workflows.export.names import legal, renamed
from mocap_id.workflows.export.parts import Parts
from mocap_id.workflows.run_folder import RunFolder


def measured_file(run: RunFolder) -> str:
    """Name of the measured markers' file."""
    return f"{run.name}.trc"


def marker_labels(run: RunFolder) -> dict[str, str]:
    """OpenSim's names of all markers of the recording."""
    frame = run.frame("planar.parquet")
    return {} if frame is None else legal(map(str, frame["marker"].cat.categories))


def depths(run: RunFolder) -> dict[str, float]:
    """How far each marker is out of the plane, m: the median; 0 where it was never seen."""
    frame = run.frame("planar.parquet")
    if frame is None:
        return {}
    middle = frame.groupby("marker", observed=False)["z"].median().fillna(0.0)
    return {str(label): float(z) for label, z in middle.items()}


def markers(run: RunFolder) -> Parts:
    """TRC files in the plane frame, which is OpenSim's: x along the motion, y up, z out of the plane.

    ``<trial>.trc`` holds what was measured, blank where a marker was not seen. ``<trial>_model.trc`` holds where the
    recovered chain, at the smoothed angles, places the markers of its segments, at their median distance from the
    plane.
    """
    planar, predicted = run.frame("planar.parquet"), run.frame("markers.parquet")
    if planar is None:
        return Parts(notes=(f"trc: no markers: {run.why_missing('planar.parquet')}",))
    labels = marker_labels(run)
    parts = Parts({measured_file(run): _text(run, planar, measured_file(run))}, renamed(labels))
    if predicted is None:
        return parts + Parts(notes=(f"trc: no modelled markers: {run.why_missing('markers.parquet')}",))
    file = f"{run.name}_model.trc"
    placed = predicted.assign(z=predicted["marker"].astype(str).map(depths(run)))
    return parts + Parts({file: _text(run, placed, file)})


def _text(run: RunFolder, frame: pd.DataFrame, file: str) -> bytes:
    """A long table, sorted by frame then marker, as TRC."""
    labels = [str(label) for label in frame["marker"].iloc[: frame["marker"].nunique()]]
    count = len(labels)
    points: FloatArray = frame[["x", "y", "z"]].to_numpy(dtype=np.float64).reshape(-1, count, 3)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    named = marker_labels(run)
    text = trc_text(
        file,
        [named[label] for label in labels],
        points,
        time=frame["time"].to_numpy(dtype=np.float64)[::count],
        frames=frame["frame"].to_numpy(dtype=np.int64)[::count],
        rate=float(run.facts("planar.parquet")["rate_hz"]),
    )
    return text.encode()
