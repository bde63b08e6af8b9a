"""A recording in one form for all file formats: markers, force plates, and notes on oddities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray


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
