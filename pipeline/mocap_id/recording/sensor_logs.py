"""Readers of logs: encoder, force sensor, joint angles of another system, plates in a MOT table, balance board."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, find_complete_rows, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.c3d_reader import find_clipped
from mocap_id.recording.lab_plates import LOADED_N, reverse_force_on_plate
from mocap_id.recording.model import Plate, find_force_scale, find_moment_scale
from mocap_id.recording.sample_checks import (
    SENSOR_HZ,
    HeldSamples,
    check_times,
    find_held,
    fit_even_clock,
    list_held,
)
from mocap_id.recording.text_tables import (
    MotionTable,
    read_csv,
    read_table,
)

TIME, POSITION, VELOCITY, TORQUE = "time_s", "position_rad", "velocity_rad_s", "torque_Nm"

_LEAST_ROWS = 20  # of an encoder or a balance board
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

    The columns are ``time_s``, ``position_rad``, ``velocity_rad_s`` and optionally ``torque_Nm``, so that no unit is
    guessed. Raises RecordingError if the file is missing or not such a table, has other columns or empty cells, its
    times do not increase, or the velocity is not the derivative of the position.
    """
    table = read_csv(path)
    names = list(table.names)
    if sorted(names) not in (sorted([TIME, POSITION, VELOCITY]), sorted([TIME, POSITION, VELOCITY, TORQUE])):
        raise RecordingError(
            f"{path}: has the columns {', '.join(names)[:_MAX_SHOWN]}, {_EXPECTED}: convert to the "
            "units in these names and remove all other columns"
        )
    columns = dict(zip(names, table.numbers().T.copy(), strict=True))
    time, position, velocity = (columns[name] for name in (TIME, POSITION, VELOCITY))
    if len(time) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(time)} rows, expected at least {_LEAST_ROWS}")
    for name in (TIME, POSITION, VELOCITY):
        empty = np.flatnonzero(~np.isfinite(columns[name]))
        if len(empty):
            raise RecordingError(
                f"{path}: `{name}` has no number in line {empty[0] + 2} ({len(empty)} such lines): remove these "
                "lines; the times need not be evenly spaced"
            )
    check_times(path, time, f"`{TIME}`", SENSOR_HZ)
    # The velocity must be the derivative of the position; it is not with a wrong unit or direction.
    apart = max(1, round(_SPAN / float(np.median(np.diff(time)))))
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    by_velocity, by_position = (each[apart:] - each[:-apart] for each in (summed, position))
    size = float(by_velocity @ by_velocity)
    slope = float(by_velocity @ by_position) / size if size > 0.0 else 0.0
    if np.ptp(position) >= _MIN_MOVEMENT and not _ACCEPTED_RATIO[0] <= slope <= _ACCEPTED_RATIO[1]:
        ratio = abs(slope)
        hint = "of another joint or direction"
        for what, factor in (("position", DEGREES), ("velocity", 1.0 / DEGREES)):
            if _ACCEPTED_RATIO[0] <= ratio / factor <= _ACCEPTED_RATIO[1]:
                hint = f"in other units, the {what} in degrees"
        if _ACCEPTED_RATIO[0] <= ratio * 1000.0 <= _ACCEPTED_RATIO[1]:
            hint = f"in other units, or `{TIME}` is in milliseconds and must be in seconds"
        raise RecordingError(
            f"{path}: `{POSITION}` changes by {slope:.3g} times the integral of `{VELOCITY}`: one of them is {hint}; "
            "both must be in radians and of the same joint"
        )
    # An encoder repeats its angle while the joint rests; it repeats it wrongly if the velocity there is not zero.
    same = np.all(np.diff(np.column_stack([position, velocity]), axis=0) == 0.0, axis=1)
    rows = np.zeros(len(time), dtype=np.bool_)
    for run in find_runs(np.concatenate([[False], same])):
        moved = abs(velocity[run.start]) * float(time[run.stop - 1] - time[run.start - 1])
        rows[run] = run.stop - run.start >= _LEAST_HELD and moved > _HELD_MOVES
    held = list_held(f"the encoder ({path.name})", time, rows, np.zeros_like(rows))
    torque = columns.get(TORQUE)
    return EncoderLog(time[~rows], position[~rows], velocity[~rows], None if torque is None else torque[~rows], held)


