"""A robot's own record of its joint: CSV with the time, position, velocity and perhaps the torque."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.tables import read_csv

TIME, POSITION, VELOCITY, TORQUE = "time_s", "position_rad", "velocity_rad_s", "torque_Nm"

_LEAST_ROWS = 20
_SPAN = 0.1  # s, over which the velocity must add up to the change of position
_AGREES = (0.8, 1.25)  # of the change of position by the velocity's own
_MOVES = 0.05  # rad: less movement tells nothing
DEGREES = 180.0 / np.pi
_LONGEST = 120  # characters of a header that is shown
_EXPECTED = f"expected {TIME}, {POSITION}, {VELOCITY} and perhaps {TORQUE}"


@dataclass(frozen=True)
class EncoderLog:
    """What an encoder logged, on its own clock.

    Parameters
    ----------
    time : (K,) array
        Increasing, s.
    position, velocity : (K,) arrays
        rad, rad/s.
    torque : (K,) array or None
        N·m; NaN where a cell is empty. None where the file has none.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    torque: FloatArray | None

    @property
    def rate(self) -> float:
        """Rows a second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


def read_encoder(path: Path) -> EncoderLog:
    """Read an encoder's CSV.

    Columns are ``time_s``, ``position_rad``, ``velocity_rad_s`` and perhaps ``torque_Nm``: their names hold their
    units, so that none is guessed.

    Raises
    ------
    RecordingError
        The file is missing, no such table, has other columns or empty cells, its times do not increase, or its
        velocity is not the change of its position.
    """
    columns = _columns(path)
    time, position, velocity = (columns[name] for name in (TIME, POSITION, VELOCITY))
    _check_whole(path, columns)
    _check_times(path, time)
    _check_derivative(path, time, position, velocity)
    return EncoderLog(time, position, velocity, columns.get(TORQUE))


def _columns(path: Path) -> dict[str, FloatArray]:
    table = read_csv(path)
    names = list(table.names)
    if len(names) == 1 and ";" in names[0]:
        raise RecordingError(f"{path}: its cells are parted by `;`: export it with `,` between and decimal points")
    if sorted(names) not in (sorted([TIME, POSITION, VELOCITY]), sorted([TIME, POSITION, VELOCITY, TORQUE])):
        raise RecordingError(
            f"{path}: has the columns {', '.join(names)[:_LONGEST]}, {_EXPECTED}: convert other units, which the names "
            "tell (degrees to radians), and leave everything else out"
        )
    return dict(zip(names, table.numbers().T.copy(), strict=True))


def _check_whole(path: Path, columns: dict[str, FloatArray]) -> None:
    rows = len(columns[TIME])
    if rows < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {rows} rows, expected {_LEAST_ROWS} or more")
    for name in (TIME, POSITION, VELOCITY):
        empty = np.flatnonzero(~np.isfinite(columns[name]))
        if len(empty):
            raise RecordingError(
                f"{path}: `{name}` holds no number in line {empty[0] + 2} ({len(empty)} such lines): leave these lines "
                "out, the times need not be even"
            )


def _check_times(path: Path, time: FloatArray) -> None:
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0]) + 1
        raise RecordingError(
            f"{path}: `{TIME}` does not increase: line {k + 2} has {time[k]:g} s after {time[k - 1]:g} s; sort the "
            "record by its own clock and leave out what stands twice"
        )


def _check_derivative(path: Path, time: FloatArray, position: FloatArray, velocity: FloatArray) -> None:
    """Refuse a velocity that is not the position's: another unit, another sense, another joint."""
    apart = max(1, round(_SPAN / float(np.median(np.diff(time)))))
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    by_velocity, by_position = (each[apart:] - each[:-apart] for each in (summed, position))
    size = float(by_velocity @ by_velocity)
    slope = float(by_velocity @ by_position) / size if size > 0.0 else 0.0
    if np.ptp(position) < _MOVES or _AGREES[0] <= slope <= _AGREES[1]:
        return
    ratio = abs(slope)
    hint = "of another joint or sense"
    for what, factor in (("position", DEGREES), ("velocity", 1.0 / DEGREES)):
        if _AGREES[0] <= ratio / factor <= _AGREES[1]:
            hint = f"in other units, the {what} in degrees"
    if _AGREES[0] <= ratio * 1000.0 <= _AGREES[1]:
        hint = f"in other units, or `{TIME}` is in milliseconds and must be in seconds"
    raise RecordingError(
        f"{path}: `{POSITION}` changes by {slope:.3g} times what `{VELOCITY}` adds up to: one of them is {hint}; both "
        "must be in radians and of the same joint"
    )
