"""A second force sensor's own file: CSV with the time, the force and perhaps a moment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.tables import read_csv

TIME, FORCE, MOMENT = "time_s", ("Fx_N", "Fy_N", "Fz_N"), ("Mx_Nm", "My_Nm", "Mz_Nm")

_EVEN = 0.5  # of a step: farther from even times, samples are missing


@dataclass(frozen=True)
class ForceLog:
    """What a force sensor logged, at even times on its own clock.

    Parameters
    ----------
    start : float
        Time of the first sample, s.
    rate : float
        Samples a second.
    force : (K, 3) array
        N, in the file's axes; NaN where a cell is empty.
    moment : (K, 3) array
        Free moment about the point where the force acts, N·m; zeros where the file has none.
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
    """Read a force sensor's CSV.

    Columns are ``time_s``, ``Fx_N``, ``Fy_N``, ``Fz_N`` and, all or none, ``Mx_Nm``, ``My_Nm``, ``Mz_Nm``: their names
    hold their units, so that none is guessed.

    Raises
    ------
    RecordingError
        The file is missing, no such table, has other columns, or its times are not even.
    """
    table = read_csv(path)
    names = list(table.names)
    expected = [TIME, *FORCE] if not set(names) & set(MOMENT) else [TIME, *FORCE, *MOMENT]
    if sorted(names) != sorted(expected):
        raise RecordingError(
            f"{path}: has the columns {', '.join(names)}, expected {', '.join([TIME, *FORCE])} and perhaps "
            f"{', '.join(MOMENT)} about the point where the force acts: convert other units, which the names tell, and "
            "leave everything else out"
        )
    values = table.numbers()[:, [names.index(name) for name in expected]]
    time = _even(path, values[:, 0])
    resampled = np.column_stack([np.interp(time, values[:, 0], column) for column in values[:, 1:].T])
    moment = resampled[:, 3:] if len(expected) > len(FORCE) + 1 else np.zeros((len(time), 3))
    return ForceLog(float(time[0]), float((len(time) - 1) / (time[-1] - time[0])), resampled[:, :3], moment)


def _even(path: Path, time: FloatArray) -> FloatArray:
    """Even times (K,) nearest to the file's."""
    if len(time) < 2 or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
        raise RecordingError(f"{path}: `{TIME}` must hold two times or more that increase, in every row")
    even = np.linspace(time[0], time[-1], len(time))
    step = float(even[1] - even[0])
    worst = int(np.argmax(np.abs(time - even)))
    if abs(time[worst] - even[worst]) > _EVEN * step:
        raise RecordingError(
            f"{path}: the times are not even: row {worst + 2} has {time[worst]:g} s, expected {even[worst]:g} s at "
            f"{1 / step:.6g} Hz: samples are missing; export the record without gaps"
        )
    return np.asarray(even)
