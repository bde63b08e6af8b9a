"""Reader of TRC files, alone or with ground forces in a MOT file."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, is_time_axis
from mocap_id.errors import RecordingError
from mocap_id.recording.axes import nearest_axis, to_z_up
from mocap_id.recording.channel_units import ForceUnits
from mocap_id.recording.labels import name_markers
from mocap_id.recording.marker_positions import clean, resolve_length_unit, turn_z_up
from mocap_id.recording.model import Plate, Recording
from mocap_id.recording.mot_plates import ForceColumns, find_forces, mot_plates
from mocap_id.recording.text_tables import MotionTable, TextTable, parse_count, read_table, read_text, split_lines
from mocap_id.recording.time_stamps import fit_even_clock

_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers
_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class _Trc:
    """Content of a TRC file in its own units and axes."""

    labels: list[str]
    frames: IntArray
    time: FloatArray
    positions: FloatArray
    rate: float
    units: str


def read_trc(
    path: Path, forces: Path | None, units: str | None, vertical: str | None, force_units: ForceUnits
) -> Recording:
    """Read a TRC file and its MOT file, if any; see :func:`mocap_id.recording.read`."""
    oddities: list[str] = []
    trc = _parse(path, read_text(path), oddities)
    unit, metres = resolve_length_unit(path, trc.units, units, oddities)
    naming = name_markers(trc.labels)
    oddities += naming.oddities
    positions = trc.positions[:, list(naming.keep)] * metres
    clean(path, positions, unit, oddities)
    table = None if forces is None else read_table(forces)
    columns = [] if table is None or forces is None else find_forces(forces, table)
    up = _vertical(table, columns, vertical, oddities)
    turn = to_z_up(up)
    turn_z_up(positions, up)
    plates: tuple[Plate, ...] = ()
    if table is not None and forces is not None:
        plates = mot_plates(forces, table, columns, oddities, turn=turn, units=force_units)
        _compare_spans(path, forces, trc.time, table.time, oddities)
    return Recording(
        files=(path,) if forces is None else (path, forces),
        format="TRC" if forces is None else "TRC + MOT",
        labels=naming.labels,
        positions=positions,
        frames=trc.frames,
        time=trc.time,
        rate=trc.rate,
        units=unit,
        vertical=up,
        analog_rate=plates[0].rate if plates else None,
        plates=plates,
        oddities=tuple(oddities),
    )


def _parse(path: Path, text: str, oddities: list[str]) -> _Trc:
    lines = split_lines(text)
    if len(lines) < 5 or not lines[0].lower().startswith("pathfiletype"):
        raise RecordingError(
            f"{path}: not a TRC file: the first line is {lines[0][:40]!r}, expected 'PathFileType …'"
            if lines
            else f"{path}: the file is empty"
        )
    header = _header(path, lines[1], lines[2])
    labels = _labels(path, lines[3], header, oddities)
    rows = _rows(path, lines, len(labels))
    declared = parse_count(header.get("numframes"))
    if declared is None:
        stated = header.get("numframes", "")[:40]
        oddities.append(f"the header has no valid number of frames ({stated!r}): {len(rows)} were read")
    elif declared != len(rows):
        raise RecordingError(
            f"{path}: {'truncated: ' if len(rows) < declared else ''}the header declares {declared} frames, "
            f"the file contains {len(rows)}; copy or export it again"
        )
    time = rows[:, 1]
    if not is_time_axis(time):
        raise RecordingError(f"{path}: the Time column does not increase from frame to frame; export it again")
    time, rate = _even(path, header.get("datarate", ""), time, oddities)
    positions = rows[:, 2:].reshape(len(rows), -1, 3)
    return _Trc(labels, rows[:, 0].astype(np.int64), time, positions, rate, header.get("units", ""))


def _header(path: Path, names: str, values: str) -> dict[str, str]:
    keys = [name.strip().lower() for name in names.split()]
    cells = values.split()
    if len(cells) < len(keys):  # a blank cell would shift the others
        cells = [value.strip() for value in values.split("\t")]
    if "nummarkers" not in keys or "datarate" not in keys:
        raise RecordingError(
            f"{path}: the second line should contain DataRate, NumMarkers, Units …; export it again as TRC"
        )
    return dict(zip(keys, cells, strict=False))


def _labels(path: Path, line: str, header: dict[str, str], oddities: list[str]) -> list[str]:
    cells = line.rstrip().split("\t")
    labels = [cell.strip() for cell in cells[2::3]] if len(cells) > 2 else line.split()[2:]
    declared = parse_count(header.get("nummarkers"))
    if declared is not None and declared != len(labels):
        oddities.append(f"the header declares {declared} markers but names {len(labels)}: the named ones were read")
    if not labels:
        raise RecordingError(f"{path}: the file contains no markers")
    return labels


def _rows(path: Path, lines: list[str], markers: int) -> FloatArray:
    """Parse frame number, time and coordinates, (F, 2 + 3M); blank cells are NaN."""
    body = list(itertools.dropwhile(lambda line: not line.lstrip()[:1].isdigit(), lines[4:]))
    if not body:
        raise RecordingError(f"{path}: no frames follow the header")
    names = ["Frame#", "Time", *(f"{axis}{marker}" for marker in range(1, markers + 1) for axis in "XYZ")]
    separator = "\t" if "\t" in body[0] else None
    rows = TextTable(path, names, body, len(lines) - len(body) + 1, separator).numbers()
    numbered = np.asarray(np.isfinite(rows[:, :2]).all(axis=1) & (np.abs(rows[:, 0]) < _MAX_FRAME_NUMBER))
    if not numbered.all():
        row = int(np.flatnonzero(~numbered)[0])
        raise RecordingError(f"{path}: row {row + 1} of the frames has no frame number or time; export it again")
    return rows


def _even(path: Path, declared: str, time: FloatArray, oddities: list[str]) -> tuple[FloatArray, float]:
    """Return evenly spaced times fitted to the Time column, and the frame rate."""
    try:
        stated = float(declared)
    except ValueError:
        stated = None
    if stated is not None and not 0 < stated < np.inf:
        raise RecordingError(f"{path}: DataRate is {declared[:40]} Hz, expected a positive number; export it again")
    clock = fit_even_clock(path, time, stated)
    if stated is not None and abs(clock.rate / stated - 1) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: DataRate is {declared} Hz, the Time column has {clock.rate:.6g} Hz; times must be in seconds: "
            "export it again, or correct the wrong one"
        )
    if stated is not None and clock.rate != stated:
        oddities.append(f"DataRate is {declared} Hz, the Time column has {clock.rate:.6g} Hz: the latter was used")
    if clock.rounding_note:
        oddities.append(f"{path.name}: {clock.rounding_note}")
    return clock.times(len(time)), clock.rate


def _vertical(table: MotionTable | None, columns: list[ForceColumns], override: str | None, oddities: list[str]) -> str:
    """Return the upward axis: configured, or along the mean ground force, or Y as usual for the format."""
    found = None
    if table is not None and columns:
        total = sum((np.nan_to_num(table.values[:, list(each.force)]) for each in columns), np.zeros((1, 3)))
        axis = nearest_axis(np.mean(total, axis=0), 0.9)
        found = None if axis is None else axis.lstrip("-")
    if override is not None:
        if found is not None and found != override.lstrip("-"):
            oddities.append(
                f"the ground force acts along {found}, the configuration says {override} is up: {override} was used"
            )
        return override
    if found is not None:
        return found
    oddities.append(
        "the files do not say which axis is up: Y was assumed, as in OpenSim (if it is another, set `vertical:`)"
    )
    return "Y"


def _compare_spans(markers: Path, forces: Path, a: FloatArray, b: FloatArray, oddities: list[str]) -> None:
    """Note a different time span of two files, which share a clock; refuse files that do not overlap."""
    spans = f"{markers.name} runs from {a[0]:g} to {a[-1]:g} s, {forces.name} from {b[0]:g} to {b[-1]:g} s"
    if b[-1] < a[0] or b[0] > a[-1]:
        raise RecordingError(f"{spans}: they do not overlap, so they are of different trials or on different clocks")
    step = max((a[-1] - a[0]) / (len(a) - 1), (b[-1] - b[0]) / (len(b) - 1))
    if abs(a[0] - b[0]) > 1.5 * step or abs(a[-1] - b[-1]) > 1.5 * step:
        oddities.append(f"{spans}: forces are missing outside the common part")
