"""Log of a force sensor other than a plate: a CSV file with time, force and optionally moment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, is_time_axis
from mocap_id.errors import RecordingError
from mocap_id.recording.text_tables import read_csv

TIME, FORCE, MOMENT = "time_s", ("Fx_N", "Fy_N", "Fz_N"), ("Mx_Nm", "My_Nm", "Mz_Nm")

_MAX_ERROR = 0.5  # steps; a larger difference from evenly spaced times means missing samples


@dataclass(frozen=True)
class ForceLog:
    """Signals of a force sensor at K evenly spaced times on its own clock."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    force: FloatArray  # (K, 3) in the axes of the file, N; NaN if a cell is empty
    moment: FloatArray  # (K, 3) about the point of application, N·m; zeros if the file has no moment

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.start + (len(self.force) - 1) / self.rate


def read_force_log(path: Path) -> ForceLog:
    """Read the log of a force sensor.

    The columns are ``time_s``, ``Fx_N``, ``Fy_N``, ``Fz_N`` and, all or none, ``Mx_Nm``, ``My_Nm``, ``Mz_Nm``. Their
    names contain the units, so that no unit is guessed. Raises RecordingError if the file is missing or not such a
    table, has other columns, or its times are not evenly spaced.
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
    resampled = np.column_stack([np.interp(time, values[:, 0], column) for column in values[:, 1:].T])
    moment = resampled[:, 3:] if len(expected) > len(FORCE) + 1 else np.zeros((len(time), 3))
    return ForceLog(float(time[0]), float((len(time) - 1) / (time[-1] - time[0])), resampled[:, :3], moment)


def _space_evenly(path: Path, time: FloatArray) -> FloatArray:
    """Return the evenly spaced times (K,) that are closest to the times of the file."""
    if not is_time_axis(time):
        raise RecordingError(f"{path}: `{TIME}` must contain at least two times that increase from row to row")
    even = np.linspace(time[0], time[-1], len(time))
    step = float(even[1] - even[0])
    worst = int(np.argmax(np.abs(time - even)))
    if abs(time[worst] - even[worst]) > _MAX_ERROR * step:
        raise RecordingError(
            f"{path}: the times are not evenly spaced: row {worst + 2} has {time[worst]:g} s, expected "
            f"{even[worst]:g} s at {1 / step:.6g} Hz: samples are missing; export the file without gaps"
        )
    return np.asarray(even)
