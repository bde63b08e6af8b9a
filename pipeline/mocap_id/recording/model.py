"""A recording in one form for all file formats: markers, force plates, and notes on oddities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import RecordingError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Plate:
    """Force plate in lab axes (Z up), SI units.

    Sign convention: force and moment are those of the ground on the body, not of the body on the plate.

    Parameters
    ----------
    index : int
        Number in the file, from 1.
    kind : str
        ``"type 1"`` … ``"type 4"`` (C3D) or ``"mot"``.
    corners : (4, 3) array or None
        Corners of the working surface in the lab, m; None if the file does not give them.
    force : (K, 3) array
        Force of the ground on the body, N.
    moment : (K, 3) array
        Moment of the ground on the body about the *lab origin*, N·m.
    ok : (K,) bool array
        Whether every channel is finite and unsaturated.
    rate : float
        Samples per second.
    start : float
        Time of sample 0 on the clock of the recording, s; sample k is at ``start + k / rate``.
    problem : str
        Why the plate cannot be used, or empty; the samples of an unusable plate are NaN.
    assumptions : tuple of str
        Assumptions about the plate that the file does not state and the forces depend on. They are also among the
        oddities of the recording.
    saturated : (K,) bool array or None
        Whether a channel is at the limit of its range; None if none ever is.
    """

    index: int
    kind: str
    corners: FloatArray | None
    force: FloatArray
    moment: FloatArray
    ok: BoolArray
    rate: float
    start: float = 0.0
    problem: str = ""
    assumptions: tuple[str, ...] = ()
    saturated: BoolArray | None = None

    @property
    def centre(self) -> FloatArray | None:
        """Centre of the working surface in the lab, (3,), m."""
        return None if self.corners is None else self.corners.mean(axis=0)

    @property
    def usable(self) -> bool:
        """Whether the plate can be used."""
        return not self.problem

    def mean_vertical(self) -> float:
        """Return the mean upward force of the valid samples, N; NaN if there are none."""
        vertical = self.force[self.ok, 2]
        return float(vertical.mean()) if vertical.size else float("nan")


@dataclass(frozen=True)
class Recording:
    """Marker trajectories and force plates of one trial, in SI units and lab axes with Z up.

    Parameters
    ----------
    files : tuple of Path
        Files that were read.
    format : str
        ``"C3D (Intel, real)"``, ``"TRC"``, ``"TRC + MOT"``.
    labels : tuple of str, length M
        Unique marker names.
    positions : (F, M, 3) array
        Marker positions, m; NaN where a marker was not seen.
    frames : (F,) int array
        Frame numbers in the file.
    time : (F,) array
        Time on the clock of the file, s: 0 at frame 1 (or at frame 0, if the file counts from 0).
    rate : float
        Marker frames per second.
    units : str
        Length unit declared in the file or by the caller.
    vertical : str
        Axis of the file that points up (``"Z"``, ``"Y"``, ``"-Y"``, …); here it is already turned to Z.
    analog_rate : float or None
        Samples per second of the analog channels; None if there are none.
    plates : tuple of Plate
    oddities : tuple of str
        Notes on all repairs, omissions, assumptions and contradictions, one sentence each.
    """

    files: tuple[Path, ...]
    format: str
    labels: tuple[str, ...]
    positions: FloatArray
    frames: IntArray
    time: FloatArray
    rate: float
    units: str
    vertical: str
    analog_rate: float | None
    plates: tuple[Plate, ...]
    oddities: tuple[str, ...]

    @property
    def visible(self) -> BoolArray:
        """Whether each marker is visible in each frame, (F, M)."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    @property
    def missing_fraction(self) -> float:
        """Fraction of the marker samples that are missing."""
        return float(1.0 - self.visible.mean()) if self.positions.size else 1.0

    @classmethod
    def from_arrays(
        cls, labels: Sequence[str], positions: FloatArray, rate: float, plates: Sequence[Plate] = ()
    ) -> Recording:
        """Return the recording of arrays in memory.

        Parameters
        ----------
        labels : sequence of str, length M
            Unique marker names.
        positions : (F, M, 3) array
            Marker positions, lab axes with Z up, m; NaN where a marker was not seen.
        rate : float
            Frames per second.
        plates : sequence of Plate, optional
            Their samples begin with the first frame.

        Raises
        ------
        RecordingError
            The arrays do not fit together.
        """
        found = np.array(positions, np.float64)
        if found.ndim != 3 or not len(found) or found.shape[1:] != (len(labels), 3):
            raise RecordingError(
                f"positions: an array of shape {found.shape}; expected (frames, {len(labels)}, 3) for {len(labels)} "
                "labels, in m"
            )
        if len(set(labels)) < len(labels):
            raise RecordingError("labels: a name occurs twice; expected a name of its own for each marker")
        if not (np.isfinite(rate) and rate > 0):
            raise RecordingError(f"rate: {rate}; expected frames per second")
        frames = np.arange(1, len(found) + 1)
        time, analog = (frames - 1) / rate, plates[0].rate if plates else None
        return cls(
            (), "arrays", tuple(map(str, labels)), found, frames, time, rate, "m", "Z", analog, tuple(plates), ()
        )

    def to_frame(self) -> pd.DataFrame:
        """Return the markers as a data frame.

        Returns
        -------
        DataFrame
            A row for each frame, with its time in s as index; columns are marker and axis (``x``, ``y``, ``z``), m.
        """
        import pandas as pd  # noqa: PLC0415  a run needs no data frames

        columns = pd.MultiIndex.from_product([self.labels, tuple("xyz")], names=["marker", "axis"])
        index = pd.Index(self.time, name="time")
        frame = pd.DataFrame(self.positions.reshape(len(self.time), -1), index=index, columns=columns)
        frame.attrs["units"] = {"time": "s", "x": "m", "y": "m", "z": "m"}
        return frame
