"""Readers of logs of an encoder and of a force sensor, and of joint angles that another system measured."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.clock import SENSOR_HZ, check_times
from mocap_id.recording.held_samples import HeldSamples, find_held, list_held
from mocap_id.recording.text_tables import read_csv, read_table

TIME, POSITION, VELOCITY, TORQUE = "time_s", "position_rad", "velocity_rad_s", "torque_Nm"

_MIN_ROWS = 20
_SPAN = 0.1  # s; over this time the integrated velocity must match the change of position
_ACCEPTED_RATIO = (0.8, 1.25)  # accepted ratio of the change of position to the integrated velocity
_MIN_MOVEMENT = 0.05  # rad; a smaller movement is not checked
_LEAST_HELD, _HELD_MOVES = 5, 2e-3  # rows that repeat the row before; rad by which the joint moved in this time
DEGREES = 180.0 / np.pi
_MAX_SHOWN = 120  # characters of the header to show in a message
_EXPECTED = f"expected {TIME}, {POSITION}, {VELOCITY} and optionally {TORQUE}"


FORCE, MOMENT = ("Fx_N", "Fy_N", "Fz_N"), ("Mx_Nm", "My_Nm", "Mz_Nm")

_MAX_ERROR = 0.5  # steps; a larger difference from evenly spaced times means missing samples


_TIME = ("time", "time_s")

_TO_RAD = {"_deg": np.pi / 180.0, "_rad": 1.0}


@dataclass(frozen=True)
class EncoderLog:
    """K samples of the signals of an encoder, on its own clock."""

    time: FloatArray  # (K,) increasing times, s
    position: FloatArray  # (K,) rad
    velocity: FloatArray  # (K,) rad/s
    torque: FloatArray | None  # (K,) N·m, NaN if a cell is empty; None if the file has no such column
    held: tuple[HeldSamples, ...] = ()  # repeated rows, which are left out

    @property
    def rate(self) -> float:
        """Mean number of rows per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


def read_encoder(path: Path) -> EncoderLog:
    """Read an encoder log.

    The columns are ``time_s``, ``position_rad``, ``velocity_rad_s`` and optionally ``torque_Nm``. Their names contain
    the units, so that no unit is guessed. Raises RecordingError if the file is missing or not such a table, has other
    columns or empty cells, or its times do not increase. It is also raised if the velocity is not the derivative of the
    position.
    """
    columns = _read_columns(path)
    time, position, velocity = (columns[name] for name in (TIME, POSITION, VELOCITY))
    if len(time) < _MIN_ROWS:
        raise RecordingError(f"{path}: has {len(time)} rows, expected at least {_MIN_ROWS}")
    for name in (TIME, POSITION, VELOCITY):
        empty = np.flatnonzero(~np.isfinite(columns[name]))
        if len(empty):
            raise RecordingError(
                f"{path}: `{name}` has no number in line {empty[0] + 2} ({len(empty)} such lines): remove these "
                "lines; the times need not be evenly spaced"
            )
    check_times(path, time, f"`{TIME}`", SENSOR_HZ)
    _check_derivative(path, time, position, velocity)
    rows = _find_held_rows(time, position, velocity)
    held = list_held(f"the encoder ({path.name})", time, rows, np.zeros_like(rows))
    torque = columns.get(TORQUE)
    return EncoderLog(time[~rows], position[~rows], velocity[~rows], None if torque is None else torque[~rows], held)


def _read_columns(path: Path) -> dict[str, FloatArray]:
    table = read_csv(path)
    names = list(table.names)
    if sorted(names) not in (sorted([TIME, POSITION, VELOCITY]), sorted([TIME, POSITION, VELOCITY, TORQUE])):
        raise RecordingError(
            f"{path}: has the columns {', '.join(names)[:_MAX_SHOWN]}, {_EXPECTED}: convert to the "
            "units in these names and remove all other columns"
        )
    return dict(zip(names, table.numbers().T.copy(), strict=True))


def _find_held_rows(time: FloatArray, position: FloatArray, velocity: FloatArray) -> BoolArray:
    """Return which rows (K,) repeat the row before.

    An encoder repeats its angle while the joint rests. It repeats it wrongly if the velocity in these rows is not zero.
    """
    values = np.column_stack([position, velocity])
    same = np.concatenate([[False], np.all(np.diff(values, axis=0) == 0.0, axis=1)])
    found = np.zeros_like(same)
    for run in find_runs(same):
        moved = abs(velocity[run.start]) * float(time[run.stop - 1] - time[run.start - 1])
        found[run] = run.stop - run.start >= _LEAST_HELD and moved > _HELD_MOVES
    return found


def _check_derivative(path: Path, time: FloatArray, position: FloatArray, velocity: FloatArray) -> None:
    """Raise RecordingError if the velocity is not the derivative of the position, as with a wrong unit or direction."""
    apart = max(1, round(_SPAN / float(np.median(np.diff(time)))))
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    by_velocity, by_position = (each[apart:] - each[:-apart] for each in (summed, position))
    size = float(by_velocity @ by_velocity)
    slope = float(by_velocity @ by_position) / size if size > 0.0 else 0.0
    if np.ptp(position) < _MIN_MOVEMENT or _ACCEPTED_RATIO[0] <= slope <= _ACCEPTED_RATIO[1]:
        return
    ratio = abs(slope)
    hint = "of another joint or direction"
    for what, factor in (("position", DEGREES), ("velocity", 1.0 / DEGREES)):
        if _ACCEPTED_RATIO[0] <= ratio / factor <= _ACCEPTED_RATIO[1]:
            hint = f"in other units, the {what} in degrees"
    if _ACCEPTED_RATIO[0] <= ratio * 1000.0 <= _ACCEPTED_RATIO[1]:
        hint = f"in other units, or `{TIME}` is in milliseconds and must be in seconds"
    raise RecordingError(
        f"{path}: `{POSITION}` changes by {slope:.3g} times the integral of `{VELOCITY}`: one of them is {hint}; both "
        "must be in radians and of the same joint"
    )


