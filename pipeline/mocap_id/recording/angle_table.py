"""Joint angles that another system measured, from MOT, STO or CSV files."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, is_time_axis
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.text_tables import read_csv, read_table

_TIME = ("time", "time_s")
_TO_RAD = {"_deg": np.pi / 180.0, "_rad": 1.0}


@dataclass(frozen=True)
class AngleTable:
    """Joint angles at the K times of the file."""

    time: FloatArray  # (K,) increasing times, s
    angles: dict[str, FloatArray]  # angles (K,) by column name, rad; NaN if a cell is empty


def read_angles(path: Path, columns: Collection[str]) -> AngleTable:
    """Read the given columns of angles.

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
    if not is_time_axis(time):
        raise RecordingError(f"{path}: `{names[0]}` must contain at least two increasing times")
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
