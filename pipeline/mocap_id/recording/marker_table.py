"""Marker trajectories of text and Kinetics Toolkit files: fit of their clock, checks and conversion to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, is_time_axis
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import choose_vertical, to_z_up
from mocap_id.recording.labels import leave_out_objects, name_markers
from mocap_id.recording.marker_positions import clean_positions, resolve_length_unit, rotate_z_up
from mocap_id.recording.model import Recording
from mocap_id.recording.units import ForceUnits

_MIN_PERIOD_S = 1e-9
_MAX_ERROR = 0.05  # accepted error of a time stamp beyond its rounding, as a fraction of a frame
_MAX_ROUNDING = 0.25  # largest accepted rounding, as a fraction of a frame; a larger one could hide a missing frame
_MAX_DECIMALS = 9  # finer than any clock; further digits are due to the binary representation


_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers

_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class EvenClock:
    """Clock with a constant rate: sample k is at ``start + k / rate``."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    largest_error: float  # largest error of a time stamp, in samples

    def times(self, count: int) -> FloatArray:
        """Return the times of the first ``count`` samples, s."""
        return np.round(self.start + np.arange(count) / self.rate, 12) + 0.0  # a start of 1e-16 becomes 0, not -0

    @property
    def rounding_note(self) -> str:
        """Note that the time stamps are coarsely rounded; empty if they are not."""
        if self.largest_error <= _MAX_ERROR:
            return ""
        return f"its times are rounded by up to {self.largest_error:.2f} of a sample: evenly spaced times were used"


def fit_even_clock(path: Path, time: FloatArray, stated: float | None = None) -> EvenClock:
    """Fit a clock with a constant rate to increasing time stamps (T,), s, by least squares.

    ``stated`` is the rate declared in the file, Hz; it is used if it agrees with all stamps. Raises RecordingError if
    frames are missing, or if a stamp deviates by more than 5 % of a frame beyond its rounding.
    """
    steps = np.diff(time)
    if steps.max() > 1.5 * np.median(steps):
        raise RecordingError(
            f"{path}: frames are missing: the time column steps by {np.median(steps):.4g} s and once by "
            f"{steps.max():.4g} s; export every frame, with missing markers blank"
        )
    number = np.arange(len(time)) - (len(time) - 1) / 2
    middle = float(time.mean())
    period = float(number @ (time - middle) / (number @ number))
    if not _MIN_PERIOD_S < period < 1 / _MIN_PERIOD_S:
        raise RecordingError(
            f"{path}: the time column steps by {period:.4g} s, which is not plausible; is it in seconds?"
        )
    rounding = np.minimum(_estimate_rounding(time), _MAX_ROUNDING * period)
    errors = np.abs(time - middle - number * period)
    jumps = np.abs(steps - period)
    for error, allowed in ((errors, rounding), (jumps, rounding[1:] + rounding[:-1])):
        worst = int(np.argmax(error - allowed))
        if error[worst] - allowed[worst] > _MAX_ERROR * period:
            raise RecordingError(
                f"{path}: the time column is uneven: at {time[worst]:.6g} s it is off by {error[worst] / period:.2f} "
                f"of a frame at {1 / period:.6g} Hz; export the trial at a constant rate, with a row for every frame"
            )
    limit = (_MAX_ERROR * period + float(rounding.max())) / float(number[-1])
    if stated is not None and stated > 0 and abs(1 / stated - period) <= limit:
        period = 1 / stated
    rate = 1 / period if stated is None or period != 1 / stated else stated
    return EvenClock(middle + float(number[0]) * period, rate, float(errors.max()) / period)


def _estimate_rounding(time: FloatArray) -> FloatArray:
    """Return the largest possible rounding error (T,) of each time stamp (T,), s, from the number of its digits.

    All stamps have the same number of decimals or the same number of significant digits. Because trailing zeros are
    lost, the stamps with the most digits determine this number.
    """
    decimals = np.full(len(time), _MAX_DECIMALS)
    for digits in range(_MAX_DECIMALS - 1, -1, -1):
        scaled = time * 10.0**digits
        decimals[np.abs(scaled - np.round(scaled)) < 1e-5 * np.maximum(1.0, 1e-7 * np.abs(scaled))] = digits
    magnitude = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-_MAX_DECIMALS))) + 1
    significant = float((magnitude + decimals).max())
    places = np.minimum(float(decimals.max()), significant - magnitude)
    return np.asarray(0.5 * 10.0**-places)


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
    noted in ``oddities``. Raises RecordingError if the times do not increase or are uneven, if the declared rate is not
    positive, or if the two rates differ by more than 2 %.
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
