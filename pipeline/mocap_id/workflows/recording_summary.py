"""Summary of a recording's content."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.errors import RecordingError
from mocap_id.plates.choice import GRAVITY
from mocap_id.recording import read
from mocap_id.recording.model import Recording
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.workflows.study.discovery import find_forces

_TEXTS = (".csv", ".txt", ".tsv")  # endings of files that may be skeletons


def read_content(file: Path, forces: Path | None = None, **options: Any) -> Recording:
    """Read the files that `mocap-id run` would use: also the MOT file beside a text file, and skeletons.

    ``options`` are those of :func:`mocap_id.recording.read` and :func:`mocap_id.recording.skeleton_log.read_skeleton`.
    Raises the errors of these functions.
    """
    found = find_forces(file, file.parent.iterdir()) if forces is None and file.is_file() else None
    try:
        content = read(file, forces or found, **options, unit_required=False)
    except RecordingError as error:
        if file.suffix.lower() not in _TEXTS:
            raise
        try:
            units, vertical = options.get("units"), options.get("vertical")
            return read_skeleton(file, units=units, vertical=vertical).recording
        except RecordingError as other:
            raise RecordingError(f"{error}. As a skeleton it cannot be read either: {other}") from error
    note = (
        () if found is None else (f"the forces are from {found.name}, which is beside it; `mocap-id run` uses it too",)
    )
    return replace(content, oddities=(*note, *content.oddities))


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Return a summary of a recording as JSON values; None for an unknown quantity.

    ``mass_kg`` is the mean upward force divided by gravity: for one plate, or for all plates together.
    """
    loaded = [plate for plate in recording.plates if plate.usable and plate.ok.any()]
    total = sum(plate.mean_vertical() for plate in loaded)
    plates = []
    for plate in recording.plates:
        force, number = plate.mean_vertical() if plate.usable else float("nan"), plate.kind.removeprefix("type ")
        entry = {
            "index": plate.index,
            "type": int(number) if number.isdigit() else plate.kind,
            "mean_fz_N": force if np.isfinite(force) else None,
            "mass_kg": force / GRAVITY if np.isfinite(force) else None,
            "problem": plate.problem or None,
        }
        plates.append(entry)
    return {
        "file": ", ".join(str(path) for path in recording.files),
        "format": recording.format,
        "frames": len(recording.frames),
        "first_frame": int(recording.frames[0]),
        "rate_hz": recording.rate,
        "duration_s": float(recording.time[-1] - recording.time[0]),
        "markers": list(recording.labels),
        "missing_fraction": recording.missing_fraction,
        "units": recording.units or None,
        "vertical": recording.vertical,
        "analog_rate_hz": recording.analog_rate,
        "plates": plates,
        "mass_kg": total / GRAVITY if loaded else None,
        "oddities": [*recording.oddities, *(f"{each}: they were left out" for each in recording.held)],
    }