def read_force_log(path: Path) -> tuple[Plate, tuple[HeldSamples, ...]]:
    """Read the log of a force sensor as a plate in the axes of the file, with evenly spaced times on its own clock.

    The columns are ``time_s``, ``Fx_N``, ``Fy_N``, ``Fz_N`` and optionally all of ``Mx_Nm``, ``My_Nm``, ``Mz_Nm``.
    Their names contain the units, so that no unit is guessed. The moment is about the point of application, and 0 if
    the file has none. Samples are NaN if a cell is empty, and in the rows that are also returned, which are repeated
    or interpolated. Raises RecordingError if the file is missing or not such a table, has other columns, or its times
    are not evenly spaced.
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
    stamps = values[:, 0]
    check_times(path, stamps, f"`{TIME}`", SENSOR_HZ, pauses=True)
    time = np.linspace(stamps[0], stamps[-1], len(stamps))
    step = float(time[1] - time[0])
    worst = int(np.argmax(np.abs(stamps - time)))
    if abs(stamps[worst] - time[worst]) > _MAX_ERROR * step:
        raise RecordingError(
            f"{path}: the times are not evenly spaced: row {worst + 2} has {stamps[worst]:g} s, expected "
            f"{time[worst]:g} s at {1 / step:.6g} Hz: samples are missing; export the file without gaps"
        )
    loaded = np.any(values[:, 1:4] != 0.0, axis=1)
    rows = [each & loaded for each in find_held(values[:, 1:], (len(time) - 1) / float(np.ptp(time)))]
    values[rows[0] | rows[1], 1:] = np.nan
    held = list_held(f"the sensor in {path.name}", time, *rows)
    resampled = np.column_stack([np.interp(time, stamps, column) for column in values[:, 1:].T])
    moment = resampled[:, 3:] if len(expected) > len(FORCE) + 1 else np.zeros((len(time), 3))
    force, rate = resampled[:, :3], float((len(time) - 1) / (time[-1] - time[0]))
    ok = find_complete_rows(np.hstack([force, moment]))
    return Plate(0, "sensor", None, force, moment, ok, rate, float(time[0])), held


def read_angles(path: Path, columns: Collection[str]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Read the given columns of joint angles from a MOT, STO or CSV file.

    Returns the times (K,), s, and the angles (K,) by column name, rad; NaN if a cell is empty. The header of a MOT or
    STO file says whether its angles are in degrees (``inDegrees``). In a CSV file the name of each column ends in
    ``_deg`` or ``_rad``, and the first column is ``time`` or ``time_s``, s. Raises ConfigError if the file lacks a
    column. Raises RecordingError if the file is missing or not such a table, its times do not increase, or a CSV
    column name has no unit.
    """
    if path.suffix.lower() != ".csv":
        motion = read_table(path)
        _check_columns(path, columns, motion.columns)
        factor = np.pi / 180.0 if motion.in_degrees else 1.0
        return motion.time, {name: motion[name] * factor for name in columns}
    table = read_csv(path)
    names = list(table.names)
    if names[0] not in _TIME:
        raise RecordingError(f"{path}: the first column is {names[:1]}, expected `time_s`")
    _check_columns(path, columns, names[1:])
    values = table.numbers()
    check_times(path, values[:, 0], f"`{names[0]}`", SENSOR_HZ, pauses=True)
    angles = {}
    for name in columns:
        factors = [factor for ending, factor in _TO_RAD.items() if name.lower().endswith(ending)]
        if not factors:
            raise RecordingError(f"{path}: column {name} has no unit in its name: the name must end in _deg or _rad")
        angles[name] = values[:, names.index(name, 1)] * factors[0]
    return values[:, 0], angles


def _check_columns(path: Path, columns: Collection[str], existing: Collection[str]) -> None:
    absent = [name for name in columns if name not in existing]
    if absent:
        shown = ", ".join(list(existing)[:12]) + (" …" if len(existing) > 12 else "")
        raise ConfigError(f"compare: columns: {path} has no column {', '.join(absent)}; it has {shown}")


_COLUMN = re.compile(r"^(?P<name>.*?)_?(?P<what>[vpm]?)(?P<axis>[xyz])$")
_WORDS = re.compile(r"ground|force|torque|moment|free|grf|grm|cop|fp|plate|_|\.|-", re.IGNORECASE)


