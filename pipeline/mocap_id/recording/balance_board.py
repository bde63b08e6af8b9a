"""Log of a balance board: a CSV file with irregular times and the loads of four cells at the corners."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.clock import SENSOR_HZ, check_times
from mocap_id.recording.held_samples import HeldSamples, find_held, list_held
from mocap_id.recording.text_tables import read_csv

TIME, CELLS = "time_s", ("tl_kg", "tr_kg", "bl_kg", "br_kg")
LOAD = "load_kg"
CELLS_BELOW_SURFACE_M = 0.053
"""Depth of the cells below the surface on which the person stands, m."""

_GRAVITY = 9.81
_WIDTH_M, _DEPTH_M = 0.433, 0.238  # distances of the cells, left to right and bottom to top
_ACROSS = np.array([-1.0, 1.0, -1.0, 1.0]) * _WIDTH_M / 2.0  # m, position of each cell to the right of the centre
_ALONG = np.array([1.0, 1.0, -1.0, -1.0]) * _DEPTH_M / 2.0  # m, position of each cell towards the top
_RATE = 200.0  # Hz, after resampling
_WINDOW_S, _INTERVALS = 0.025, 2.0  # the window is as long as the larger of 25 ms and 2 intervals
_LONGEST_GAP_S = 0.15  # in a longer gap the load is not known
_LEAST_ROWS = 20
_LARGEST_KG = 400.0
_MOVED_KG, _DEAD_SHARE = 5.0, 0.1
"""If the load of a cell varies by more than the first value, kg, each cell varies by at least this fraction of it; in
good logs by 0.5 or more.
"""
_UNLOADED_KG = 2.0
_CELL_KG, _CELL_GAIN = 0.05, 0.02  # standard deviations: of a reading, and of a cell's gain before calibration


@dataclass(frozen=True)
class BoardLog:
    """Load of a balance board at K times with a constant step, on the board's clock."""

    start: float  # time of the first sample, s
    rate: float  # samples per second
    force: FloatArray  # (K,) downward load, N; NaN where ``ok`` is False
    moment: FloatArray  # (K, 2) load times its distance to the right of the board's centre, and towards its top, N·m
    ok: BoolArray  # (K,) whether the log has samples near each time
    averaged: float  # width of the moving average that smooths as much as the resampling, s
    interval: float  # median time between two different time stamps, s
    gaps: int  # number of gaps that are too long to be bridged
    problem: str = ""  # reason why the loads cannot be used, or empty
    held: tuple[HeldSamples, ...] = ()  # repeated or interpolated rows, which are left out


def read_board(path: Path, loads: Path | None = None) -> BoardLog:
    """Read the log of a balance board and resample it to times with a constant step.

    The columns are ``time_s`` and the loads ``tl_kg``, ``tr_kg``, ``bl_kg``, ``br_kg`` of the cells at the top left,
    top right, bottom left and bottom right. The times may be irregular and repeated. Rows with the same time are
    averaged. Each new sample is then the mean over a short window around its time, as in SWARII (Audiffren & Contal
    2016).

    If a calibration file ``loads`` is given, the readings are corrected with :func:`calibrate_cells`. It contains the
    columns of the cells and ``load_kg``, with a row for each known load. Raises RecordingError if a file is missing,
    has another format or too few rows, or its times go backwards.
    """
    values = _read_columns(path, TIME)
    values = values[np.isfinite(values).all(axis=1)]
    time, cells = values[:, 0], values[:, 1:]
    if len(time) < _LEAST_ROWS or np.ptp(time) <= 0.0:
        raise RecordingError(f"{path}: has {len(time)} complete rows, expected at least {_LEAST_ROWS} different times")
    check_times(path, time, f"`{TIME}`", SENSOR_HZ, repeated=True)
    if np.abs(cells).max() > _LARGEST_KG:
        raise RecordingError(
            f"{path}: a cell reads {np.abs(cells).max():g} kg, expected at most {_LARGEST_KG:g}: the columns must "
            "contain kilograms, not raw counts"
        )
    if loads is not None:
        gain, zero = calibrate_cells(_read_columns(loads, LOAD))
        cells = (cells - zero) * gain
    rate = (len(time) - 1) / float(np.ptp(time))
    rows = [each & (np.abs(cells).sum(axis=1) > _UNLOADED_KG) for each in find_held(cells, rate)]
    kept = ~rows[0] & ~rows[1]
    newtons = cells[kept] * _GRAVITY
    log = _resample(time[kept], np.column_stack([newtons.sum(axis=1), newtons @ _ACROSS, newtons @ _ALONG]))
    held = list_held(f"the balance board ({path.name})", time, *rows)
    stretches = [np.searchsorted(time[kept], first) for each in held for first, _ in each.stretches]
    long = sum(time[kept][k] - time[kept][k - 1] > _LONGEST_GAP_S for k in stretches if 0 < k < kept.sum())
    return replace(log, held=held, gaps=log.gaps - int(long), problem=_find_dead_cells(cells))


