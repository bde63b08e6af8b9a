"""What a lab hands over, in one form: markers, force plates, and everything odd that was found on the way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Plate:
    """One force plate: the wrench of the ground on the body, in lab axes (Z up), SI.

    Parameters
    ----------
    index : int
        As in the file, counted from 1.
    kind : str
        ``"type 1"`` … ``"type 4"`` (C3D) or ``"mot"``.
    corners : (4, 3) array or None
        Corners of the working surface in the lab, m; None where the file does not give them.
    force : (K, 3) array
        Force of the ground on the body, N.
    moment : (K, 3) array
        Its moment about the *lab origin*, N·m.
    ok : (K,) bool array
        Every channel is finite and unsaturated.
    rate : float
        Samples per second.
    start : float
        Time of sample 0 in the recording's clock, s: sample k was taken at ``start + k / rate``.
    problem : str
        Why the plate cannot be used (its samples are NaN then), or empty.
    assumptions : tuple of str
        What the file does not say about the plate and was assumed, on which its forces rest; also among the oddities
        of the recording.
    saturated : (K,) bool array or None
        A channel sat at the end of its range; None where none did.
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
        """Centre of the working surface in the lab, (3,) m."""
        return None if self.corners is None else self.corners.mean(axis=0)

    @property
    def usable(self) -> bool:
        """Whether the samples mean anything."""
        return not self.problem

    def mean_vertical(self) -> float:
        """Mean upward force over the good samples, N; NaN where there are none."""
        vertical = self.force[self.ok, 2]
        return float(vertical.mean()) if vertical.size else float("nan")


@dataclass(frozen=True)
class Recording:
    """Marker trajectories and force plates of one trial, in SI and with the lab's Z axis up.

    Parameters
    ----------
    files : tuple of Path
        What was read.
    format : str
        ``"C3D (Intel, real)"``, ``"TRC"``, ``"TRC + MOT"``.
    labels : tuple of str, length M
        Unique marker names.
    positions : (F, M, 3) array
        m, lab axes with Z up; NaN where a marker was not seen.
    frames : (F,) int array
        The file's own frame numbers.
    time : (F,) array
        s, the file's clock: frame 1 (frame 0 where the file counts from 0) at 0 s.
    rate : float
        Marker frames per second.
    units : str
        Length unit as declared in the file (or by the caller).
    vertical : str
        The file's own axis that points up (``"Z"``, ``"Y"``, ``"-Y"``, …), before it was turned to Z.
    analog_rate : float or None
        Samples per second of the analog channels; None where there are none.
    plates : tuple of Plate
    oddities : tuple of str
        Everything repaired, left out, assumed or contradictory, one sentence each.
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
        """(F, M): the marker was seen in the frame."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    @property
    def missing_fraction(self) -> float:
        """Share of marker samples that were not seen."""
        return float(1.0 - self.visible.mean()) if self.positions.size else 1.0
