"""What is known of a robot trial beforehand: the truth beside a simulated recording, and the labels of its cell."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

_FASTER = 0.375  # Hz: half-way between the thesis's speeds


@dataclass(frozen=True)
class Truth:
    """The exact states and the encoder's clock of a simulated trial.

    Parameters
    ----------
    told : mapping
        truth.json.
    time : (T,) array
        s, the recording's clock.
    states : (T, 3) array
        Angle, velocity and acceleration of the joint, rad.
    """

    told: Mapping[str, Any]
    time: FloatArray
    states: FloatArray

    def at(self, time: FloatArray) -> FloatArray:
        """States (N, 3) at frames of the recording; NaN beyond them."""
        nearest = np.clip(np.searchsorted(self.time, time - 0.5 * self._step), 0, len(self.time) - 1)
        known = np.abs(self.time[nearest] - time) < 0.5 * self._step
        return np.where(known[:, None], self.states[nearest], np.nan)

    @property
    def _step(self) -> float:
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True)
class Labels:
    """The cell of the tables that a trial belongs to; unknown ones are empty or None."""

    joint: str = ""
    speed: str = ""
    orientation: float | None = None

    def over(self, other: Labels) -> Labels:
        """These, and the other's where these are unknown."""
        orientation = other.orientation if self.orientation is None else self.orientation
        return Labels(self.joint or other.joint, self.speed or other.speed, orientation)


def truth_beside(recording: Path) -> Truth | None:
    """truth.json and truth.npz beside a recording; None where there are none.

    Raises
    ------
    RecordingError
        They are there and cannot be read.
    """
    file, arrays = recording.parent / "truth.json", recording.parent / "truth.npz"
    if not (file.exists() and arrays.exists()):
        return None
    try:
        told = json.loads(file.read_text("utf-8"))
        with np.load(arrays) as held:
            states = np.column_stack([held[name][:, 0] for name in ("q", "qd", "qdd")]).astype(np.float64)
            return Truth(told, np.asarray(held["t"], dtype=np.float64), states)
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise RecordingError(f"{file}: not the truth of a simulated trial ({error}); take it away") from None


def labels_of(truth: Truth | None) -> Labels:
    """What the truth tells of the cell."""
    if truth is None:
        return Labels()
    frequency = truth.told.get("freq_hz")
    speed = "" if frequency is None else "fast" if frequency > _FASTER else "slow"
    yaw = truth.told.get("robot_yaw_deg")
    return Labels(str(truth.told.get("joint") or ""), speed, None if yaw is None else float(yaw))


def reference_of(truth: Truth | None) -> dict[str, float]:
    """The true parameters as a study's `reference` names them."""
    if truth is None:
        return {}
    names, parameters = ("mass", "mx1", "mx2", "my2", "Izz2"), truth.told["base_parameters"]["values"]
    found = dict(zip(names, map(float, parameters), strict=True))
    lengths = truth.told.get("segment_lengths_m", {})
    return found | ({"base": float(lengths["l1"])} if "l1" in lengths else {})