def _find_dead_cells(cells: FloatArray) -> str:
    """Return which cells of the loads (K, 4), kg, do not follow the person although others do; empty if all follow."""
    varies = np.ptp(np.percentile(cells, [1, 99], axis=0), axis=0)
    dead = varies < _DEAD_SHARE * varies.max() if varies.max() > _MOVED_KG else np.ptp(cells, axis=0) == 0.0
    if not dead.any() or dead.all():
        return ""
    listed = ", ".join(
        f"`{name}` stays near {np.median(values):.1f} kg"
        for name, values in zip(np.array(CELLS)[dead], cells.T[dead], strict=True)
    )
    return (
        f"{listed} while the load of the other cells varies by up to {varies.max():.0f} kg: the cell is dead or its "
        "column is wrong. Mass, force and centre of pressure would be wrong; check the board with a known weight on "
        "each corner"
    )


def calibrate_cells(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gain (4,) and the zero (4,) of each cell, so that its load is ``gain * (reading - zero)``, kg.

    ``values`` (L, 5) are L known loads, each with the readings of the four cells, kg. Rows with a load of 0 give the
    zeros. The gains are the values nearest to 1 with which the loads of the cells add up to the known loads. The load
    must be put near each cell in turn, because otherwise the four gains cannot be determined separately.

    Examples
    --------
    >>> gain, zero = calibrate_cells(np.array([[0, 0.2, 0, 0, 0], [20, 10.2, 4, 4, 2], [10, 0.2, 10, 0, 0]]))
    >>> gain.round(3), zero
    (array([1., 1., 1., 1.]), array([0.2, 0. , 0. , 0. ]))
    """
    load, readings = values[:, 0], values[:, 1:]
    empty = load == 0.0
    zero = readings[empty].mean(axis=0) if empty.any() else np.zeros(len(CELLS))
    net = readings[~empty] - zero
    rows = np.concatenate([net / _CELL_KG, np.eye(len(CELLS)) / _CELL_GAIN])
    target = np.concatenate([(load[~empty] - net.sum(axis=1)) / _CELL_KG, np.zeros(len(CELLS))])
    return 1.0 + np.linalg.lstsq(rows, target, rcond=None)[0], zero


def _read_columns(path: Path, first: str) -> FloatArray:
    """Return the column ``first`` and the columns of the four cells, (K, 5); RecordingError if one is missing."""
    table = read_csv(path)
    expected = [first, *CELLS]
    missing = [name for name in expected if name not in table.names]
    if missing:
        raise RecordingError(
            f"{path}: has the columns {', '.join(table.names)[:120]}, without {', '.join(missing)}; expected "
            f"{', '.join(expected)}: the loads in kg at the top left, top right, bottom left and bottom right"
        )
    return table.select(expected)


def _resample(time: FloatArray, values: FloatArray) -> BoardLog:
    """Return load and moments (K, 3) at irregular times (K,), s, averaged over a window around times of equal steps."""
    stamps, row = np.unique(time, return_inverse=True)
    count = np.bincount(row)[:, None]
    values = np.stack([np.bincount(row, weights=column) for column in values.T], axis=1) / count
    interval = float(np.median(np.diff(stamps)))
    half = max(_WINDOW_S, _INTERVALS * interval) / 2.0
    even = np.arange(stamps[0] + half, stamps[-1] - half, 1.0 / _RATE)
    summed = np.zeros_like(values)
    np.cumsum((values[1:] + values[:-1]) / 2.0 * np.diff(stamps)[:, None], axis=0, out=summed[1:])

    def integral(at: FloatArray) -> FloatArray:
        low = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 2)
        past = (at - stamps[low])[:, None]
        slope = (values[low + 1] - values[low]) / np.diff(stamps)[low][:, None]
        return np.asarray(summed[low] + past * (values[low] + slope * past / 2.0))

    mean = (integral(even + half) - integral(even - half)) / (2.0 * half)
    long = np.flatnonzero(np.diff(stamps) > _LONGEST_GAP_S)
    unknown = np.zeros(len(even), dtype=np.bool_)
    for gap in long:
        unknown |= (even + half > stamps[gap]) & (even - half < stamps[gap + 1])
    mean[unknown] = np.nan
    averaged = float(np.sqrt((2.0 * half) ** 2 + 2.0 * interval**2))
    return BoardLog(float(even[0]), _RATE, mean[:, 0], mean[:, 1:], ~unknown, averaged, interval, len(long))
