"""The truth of a simulated robot trial, and the cell of the thesis's tables that a trial belongs to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

PARAMETERS = ("mass", "mx1", "mx2", "my2", "Izz2")
"""Names of the base parameters of one joint."""
_FAST = 0.375  # Hz: the mean of the thesis's two speeds


@dataclass(frozen=True)
class Truth:
    """The exact states and the encoder's clock of a simulated trial."""

    document: Mapping[str, Any]  # content of truth.json
    time: FloatArray  # (T,) times of the frames on the recording's clock, s
    states: FloatArray  # (T, 3) angle, velocity and acceleration of the joint, rad, rad/s, rad/s²

    def at(self, time: FloatArray) -> FloatArray:
        """Return the states (N, 3) at times (N,) of frames, s; NaN for a time without a frame."""
        step = float(np.median(np.diff(self.time)))
        nearest = np.clip(np.searchsorted(self.time, time - 0.5 * step), 0, len(self.time) - 1)
        known = np.abs(self.time[nearest] - time) < 0.5 * step
        return np.where(known[:, None], self.states[nearest], np.nan)


@dataclass(frozen=True)
class Labels:
    """The cell of the thesis's tables that a trial belongs to; an unknown label is empty or None."""

    joint: str = ""
    speed: str = ""
    orientation: float | None = None

    def completed_by(self, other: Labels) -> Labels:
        """Return these labels; an unknown label is replaced by the label of ``other``."""
        orientation = other.orientation if self.orientation is None else self.orientation
        return Labels(self.joint or other.joint, self.speed or other.speed, orientation)


def read_truth(recording: Path) -> Truth | None:
    """Read truth.json and truth.npz beside a recording; None if one of them is missing.

    Raises
    ------
    RecordingError
        The files exist but cannot be read.
    """
    file, arrays = recording.parent / "truth.json", recording.parent / "truth.npz"
    if not (file.exists() and arrays.exists()):
        return None
    try:
        document = json.loads(file.read_text("utf-8"))
        with np.load(arrays) as data:
            states = np.column_stack([data[name][:, 0] for name in ("q", "qd", "qdd")]).astype(np.float64)
            return Truth(document, np.asarray(data["t"], dtype=np.float64), states)
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise RecordingError(f"{file}: the file is not the truth of a simulated trial ({error}); remove it") from None


def read_labels(truth: Truth | None) -> Labels:
    """Return the labels in truth.json; all labels are unknown if there is no truth."""
    if truth is None:
        return Labels()
    frequency = truth.document.get("freq_hz")
    speed = "" if frequency is None else "fast" if frequency > _FAST else "slow"
    yaw = truth.document.get("robot_yaw_deg")
    return Labels(str(truth.document.get("joint") or ""), speed, None if yaw is None else float(yaw))


def read_reference(truth: Truth | None) -> dict[str, float]:
    """Return the true parameters, named as in the `reference` of a study's file; empty if there is no truth."""
    if truth is None:
        return {}
    parameters = dict(zip(PARAMETERS, map(float, truth.document["base_parameters"]["values"]), strict=True))
    lengths = truth.document.get("segment_lengths_m", {})
    return parameters | ({"base": float(lengths["l1"])} if "l1" in lengths else {})
