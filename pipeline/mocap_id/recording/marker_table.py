"""Marker trajectories of text and Kinetics Toolkit files: checks and conversion to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import choose_vertical, to_z_up
from mocap_id.recording.clock import fit_even_clock
from mocap_id.recording.labels import leave_out_objects, name_markers
from mocap_id.recording.marker_positions import clean_positions, resolve_length_unit, rotate_z_up
from mocap_id.recording.model import Recording
from mocap_id.recording.units import ForceUnits

_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers
_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class MarkerTable:
    """Marker trajectories in the units and axes of the file: F frames of M markers."""

    format: str  # name of the format, such as ``"TRC"`` or ``"Motive CSV"``
    labels: Sequence[str]  # M marker names as in the file
    frames: IntArray  # (F,) frame numbers in the file
    time: FloatArray  # (F,) times with a constant step, s
    positions: FloatArray  # (F, M, 3) in the unit of the file; NaN if missing
    rate: float  # frames per second
    units: str  # length unit that the file or its format declares, possibly empty
    up: str  # upward axis that is usual for the format
    outputs: Sequence[str] = ()  # labels that the file declares as computed, not measured


@dataclass(frozen=True)
class ReadingOptions:
    """Checked options of :func:`mocap_id.recording.read`."""

    units: str | None
    vertical: str | None
    force_units: ForceUnits
    unit_required: bool


def assemble_recording(
    path: Path, table: MarkerTable, force: FloatArray | None, options: ReadingOptions, oddities: list[str]
) -> tuple[Recording, FloatArray]:
    """Return a table as a recording without plates, and the rotation (3, 3) from the axes of the file to Z up.

    ``force`` (3,) is the mean ground force in the axes of the file; it is None if there are no plates. Notes are added
    to ``oddities``.
    """
    required = options.unit_required
    unit, metres = resolve_length_unit(path, table.units, options.units, oddities, required=required)
    naming = name_markers(table.labels, table.outputs)
    positions = table.positions[:, list(naming.keep)] * metres
    clean_positions(path, positions, unit, oddities)
    naming, positions = leave_out_objects(naming, positions)
    oddities += naming.oddities
    up = choose_vertical(force, options.vertical, table.up, oddities)
    rotate_z_up(positions, up)
    recording = Recording(
        files=(path,),
        format=table.format,
        labels=naming.labels,
        positions=positions,
        frames=table.frames,
        time=table.time,
        rate=table.rate,
        units=unit,
        vertical=up,
        analog_rate=None,
        plates=(),
        oddities=tuple(oddities),
        left_out=naming.left_out,
        people=naming.people,
    )
    return recording, to_z_up(up)


def fit_clock(path: Path, declared: str, time: FloatArray, oddities: list[str], name: str) -> tuple[FloatArray, float]:
    """Return evenly spaced times (F,) fitted to a time column (F,), s, and the frame rate, Hz.

    ``declared`` is the rate in the header, possibly not a number; ``name`` is its name in the header. Differences are
    noted in ``oddities``. Raises RecordingError if the times do not increase, are uneven or not in seconds, if the
    declared rate is not positive, or if the two rates differ by more than 2 %.
    """
    stated = parse_rate(path, declared, name)
    clock = fit_even_clock(path, time, stated, name="the Time column")
    if stated is not None and abs(clock.rate / stated - 1) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: {name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz; times must be in seconds: "
            "export it again, or correct the wrong one"
        )
    if stated is not None and clock.rate != stated:
        oddities.append(
            f"{name} is {declared} Hz, the Time column has {clock.rate:.6g} Hz: {clock.rate:.6g} Hz was used"
        )
    if clock.rounding_note:
        oddities.append(f"{path.name}: {clock.rounding_note}")
    return clock.times(len(time)), clock.rate


def parse_rate(path: Path, declared: str, name: str) -> float | None:
    """Return the rate in a header, Hz; None if it is not a number, RecordingError if it is not positive."""
    try:
        stated = float(declared)
    except ValueError:
        return None
    if not 0 < stated < np.inf:
        raise RecordingError(f"{path}: {name} is {declared[:40]} Hz, expected a positive number; export it again")
    return stated


def check_frame_numbers(path: Path, column: FloatArray, *, consecutive: bool) -> IntArray:
    """Return frame numbers (F,) as integers.

    Raises RecordingError if a number is missing or too large, or if the numbers must be consecutive and are not.
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
