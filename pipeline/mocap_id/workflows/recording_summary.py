"""Summary of a recording's content."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.plates import GRAVITY
from mocap_id.recording.model import Plate, Recording


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Return a summary of a recording as JSON values; None for an unknown quantity.

    ``mass_kg`` is the mean upward force divided by gravity: for one plate, or for all plates together.
    """
    total = sum(plate.mean_vertical() for plate in recording.plates if plate.usable and plate.ok.any())
    loaded = any(plate.usable and plate.ok.any() for plate in recording.plates)
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
        "plates": [_describe_plate(plate) for plate in recording.plates],
        "mass_kg": total / GRAVITY if loaded else None,
        "oddities": [*recording.oddities, *(f"{each}: they were left out" for each in recording.held)],
    }


def _describe_plate(plate: Plate) -> dict[str, Any]:
    force = plate.mean_vertical() if plate.usable else float("nan")
    number = plate.kind.removeprefix("type ")
    return {
        "index": plate.index,
        "type": int(number) if number.isdigit() else plate.kind,
        "mean_fz_N": force if np.isfinite(force) else None,
        "mass_kg": force / GRAVITY if np.isfinite(force) else None,
        "problem": plate.problem or None,
    }