@dataclass(frozen=True)
class ForceLog:
    """Signals of a force sensor at K evenly spaced times on its own clock."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    force: FloatArray  # (K, 3) in the axes of the file, N; NaN if a cell is empty
    moment: FloatArray  # (K, 3) about the point of application, N·m; zeros if the file has no moment
    held: tuple[HeldSamples, ...] = ()  # repeated or interpolated rows, whose force is NaN

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.start + (len(self.force) - 1) / self.rate


def read_force_log(path: Path) -> ForceLog:
    """Read the log of a force sensor.

    The columns are ``time_s``, ``Fx_N``, ``Fy_N``, ``Fz_N`` and optionally all of ``Mx_Nm``, ``My_Nm``, ``Mz_Nm``.
    Their names contain the units, so that no unit is guessed. Raises RecordingError if the file is missing or not such
    a table, has other columns, or its times are not evenly spaced.
    """
    table = read_csv(path)
    names = list(table.names)
    expected = [TIME, *FORCE] if not set(names) & set(MOMENT) else [TIME, *FORCE, *MOMENT]
    if sorted(names) != sorted(expected):
        raise RecordingError(
            f"{path}: has the columns {', '.join(names)}, expected {', '.join([TIME, *FORCE])} and optionally "
            f"{', '.join(MOMENT)} about the point of application: convert to the units in these names and remove all "
            "other columns"
        )
    values = table.select(expected)
    time = _space_evenly(path, values[:, 0])
    loaded = np.any(values[:, 1:4] != 0.0, axis=1)
    rows = [each & loaded for each in find_held(values[:, 1:], (len(time) - 1) / float(np.ptp(time)))]
    values[rows[0] | rows[1], 1:] = np.nan
    held = list_held(f"the sensor in {path.name}", time, *rows)
    resampled = np.column_stack([np.interp(time, values[:, 0], column) for column in values[:, 1:].T])
    moment = resampled[:, 3:] if len(expected) > len(FORCE) + 1 else np.zeros((len(time), 3))
    return ForceLog(float(time[0]), float((len(time) - 1) / (time[-1] - time[0])), resampled[:, :3], moment, held)


def _space_evenly(path: Path, time: FloatArray) -> FloatArray:
    """Return K evenly spaced times from the first to the last time, s; RecordingError if samples are missing."""
    check_times(path, time, f"`{TIME}`", SENSOR_HZ, pauses=True)
    even = np.linspace(time[0], time[-1], len(time))
    step = float(even[1] - even[0])
    worst = int(np.argmax(np.abs(time - even)))
    if abs(time[worst] - even[worst]) > _MAX_ERROR * step:
        raise RecordingError(
            f"{path}: the times are not evenly spaced: row {worst + 2} has {time[worst]:g} s, expected "
            f"{even[worst]:g} s at {1 / step:.6g} Hz: samples are missing; export the file without gaps"
        )
    return np.asarray(even)


@dataclass(frozen=True)
class AngleTable:
    """Joint angles at the K times of the file."""

    time: FloatArray  # (K,) increasing times, s
    angles: dict[str, FloatArray]  # angles (K,) by column name, rad; NaN if a cell is empty


def read_angles(path: Path, columns: Collection[str]) -> AngleTable:
    """Read the given columns of joint angles from a MOT, STO or CSV file.

    The header of a MOT or STO file says whether its angles are in degrees (``inDegrees``). In a CSV file the name of
    each column ends in ``_deg`` or ``_rad``, and the first column is ``time`` or ``time_s``, s. Raises ConfigError if
    the file lacks a column. Raises RecordingError if the file is missing or not such a table, its times do not
    increase, or a CSV column name has no unit.
    """
    return _read_csv_angles(path, columns) if path.suffix.lower() == ".csv" else _read_motion_angles(path, columns)


def _read_motion_angles(path: Path, columns: Collection[str]) -> AngleTable:
    table = read_table(path)
    _check_columns(path, columns, table.columns)
    factor = np.pi / 180.0 if table.in_degrees else 1.0
    return AngleTable(table.time, {name: table[name] * factor for name in columns})


def _read_csv_angles(path: Path, columns: Collection[str]) -> AngleTable:
    table = read_csv(path)
    names = list(table.names)
    if names[0] not in _TIME:
        raise RecordingError(f"{path}: the first column is {names[:1]}, expected `time_s`")
    _check_columns(path, columns, names[1:])
    values = table.numbers()
    time = values[:, 0]
    check_times(path, time, f"`{names[0]}`", SENSOR_HZ, pauses=True)
    return AngleTable(time, {name: values[:, names.index(name, 1)] * _find_factor(path, name) for name in columns})


def _find_factor(path: Path, name: str) -> float:
    for ending, factor in _TO_RAD.items():
        if name.lower().endswith(ending):
            return factor
    raise RecordingError(f"{path}: column {name} has no unit in its name: the name must end in _deg or _rad")


def _check_columns(path: Path, columns: Collection[str], existing: Collection[str]) -> None:
    absent = [name for name in columns if name not in existing]
    if absent:
        shown = ", ".join(list(existing)[:12]) + (" …" if len(existing) > 12 else "")
        raise ConfigError(f"compare: columns: {path} has no column {', '.join(absent)}; it has {shown}")