PlateColumns: TypeAlias = dict[str, list[int]]
"""Numbers of the x, y and z columns of a plate's ``force``, ``point`` of application and ``moment``, if it has them."""


def find_force_columns(path: Path, table: MotionTable) -> dict[str, PlateColumns]:
    """Return the columns of each plate of a MOT table, by the name of the plate, which may be empty.

    Accepted names are ``ground_force_1_vx / _px / _mx``, ``1_ground_force_vx``, ``ground_force_vx``,
    ``ground_force_r_vx``, and for the moment ``ground_torque_x``, ``1_ground_torque_x``, ``ground_torque_1_x``.
    """
    found: dict[str, dict[str, dict[str, int]]] = {}
    for index, column in enumerate(table.columns):
        match = _COLUMN.match(column.lower())
        if match is None:
            continue
        name = match["name"]
        what = {"v": "force", "p": "point", "m": "moment"}.get(match["what"])
        if what is None:
            what = "moment" if re.search("torque|moment|grm", name) else None
        if what is not None:
            axes = found.setdefault(_WORDS.sub("", name), {}).setdefault(what, {})
            if match["axis"] in axes:
                raise RecordingError(
                    f"{path}: the columns `{table.columns[axes[match['axis']]]}` and `{column}` are the same quantity "
                    "of the same plate; remove or rename one of them"
                )
            axes[match["axis"]] = index
    groups = {name: parts for name, parts in found.items() if "force" in parts}
    if not groups:
        raise RecordingError(
            f"{path}: no column is a ground force ({', '.join(table.columns[:3])} …); expected names such as "
            "ground_force_1_vx, ground_force_1_px, ground_torque_1_x"
        )
    for name, parts in groups.items():
        for what in ("force", "point", "moment"):
            axes = parts.get(what, {})
            if axes and set(axes) != set("xyz"):
                raise RecordingError(f"{path}: the {what} {name or '(unnamed)'} has only the components {sorted(axes)}")
    return {
        name: {what: [axes[axis] for axis in "xyz"] for what, axes in parts.items()} for name, parts in groups.items()
    }


def read_mot_plates(
    path: Path,
    table: MotionTable,
    columns: Mapping[str, PlateColumns],
    oddities: list[str],
    *,
    rotation: FloatArray,
    units: Mapping[str, str],
) -> tuple[Plate, ...]:
    """Return the plates of a MOT table in the lab, and add notes to ``oddities``.

    ``rotation`` (3, 3) turns from the table's axes to those of the lab. The units are m, N and N·m unless ``units`` has
    others.
    """
    newtons = find_force_scale(units.get("force", "N")) or 1.0
    newton_metres = find_moment_scale(units.get("moment", "Nm")) or 1.0
    start, rate, note = fit_even_clock(path, table.time, fastest=SENSOR_HZ)
    if note:
        oddities.append(f"{path.name}: {note}")
    plates = []
    for index, (name, each) in enumerate(columns.items(), start=1):
        force = table.values[:, each["force"]] @ rotation.T * newtons
        if "point" not in each:
            moment, problem = np.full_like(force, np.nan), "the table has no point of application"
        else:
            free: FloatArray | float = 0.0
            if "moment" not in each:
                oddities.append(f"plate {index} ({name}): no moment columns, a free moment of 0 was assumed")
            else:
                free = table.values[:, each["moment"]] @ rotation.T * newton_metres
            moment, problem = np.cross(table.values[:, each["point"]] @ rotation.T, force) + free, ""
        force, moment = reverse_force_on_plate(index, force, moment, np.isfinite(force[:, 2]), oddities)
        if not np.any(force):
            oddities.append(f"plate {index} ({name}) is zero throughout")
        if problem:
            oddities.append(f"plate {index} is not used: {problem}")
            force = np.full_like(force, np.nan)
        finite = np.asarray(np.isfinite(force).all(axis=1) & np.isfinite(moment).all(axis=1))
        full = find_clipped(force[:, 2]) if finite.any() else ~finite
        if full.any():
            oddities.append(
                f"plate {index}: {int(full.sum())} samples are saturated: they repeat an extreme of the load"
            )
        loaded = finite.any() and np.ptp(force[finite, 2]) > LOADED_N
        dead = tuple(
            (table.columns[column], rotation[:, axis])
            for axis, column in enumerate(each["force"])
            if loaded and np.ptp(table.values[finite, column]) == 0.0
        )
        saturated = full if full.any() else None
        ok = finite & ~full
        plates.append(Plate(index, "mot", None, force, moment, ok, rate, start, problem, (), saturated, dead))
    return tuple(plates)


