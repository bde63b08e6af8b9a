"""Marker trajectories of a text file in the units and axes of the file, and checks that all text formats share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, is_time_axis
from mocap_id.errors import RecordingError
from mocap_id.recording.time_stamps import fit_even_clock

_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers
_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class MarkerTable:
    """Content of a text file with markers, in its own units and axes.

    Parameters
    ----------
    format : str
        ``"TRC"``, ``"QTM TSV"``, ``"Motive CSV"`` or ``"Nexus CSV"``.
    labels : sequence of str, length M
        Marker names as in the file.
    frames : (F,) int array
        Frame numbers in the file.
    time : (F,) array
        Even times, s.
    positions : (F, M, 3) array
        Positions in the unit of the file; NaN where missing.
    rate : float
        Frames per second.
    units : str
        Length unit that the file or its format declares, possibly empty.
    up : str
        Upward axis that is usual for the format.
    usual : str
        Programs in which this axis is usual, for a note.
    outputs : sequence of str
        Labels that the file declares as computed.
    """

    format: str
    labels: Sequence[str]
    frames: IntArray
    time: FloatArray
    positions: FloatArray
    rate: float
    units: str
    up: str
    usual: str
    outputs: Sequence[str] = ()


def fit_clock(path: Path, declared: str, time: FloatArray, oddities: list[str], name: str) -> tuple[FloatArray, float]:
    """Return evenly spaced times fitted to a time column, and the frame rate.

    Parameters
    ----------
    declared : str
        Rate in the header, possibly not a number.
    time : (F,) array
        Time column, s.
    name : str
        Name of the rate in the header, for messages.

    Raises
    ------
    RecordingError
        The times do not increase or are uneven, the declared rate is not positive, or the two differ by more than 2 %.
    """
    if not is_time_axis(time):
        raise RecordingError(f"{path}: the Time column does not increase from frame to frame; export it again")
    stated = parse_rate(path, declared, name)
    clock = fit_even_clock(path, time, stated)
    if stated is not None and abs(clock.rate / stated - 1) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: {name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz; times must be in seconds: "
            "export it again, or correct the wrong one"
        )
    if stated is not None and clock.rate != stated:
        oddities.append(f"{name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz: the latter was used")
    if clock.rounding_note:
        oddities.append(f"{path.name}: {clock.rounding_note}")
    return clock.times(len(time)), clock.rate


def parse_rate(path: Path, declared: str, name: str) -> float | None:
    """Parse a rate in a header; None if it is not a number, RecordingError if it is not positive."""
    try:
        stated = float(declared)
    except ValueError:
        return None
    if not 0 < stated < np.inf:
        raise RecordingError(f"{path}: {name} is {declared[:40]} Hz, expected a positive number; export it again")
    return stated


def frame_numbers(path: Path, column: FloatArray, *, consecutive: bool) -> IntArray:
    """Return frame numbers (F,) as integers.

    Raises
    ------
    RecordingError
        A number is missing or too large, or the numbers must be consecutive and are not.
    """
    bad = ~np.isfinite(column) | (np.abs(column) >= _MAX_FRAME_NUMBER)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise RecordingError(f"{path}: row {row + 1} of the frames has no frame number or time; export it again")
    frames = column.astype(np.int64)
    steps = np.diff(frames) != 1
    if consecutive and (steps.any() or (frames != column).any()):
        row = int(np.argmax(steps)) if steps.any() else 0
        raise RecordingError(
            f"{path}: frame {frames[row]} is followed by frame {frames[min(row + 1, len(frames) - 1)]}: frames are "
            "missing; export every frame, with missing markers blank"
        )
    return frames


def join_positions(values: FloatArray) -> FloatArray:
    """Return positions (F, M, 3) from columns (F, 3M)."""
    return values.reshape(len(values), -1, 3)
