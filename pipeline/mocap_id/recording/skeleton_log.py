"""Reader of skeletons: joint positions of a depth camera (CSV, text of Kinect v2) or of markerless software (TRC)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import check_axis
from mocap_id.recording.clock import SKELETON_HZ, check_times
from mocap_id.recording.held_samples import HeldSamples, describe_held, find_held, list_held
from mocap_id.recording.marker_positions import clean_positions, resolve_length_unit, rotate_z_up
from mocap_id.recording.model import Recording
from mocap_id.recording.skeleton_faults import check_depth, find_other_person, undo_exchanges
from mocap_id.recording.text_tables import TextTable, check_end, check_unique, read_csv, read_text, split_lines
from mocap_id.recording.trc_table import parse_trc
from mocap_id.verdict import Reason

KINECT_V2 = (
    *("SpineBase", "SpineMid", "Neck", "Head", "ShoulderLeft", "ElbowLeft", "WristLeft", "HandLeft"),
    *("ShoulderRight", "ElbowRight", "WristRight", "HandRight", "HipLeft", "KneeLeft", "AnkleLeft", "FootLeft"),
    *("HipRight", "KneeRight", "AnkleRight", "FootRight", "SpineShoulder", "HandTipLeft", "ThumbLeft"),
    *("HandTipRight", "ThumbRight"),
)
"""The 25 joints of a Kinect v2, in the order of its interface."""

_KINECT_RATE = 30.0
_TIMES = ("time_s", "time")
_INFERRED = 1
_LONGEST_STEP = 1.75  # largest step between two rows, in usual steps, that is interpolated
_ON_ROW = 0.02  # a time that is closer to a row than this, in usual steps, takes the values of the row
_LEAST_ROWS = 20
_FEW_SHORT, _MANY_SHORT = 0.01, 0.5  # shares of rows
_MANY_REPEATED = 0.1  # share of rows


@dataclass(frozen=True)
class SkeletonRecording:
    """A skeleton at times with a constant step: F frames of M joints."""

    recording: Recording  # joint positions in place of markers; NaN if a joint is missing
    inferred: BoolArray  # (F, M) whether the sensor inferred the position because it did not see the joint
    reasons: tuple[Reason, ...] = ()  # about rows that were left out or corrected


@dataclass(frozen=True)
class _Rows:
    """Rows of a file: K times, M joints."""

    format: str
    labels: tuple[str, ...]
    time: FloatArray  # (K,) s
    positions: FloatArray  # (K, M, 3) in the file's unit; NaN if missing
    inferred: BoolArray  # (K, M)
    units: str
    reasons: tuple[Reason, ...] = ()


def read_skeleton(path: Path, *, units: str | None = None, vertical: str | None = None) -> SkeletonRecording:
    """Read the joint positions of a skeleton and interpolate them to times with a constant step.

    Three formats are read. (1) TRC. (2) CSV with ``time_s`` (or ``time``), ``JOINT_x``, ``JOINT_y``, ``JOINT_z`` in m,
    and optionally ``JOINT_state`` (2 tracked, 1 inferred, 0 missing), in small or capital letters. (3) Text of a Kinect
    v2 with 75 or 175 numbers in each row: x y z, or x y z and a quaternion, of 25 joints, in m at 30 Hz.

    ``units`` replaces the usual or declared length unit; ``vertical`` is the axis of the file that points up, Y if
    omitted. Raises RecordingError if the file is missing or has another format, or its times do not increase. Raises
    ConfigError if ``units`` or ``vertical`` is unknown.
    """
    axis = "Y" if vertical is None else check_axis(vertical)
    oddities: list[str] = []
    rows = _read_rows(path, oddities)
    unit, metres = resolve_length_unit(path, rows.units, units, oddities, required=True)
    rows.positions[:] *= metres
    clean_positions(path, rows.positions, unit, oddities)
    check_depth(path, rows.positions, oddities)
    check_times(path, rows.time, "the time", SKELETON_HZ, repeated=True)
    reasons = (
        *rows.reasons,
        *undo_exchanges(rows.labels, rows.time, rows.positions, rows.inferred),
        *find_other_person(path, rows.time, rows.positions),
        *_leave_out_held(rows),
    )
    time, positions, inferred = _interpolate(path, rows, oddities)
    rotate_z_up(positions, axis)
    recording = Recording(
        files=(path,),
        format=rows.format,
        labels=rows.labels,
        positions=positions,
        frames=np.arange(len(time), dtype=np.int64),
        time=time,
        rate=float((len(time) - 1) / (time[-1] - time[0])),
        units=unit,
        vertical=axis,
        analog_rate=None,
        plates=(),
        oddities=tuple(oddities),
    )
    return SkeletonRecording(recording, inferred, reasons)


def _leave_out_held(rows: _Rows) -> tuple[Reason, ...]:
    """Set positions that software repeated or interpolated to NaN, in place, and return a reason if there are any."""
    held: list[HeldSamples] = []
    rate = (len(rows.time) - 1) / float(np.ptp(rows.time))
    for number, label in enumerate(rows.labels):
        found = find_held(rows.positions[:, number], rate)
        held += list_held(f"joint {label}", rows.time, *found)
        rows.positions[found[0] | found[1], number] = np.nan
    return describe_held(held)


def _read_rows(path: Path, oddities: list[str]) -> _Rows:
    text = read_text(path)
    if text[:400].lower().startswith("pathfiletype"):
        table = parse_trc(path, text, oddities)
        check_unique(path, table.labels)
        inferred = np.zeros(table.positions.shape[:2], dtype=np.bool_)
        return _Rows("skeleton (TRC)", tuple(table.labels), table.time, table.positions, inferred, table.units)
    first = text[:20000].lstrip("\ufeff \t\r\n").split("\n", 1)[0]
    if first[:1] and first[:1] in "-+.0123456789":
        return _read_kinect_rows(path, text, oddities)
    return _read_csv_rows(path)


def _read_kinect_rows(path: Path, text: str, oddities: list[str]) -> _Rows:
    """Return the rows of a text file of a Kinect v2, which has no header and no times."""
    lines = [line.replace(",", " ") for line in split_lines(text)]
    width = len(next(line for line in lines if line.strip()).split())
    joints = len(KINECT_V2)
    if width not in (3 * joints, 7 * joints):
        raise RecordingError(
            f"{path}: has no header and {width} numbers in its first row; expected a header with time_s and JOINT_x, "
            f"JOINT_y, JOINT_z, or rows of the {joints} joints of a Kinect v2 ({3 * joints} or {7 * joints} numbers)"
        )
    names = [str(k) for k in range(width)]
    table = TextTable(path, names, lines, 1, None)
    check_end(path, table, text)
    values = table.numbers()
    reasons = _leave_out_short_rows(table, values)
    values = values.reshape(len(values), joints, -1)
    if len(values) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(values)} rows, expected at least {_LEAST_ROWS}")
    oddities.append(f"{path.name} has no times: {_KINECT_RATE:.0f} rows per second are assumed, as a Kinect v2 has")
    time = np.arange(len(values)) / _KINECT_RATE
    inferred = np.zeros(values.shape[:2], dtype=np.bool_)
    return _Rows("skeleton (Kinect v2 text)", KINECT_V2, time, values[:, :, :3].copy(), inferred, "m", reasons)


def _read_csv_rows(path: Path) -> _Rows:
    table = read_csv(path)
    spelled = [name.strip() for name in table.names]
    names = [name.lower() for name in spelled]
    time = next((names.index(name) for name in _TIMES if name in names), None)
    labels = [name[:-2] for name, lower in zip(spelled, names, strict=True) if lower.endswith("_x")]
    labels = [label for label in labels if {f"{label}_y".lower(), f"{label}_z".lower()} <= set(names)]
    joints = [label.lower() for label in labels]
    if time is None or not joints:
        raise RecordingError(
            f"{path}: has the columns {', '.join(spelled)[:120]}; expected time_s, and JOINT_x, JOINT_y, JOINT_z in m "
            "for every joint, optionally JOINT_state"
        )
    values = table.numbers()
    clock = values[:, time].copy()
    reasons = _leave_out_short_rows(table, values)
    columns = [[names.index(f"{joint}_{axis}") for axis in "xyz"] for joint in joints]
    positions = values[:, np.array(columns)]
    inferred = np.zeros(positions.shape[:2], dtype=np.bool_)
    for k, joint in enumerate(joints):
        if f"{joint}_state" in names:
            state = values[:, names.index(f"{joint}_state")]
            inferred[:, k] = state == _INFERRED
            positions[(state < _INFERRED) | ~np.isfinite(state), k] = np.nan
    return _Rows("skeleton (CSV)", tuple(labels), clock, positions, inferred, "m", reasons)


def _leave_out_short_rows(table: TextTable, values: FloatArray) -> tuple[Reason, ...]:
    """Set rows with fewer cells than others to NaN, in place: their cells may belong to other columns.

    Raises RecordingError if most rows are like this.
    """
    cells = np.array([len(line.split(table.separator)) for line in table.lines if line.strip()], dtype=np.int64)
    short = cells < len(table.names)
    if not short.any():
        return ()
    share = float(short.mean())
    found = (
        f"{int(short.sum())} of {len(short)} rows have fewer cells than the {len(table.names)} columns, down to "
        f"{int(cells.min())}: it is not clear which joints are missing there"
    )
    if share > _MANY_SHORT:
        raise RecordingError(
            f"{table.path}: {found}; expected a cell for every column, empty if a joint is missing. Export it again"
        )
    values[short] = np.nan
    message = f"{found}. These rows are left out as missing; write an empty cell for each missing coordinate"
    return (Reason("skeleton-short-rows", message, share, _FEW_SHORT, "caution" if share > _FEW_SHORT else "ok"),)


def _interpolate(path: Path, rows: _Rows, oddities: list[str]) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return times (F,) with a constant step, s, positions (F, M, 3), and whether each is inferred (F, M).

    Positions are interpolated linearly between rows; they are NaN where rows are missing.
    """
    rows = _drop_repeated_times(path, rows, oddities)
    if len(rows.time) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(rows.time)} rows with different times, expected at least {_LEAST_ROWS}")
    steps = np.diff(rows.time)
    usual = float(np.median(steps))
    count = int(np.floor((rows.time[-1] - rows.time[0]) / usual + 1e-6)) + 1
    time = rows.time[0] + usual * np.arange(count)
    after = np.searchsorted(rows.time, time - 1e-9).clip(1, len(rows.time) - 1)
    share = ((time - rows.time[after - 1]) / steps[after - 1])[:, None]
    near = steps[after - 1] <= _LONGEST_STEP * usual
    low, high = rows.positions[after - 1], rows.positions[after]
    positions = low * (1 - share[..., None]) + high * share[..., None]
    for ends, at in ((low, share < _ON_ROW), (high, share > 1 - _ON_ROW)):  # the next row may be missing
        exact = np.flatnonzero(at[:, 0])
        positions[exact] = ends[exact]
        near[exact] = True
    positions[~near] = np.nan
    inferred = rows.inferred[after - 1] & (share < 1 - _ON_ROW) | rows.inferred[after] & (share > _ON_ROW)
    if np.max(np.abs(steps - usual)) > 0.05 * usual:
        missing = int(np.count_nonzero(~near))
        oddities.append(
            f"{path.name}: its times are uneven: the joints were interpolated at {1 / usual:.6g} Hz"
            + (f"; {missing} of {count} samples, where rows are missing, were left empty" if missing else "")
        )
    return time, positions, inferred


def _drop_repeated_times(path: Path, rows: _Rows, oddities: list[str]) -> _Rows:
    """Return the rows without repeated times; RecordingError if such rows have other positions."""
    keep = np.diff(rows.time, prepend=-np.inf) > 0
    if keep.all():
        return rows
    again = np.flatnonzero(~keep)
    same = (rows.positions[again] == rows.positions[again - 1]) | np.isnan(rows.positions[again])
    others = int(np.count_nonzero(~same.all(axis=(1, 2))))
    if others > _MANY_REPEATED * len(keep):
        raise RecordingError(
            f"{path}: {others} of {len(keep)} rows have the time of the row before, but other positions: the times are "
            "rounded too coarsely; expected a time for each row. Export them in seconds with at least three decimals"
        )
    oddities.append(f"{path.name}: {len(again)} rows repeat the time of the row before and were left out")
    return replace(rows, time=rows.time[keep], positions=rows.positions[keep], inferred=rows.inferred[keep])