CELLS = ("tl_kg", "tr_kg", "bl_kg", "br_kg")
LOAD = "load_kg"
CELLS_BELOW_SURFACE_M = 0.053
"""Depth of the cells below the surface on which the person stands, m."""

_WIDTH_M, _DEPTH_M = 0.433, 0.238  # distances of the cells, left to right and bottom to top
_ACROSS = np.array([-1.0, 1.0, -1.0, 1.0]) * _WIDTH_M / 2.0  # m, position of each cell to the right of the centre
_ALONG = np.array([1.0, 1.0, -1.0, -1.0]) * _DEPTH_M / 2.0  # m, position of each cell towards the top
_RATE = 200.0  # Hz, after resampling
_WINDOW_S, _INTERVALS = 0.025, 2.0  # the window is as long as the larger of 25 ms and 2 intervals
_LONGEST_GAP_S = 0.15  # in a longer gap the load is not known
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
    problem: str  # reason why the loads cannot be used, or empty
    held: tuple[HeldSamples, ...]  # repeated or interpolated rows, which are left out


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
    values = _read_board_columns(path, TIME)
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
        gain, zero = calibrate_cells(_read_board_columns(loads, LOAD))
        cells = (cells - zero) * gain
    rate = (len(time) - 1) / float(np.ptp(time))
    rows = [each & (np.abs(cells).sum(axis=1) > _UNLOADED_KG) for each in find_held(cells, rate)]
    kept = ~rows[0] & ~rows[1]
    newtons = cells[kept] * GRAVITY
    held = list_held(f"the balance board ({path.name})", time, *rows)
    stretches = [np.searchsorted(time[kept], first) for each in held for first, _ in each.stretches]
    filled = sum(time[kept][k] - time[kept][k - 1] > _LONGEST_GAP_S for k in stretches if 0 < k < kept.sum())
    # Load and moments (K, 3), averaged over a window around times of equal steps
    stamps, row = np.unique(time[kept], return_inverse=True)
    values = np.column_stack([newtons.sum(axis=1), newtons @ _ACROSS, newtons @ _ALONG])
    values = np.stack([np.bincount(row, weights=column) for column in values.T], axis=1) / np.bincount(row)[:, None]
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
    gaps = np.flatnonzero(np.diff(stamps) > _LONGEST_GAP_S)
    unknown = np.zeros(len(even), dtype=np.bool_)
    for gap in gaps:
        unknown |= (even + half > stamps[gap]) & (even - half < stamps[gap + 1])
    mean[unknown] = np.nan
    # A cell is dead if it does not follow the person although others do.
    problem, varies = "", np.ptp(np.percentile(cells, [1, 99], axis=0), axis=0)
    dead = varies < _DEAD_SHARE * varies.max() if varies.max() > _MOVED_KG else np.ptp(cells, axis=0) == 0.0
    if dead.any() and not dead.all():
        listed = ", ".join(
            f"`{name}` stays near {np.median(each):.1f} kg"
            for name, each in zip(np.array(CELLS)[dead], cells.T[dead], strict=True)
        )
        problem = (
            f"{listed} while the load of the other cells varies by up to {varies.max():.0f} kg: the cell is dead or "
            "its column is wrong. Mass, force and centre of pressure would be wrong; check the board with a known "
            "weight on each corner"
        )
    return BoardLog(
        start=float(even[0]),
        rate=_RATE,
        force=mean[:, 0],
        moment=mean[:, 1:],
        ok=~unknown,
        averaged=float(np.sqrt((2.0 * half) ** 2 + 2.0 * interval**2)),
        interval=interval,
        gaps=len(gaps) - int(filled),
        problem=problem,
        held=held,
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


def _read_board_columns(path: Path, first: str) -> FloatArray:
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
