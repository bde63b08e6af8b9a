"""Log of a further force sensor: a CSV file with time, force and optionally moment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, is_time_axis
from mocap_id.errors import RecordingError
from mocap_id.recording.text_tables import read_csv

TIME, FORCE, MOMENT = "time_s", ("Fx_N", "Fy_N", "Fz_N"), ("Mx_Nm", "My_Nm", "Mz_Nm")

_MAX_ERROR = 0.5  # of a step; a larger deviation from even times means missing samples


@dataclass(frozen=True)
class ForceLog:
    """Signals of a force sensor at evenly spaced times on its own clock.

    Parameters
    ----------
    start : float
        Time of the first sample, s.
    rate : float
        Samples per second.
    force : (K, 3) array
        Force in the axes of the file, N; NaN where a cell is empty.
    moment : (K, 3) array
        Moment about the point of application, N·m; zeros if the file has none.
    """

    start: float
    rate: float
    force: FloatArray
    moment: FloatArray

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.start + (len(self.force) - 1) / self.rate


def read_force_log(path: Path) -> ForceLog:
    """Read the log of a force sensor.

    The columns are ``time_s``, ``Fx_N``, ``Fy_N``, ``Fz_N`` and, all or none, ``Mx_Nm``, ``My_Nm``, ``Mz_Nm``. Their
    names contain the units, so that no unit is guessed.

    Raises
    ------
    RecordingError
        The file is missing or not such a table, has other columns, or its times are not evenly spaced.
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
    values = table.numbers()[:, [names.index(name) for name in expected]]
    time = _even(path, values[:, 0])
    resampled = np.column_stack([np.interp(time, values[:, 0], column) for column in values[:, 1:].T])
    moment = resampled[:, 3:] if len(expected) > len(FORCE) + 1 else np.zeros((len(time), 3))
    return ForceLog(float(time[0]), float((len(time) - 1) / (time[-1] - time[0])), resampled[:, :3], moment)


def _even(path: Path, time: FloatArray) -> FloatArray:
    """Return evenly spaced times (K,) closest to those of the file."""
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
