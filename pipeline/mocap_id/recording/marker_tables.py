"""Parsers of markers in text: TRC, and the exports of Qualisys QTM (TSV), OptiTrack Motive and Vicon Nexus (CSV)."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.recording.sample_checks import check_rate, fit_even_clock
from mocap_id.recording.text_tables import TextTable, has_final_line_end, parse_count, split_lines

NEXUS_SECTIONS = frozenset(("trajectories", "devices", "joints", "model outputs", "segments"))
"""Names of the parts of a Nexus export, in lower case."""

_HEADER_LINES = 1000
_QTM_KEY = re.compile(r"[A-Z][A-Z_]+(\t|$)")
_NUMBER = re.compile(r"[-+.,\d][-+.,\deE]*|NULL|NaN", re.IGNORECASE)  # decimal commas are an error of their own
_PADDING = ",;\t \ufeff"  # characters that spreadsheets add to short lines
_TRC_TABLE_HEADER_LINES = 12
_NAMES = re.compile(r"\W*frame\b", re.IGNORECASE)
_AXIS = re.compile(r"[XYZ]\d+")
_SHORT_KEYS = {"nummarker": "nummarkers", "numframe": "numframes"}  # spellings of other programs, by lower-case name
_MAX_FRAME_NUMBER = 1e15  # larger floats are not exact integers
_MAX_RATE_ERROR = 0.02  # a larger difference is not rounding (59.94 written as 60)


@dataclass(frozen=True)
class MarkerTable:
    """Marker trajectories in the units and axes of the file: F frames of M markers."""

    format: str  # name of the format, such as ``"TRC"`` or ``"Motive CSV"``
    labels: Sequence[str]  # M marker names as in the file
    frames: IntArray  # (F,) frame numbers in the file
    time: FloatArray  # (F,) times with a constant step, s
    positions: FloatArray  # (F, M, 3) in the unit of the file; NaN if missing
    rate: float  # frames per second
    units: str  # length unit that the file or its format declares, possibly empty
    up: str  # upward axis that is usual for the format
    outputs: Sequence[str] = ()  # labels that the file declares as computed, not measured


def parse_trc(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a TRC file.

    The number of markers follows from NumMarkers, the line with names, the line with X1 Y1 Z1 … and the widest row. If
    they contradict each other, the number on which all of them but one agree is used, with a note.
    """
    # The lines of the header are found by their content; lines may be missing or added.
    lines = split_lines(text)
    if not lines:
        raise RecordingError(f"{path}: the file is empty")
    named = next((k for k in range(1, min(len(lines), _TRC_TABLE_HEADER_LINES)) if _NAMES.match(lines[k])), None)
    if "pathfiletype" not in lines[0].lower() or (named is None and len(lines) >= 5):
        raise RecordingError(f"{path}: not a TRC file: the first line is {lines[0][:40]!r}, expected 'PathFileType …'")
    if named is None:
        raise RecordingError(f"{path}: the file ends within its header; copy or export it again")
    at = next((k for k in range(1, named) if "datarate" in lines[k].lower()), None)
    if at is None:
        raise RecordingError(
            f"{path}: the second line should contain DataRate, NumMarkers, Units …; export it again as TRC"
        )
    # Values by lower-case name; a value may contain spaces only if tabs separate the values.
    between = "," if "," in lines[at] and "\t" not in lines[at] else "\t"
    keys = [key.lower() for key in lines[at].replace(between, " ").split()]
    following = next((line for line in lines[at + 1 : named] if line.strip()), "")
    cells, words = [cell.strip() for cell in following.split(between)], following.replace(between, " ").split()
    if len(words) >= len(keys) and len(cells) != len(keys):  # a blank cell would shift the words
        cells = words
    header = dict(zip((_SHORT_KEYS.get(key, key) for key in keys), cells, strict=False))
    first = next((k for k in range(named + 1, len(lines)) if lines[k].lstrip()[:1].isdigit()), None)
    if first is None:
        raise RecordingError(f"{path}: no frames follow the header")
    # Marker names, and the number of cells such as X1
    separator = next((each for each in ("\t", ",") if each in lines[named]), None)
    names = lines[named].rstrip().rstrip(separator).split(separator)
    if separator == "\t" and sum(map(bool, names)) <= 2:  # spaces separate the names
        separator, names = None, lines[named].split()
    names = [name.strip() for name in names[2:]]
    axes = sum(len(_AXIS.findall(line)) for line in lines[named + 1 : first])
    # Rows, without the columns to the right of the named markers
    body = lines[first:]
    if all(row[:1] in ("\t", "") for row in body):  # the first column is blank
        body = [row[1:] for row in body]
    usual = "," if separator == "," else "\t"
    separated = usual in body[0] and len(body[0].split(usual, 1)[0].split()) == 1
    mark = usual if separated else None  # None: white space separates the cells, so that no cell can be blank
    filled = [row.rstrip() if mark is None else row.rstrip().rstrip(mark) for row in body]
    counts = [len(row.split()) if mark is None else row.count(mark) + 1 for row in filled]
    numbers = {"NumMarkers": parse_count(header.get("nummarkers")), "the X1 Y1 Z1 line": axes // 3 or None}
    labels = _find_labels(path, names, numbers, max(counts), oddities, spaces=separator is None)
    width = 2 + 3 * len(labels)
    if mark is None:
        odd = next((k for k, count in enumerate(counts) if count not in (0, width)), None)
        if odd is not None:
            raise RecordingError(
                f"{path}: line {first + odd + 1} has {counts[odd]} cells between spaces, expected {width}: "
                "a missing marker cannot be located; export the file with tabs"
            )
    elif max(counts) > width:
        body = [mark.join(row.split(mark)[:width]) if mark in row else row for row in body]
    columns = ["Frame#", "Time", *(f"{axis}{marker}" for marker in range(1, len(labels) + 1) for axis in "XYZ")]
    table = TextTable(path, columns, body, first + 1, mark)
    rows = table.numbers()
    table.check_triples(rows, 2)
    declared = parse_count(header.get("numframes"))
    if declared is None:
        stated = header.get("numframes", "")[:40]
        oddities.append(f"the header has no valid number of frames ({stated!r}): {len(rows)} were read")
    oddities += table.check_count(declared, rows, ended=has_final_line_end(text))
    frames = check_frame_numbers(path, np.where(np.isfinite(rows[:, 1]), rows[:, 0], np.nan), consecutive=False)
    time, rate = fit_clock(path, header.get("datarate", ""), rows[:, 1], oddities, "DataRate")
    units = header.get("units", "")
    return MarkerTable("TRC", labels, frames, time, rows[:, 2:].reshape(len(rows), -1, 3), rate, units, "Y")


def _find_labels(
    path: Path,
    cells: Sequence[str],
    numbers: dict[str, int | None],
    widest: int,
    oddities: list[str],
    *,
    spaces: bool,
) -> list[str]:
    """Return the marker names of a TRC file in the order of the columns.

    Names usually start three columns apart. If they do not, they belong to the columns in their order, provided that
    every other line has as many markers (``numbers``) as there are names. ``widest`` is the number of cells in the
    widest row.
    """
    spaced = list(cells) if spaces else list(cells[::3])
    listed = [cell for cell in cells if cell]
    in_place = spaces or not any(cell for k, cell in enumerate(cells) if k % 3)
    declared = numbers["NumMarkers"]
    stated = {name: count for name, count in numbers.items() if count is not None}
    width = -(-(widest - 2) // 3)
    if not listed:
        raise RecordingError(f"{path}: the file contains no markers")
    found = ", ".join(f"{name} {count}" for name, count in stated.items())
    others = set(stated.values())
    if others == {len(listed)} and width <= len(listed) and (not in_place or len(spaced) != len(listed)):
        oddities.append(
            f"the marker names are not three columns apart: the {len(listed)} names were used in their order, since "
            f"all other lines have as many markers ({found}; rows with the coordinates of {width})"
        )
        return listed
    if not in_place or (spaces and others and len(spaced) not in others):
        raise RecordingError(
            f"{path}: the lines contradict each other on the number of markers: {len(listed)} names, which are not "
            f"three columns apart; {found or 'no NumMarkers'}; rows with the coordinates of {width}. Correct the "
            "header, or export it again"
        )
    if width > len(spaced):
        if (widest - 2) % 3 or len(spaced) not in others:
            raise RecordingError(
                f"{path}: the widest row has {widest} cells, expected at most {2 + 3 * len(spaced)} for {len(spaced)} "
                f"names ({found or 'no NumMarkers'}); export it again"
            )
        agreeing = " and ".join(name for name, count in stated.items() if count == len(spaced))
        oddities.append(
            f"{width - len(spaced)} trajectories to the right of the {len(spaced)} named markers have no name and were "
            f"not read ({agreeing} also has {len(spaced)})"
        )
    elif declared is not None and declared != len(spaced):
        oddities.append(f"the header declares {declared} markers but names {len(spaced)}: the named markers were read")
    return spaced


def parse_qtm(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a QTM motion data file (TSV, 3D data), whose positions are in mm.

    Source: Qualisys Track Manager manual, "Motion data (.tsv)".
    """
    lines = split_lines(text)
    # The first row of numbers is after the last key and after any line of column names, which contain words.
    keys = [k for k, line in enumerate(lines[:_HEADER_LINES]) if _QTM_KEY.match(line)]
    first = keys[-1] + 1 if keys else 0
    while first < len(lines) and (
        not lines[first]
        or any(cell.strip() and not _NUMBER.fullmatch(cell.strip()) for cell in lines[first].split("\t"))
    ):
        first += 1
    split = [line.rstrip().split("\t") for line in lines[:first]]
    header = {cells[0].strip().lower(): cells[1:] for cells in split if len(cells) > 1}
    included, no_of_frames, no_of_markers, stated = (
        next(iter(header.get(key, [])), "").strip()
        for key in ("data_included", "no_of_frames", "no_of_markers", "frequency")
    )
    labels = [cell.strip() for cell in header.get("marker_names", [])]
    if included.upper() not in ("", "3D") or not labels:
        raise RecordingError(
            f"{path}: the QTM file contains {included or 'no'} data and {len(labels)} MARKER_NAMES, expected 3D data "
            "with names; export the 3D data with the TSV header"
        )
    if first == len(lines):
        raise RecordingError(f"{path}: no frames follow the header")
    timed = "frame" in header
    if not timed:  # frame number and time may still precede the coordinates, judged by the number of cells
        least = max(row.rstrip("\r\n ").rstrip("\t").count("\t") + 1 for row in lines[first:])
        most = max(row.count("\t") + 1 for row in lines[first:])
        width = 3 * len(labels)
        fitting = [extra for extra in (0, 2) if least <= width + extra <= most <= width + extra + 1]
        if not fitting:
            raise RecordingError(
                f"{path}: the rows have {most} cells; {len(labels)} MARKER_NAMES need {width}, or {width + 2} with "
                "frame and time; export it again"
            )
        timed = bool(fitting[0])
    names = [*(["Frame", "Time"] if timed else ["Frame"]), *(f"{label} {axis}" for label in labels for axis in "XYZ")]
    body = [line.removesuffix("\t") for line in lines[first:]]  # some versions end each line with a separator
    if not timed:  # with a frame number before each row, rows without any visible marker are kept
        while body and not body[-1]:
            body.pop()
        if "" in body:
            empty = first + body.index("") + 1
            raise RecordingError(f"{path}: line {empty} is empty; export the file with frame numbers")
        body = [f"{number}\t{row}" for number, row in enumerate(body, start=1)]
    table = TextTable(path, names, body, first + 1, "\t")
    rows = table.numbers()
    table.check_triples(rows, len(names) - 3 * len(labels))
    declared = parse_count(no_of_frames)
    if not timed and declared != len(rows):  # a missing row could be anywhere
        raise RecordingError(
            f"{path}: NO_OF_FRAMES is {declared}, the file contains {len(rows)} rows without frame numbers; export it "
            "again, with the time data"
        )
    oddities += table.check_count(declared, rows, ended=has_final_line_end(text))
    frames = check_frame_numbers(path, rows[:, 0], consecutive=True)
    if timed:
        time, rate = fit_clock(path, stated, rows[:, 1], oddities, "FREQUENCY")
    else:
        time, rate = _compute_times(path, frames - 1, stated, "FREQUENCY")
    count = parse_count(no_of_markers)
    if count is not None and count != len(labels):
        oddities.append(f"the header declares {count} markers but names {len(labels)}: the rows have {len(labels)}")
    kinds = [kind.strip().lower() for kind in header.get("trajectory_types", [])]
    virtual = [label for label, kind in zip(labels, kinds, strict=False) if kind == "virtual"]
    positions = rows[:, len(names) - 3 * len(labels) :].reshape(len(rows), -1, 3)
    return MarkerTable("QTM TSV", labels, frames, time, positions, rate, "mm", "Z", virtual)


def parse_motive(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a Motive CSV export: measured markers only, not markers that Motive computed from bodies.

    Source: OptiTrack documentation, "Data Export: CSV".
    """
    lines = split_lines(text)
    first = next((k for k, line in enumerate(lines[:_HEADER_LINES]) if line.lower().startswith("frame,")), None)
    above = [] if first is None else [_split_cells(line) for line in lines[1:first] if line.strip(_PADDING)]
    if first is None or len(above) < 3:
        raise RecordingError(
            f"{path}: the Motive file has no complete header above its frames; export it with a header"
        )
    info = _split_cells(lines[0])
    space = _get_after(info, "Coordinate Space")
    if space.lower() not in ("", "global"):
        raise RecordingError(f"{path}: the coordinates are {space}; export them in the Global coordinate space")
    axes = _split_cells(lines[first])
    kinds, names, quantities = (_pad(row, len(axes)) for row in (above[0], above[1], above[-1]))
    chosen = [
        k for k in range(2, len(axes)) if kinds[k].lower() == "marker" and quantities[k].lower() in ("position", "")
    ]
    labels = _name_triples(path, [names[k] for k in chosen], [axes[k] for k in chosen])
    others = sorted({kind for kind in kinds[2:] if kind and kind.lower() != "marker"})
    if not labels:
        raise RecordingError(
            f"{path}: the Motive file contains no measured markers, only {', '.join(others)}: positions solved from "
            "bodies are not measurements; export it again with Markers"
        )
    if others:
        oddities.append(f"columns of other kinds were not read, since they are computed: {', '.join(others)}")
    columns = [f"{name} {axis}" for name, axis in zip(names, axes, strict=True)]
    table = TextTable(path, columns, lines[first + 1 :], first + 2, ",")
    rows = table.numbers()
    if not len(rows):
        raise RecordingError(f"{path}: no frames follow the header")
    if chosen == list(range(2, len(axes))):  # else other columns follow the markers
        table.check_triples(rows, 2)
    declared = parse_count(_get_after(info, "Total Exported Frames"))
    oddities += table.check_count(declared, rows, ended=has_final_line_end(text))
    frames = check_frame_numbers(path, rows[:, 0], consecutive=True)
    time, rate = fit_clock(path, _get_after(info, "Export Frame Rate"), rows[:, 1], oddities, "Export Frame Rate")
    units = _get_after(info, "Length Units")
    positions = rows[:, chosen].reshape(len(rows), -1, 3)
    return MarkerTable("Motive CSV", labels, frames, time, positions, rate, units, "Y")


def parse_nexus(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the section ``Trajectories`` of a Nexus ASCII export; commas, semicolons or tabs separate its cells.

    Source: Vicon Nexus user guide, "Export ASCII".
    """
    lines = split_lines(text)
    sections = {line.strip(_PADDING).lower(): k for k, line in enumerate(lines) if line[:1].isalpha()}
    start = sections.get("trajectories")
    if start is None or len(lines) < start + 6:
        raise RecordingError(f"{path}: the Nexus file has no section Trajectories; export it with the trajectories")
    separator = next((each for each in ";\t" if each in lines[start + 3]), ",")
    rate, names, axes, units = (
        [cell.strip().strip('"') for cell in line.split(separator)] for line in lines[start + 1 : start + 5]
    )
    before = next((k for k, cell in enumerate(axes) if cell.upper() == "X"), 0)
    if before not in (1, 2) or not axes[0].lower().startswith("frame"):
        raise RecordingError(f"{path}: line {start + 4} should begin with Frame, Sub Frame, X, Y, Z; export it again")
    width = before + len([cell for cell in axes[before:] if cell])
    own = _pad(names, width)[before:width]
    repeated = [name or own[k - k % 3] for k, name in enumerate(own)]  # the file names only the column of X
    labels = _name_triples(path, repeated, axes[before:width])
    declared = sorted({unit for unit in units[before:width] if unit})
    if len(declared) > 1:
        raise RecordingError(f"{path}: the trajectories have several units ({', '.join(declared)}); export all in one")
    body = lines[start + 5 :]  # it ends before the next section; a line within it may be blank
    end = next((k for k, line in enumerate(body) if line.strip(_PADDING)[:1].isalpha()), len(body))
    while end and not body[end - 1].strip(_PADDING):
        end -= 1
    ended = has_final_line_end(text) or start + 5 + end < len(lines)
    body = [line if line.strip(_PADDING) else "" for line in body[:end]]
    if separator == ";":
        body = [line.replace(",", ".") for line in body]
    columns = [*axes[:before], *(f"{label} {axis}" for label in labels for axis in "XYZ")]
    table = TextTable(path, columns, [line.rstrip(separator) for line in body], start + 6, separator)
    rows = table.numbers()
    if not len(rows):
        raise RecordingError(f"{path}: no frames follow the header")
    table.check_triples(rows, before)
    oddities += table.check_count(None, rows, ended=ended)
    if before == 2 and np.nan_to_num(rows[:, 1]).any():
        raise RecordingError(f"{path}: the trajectories have sub-frames, expected one row for a frame; export it again")
    frames = check_frame_numbers(path, rows[:, 0], consecutive=True)
    time, hertz = _compute_times(path, frames - min(int(frames[0]), 1), rate[0], "the rate of the trajectories")
    if "devices" in sections:
        oddities.append(
            "the section Devices was not read: the file does not say where its force plates are; export the trial as "
            "C3D to use them"
        )
    unit = declared[0] if declared else ""
    positions = rows[:, before:].reshape(len(rows), -1, 3)
    return MarkerTable("Nexus CSV", labels, frames, time, positions, hertz, unit, "Z")


def fit_clock(path: Path, declared: str, time: FloatArray, oddities: list[str], name: str) -> tuple[FloatArray, float]:
    """Return evenly spaced times (F,) fitted to a time column (F,), s, and the frame rate, Hz.

    ``declared`` is the rate in the header, possibly not a number, and ``name`` its name. RecordingError if they differ
    by more than 2 %.
    """
    stated = parse_rate(path, declared, name)
    start, rate, note = fit_even_clock(path, time, stated, name="the Time column")
    if stated is not None and abs(rate / stated - 1) > _MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: {name} is {declared} Hz, the Time column has {rate:.6g} Hz; times must be in seconds: "
            "export it again, or correct the wrong one"
        )
    if stated is not None and rate != stated:
        oddities.append(f"{name} is {declared} Hz, the Time column has {rate:.6g} Hz: {rate:.6g} Hz was used")
    if note:
        oddities.append(f"{path.name}: {note}")
    return np.round(start + np.arange(len(time)) / rate, 12) + 0.0, rate  # a start of 1e-16 becomes 0, not -0


def parse_rate(path: Path, declared: str, name: str) -> float | None:
    """Return the rate in a header, Hz; None if it is not a number, RecordingError if it is not positive."""
    try:
        stated = float(declared)
    except ValueError:
        return None
    if not 0 < stated < np.inf:
        raise RecordingError(f"{path}: {name} is {declared[:40]} Hz, expected a positive number; export it again")
    return stated


def check_frame_numbers(path: Path, column: FloatArray, *, consecutive: bool) -> IntArray:
    """Return frame numbers (F,) as integers; RecordingError if one is missing, too large or not the next one."""
    bad = ~np.isfinite(column) | (np.abs(column) >= _MAX_FRAME_NUMBER)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise RecordingError(f"{path}: row {row + 1} of the frames has no frame number or time; export it again")
    frames = column.astype(np.int64)
    steps = np.diff(frames) != 1
    if consecutive and (steps.any() or (frames != column).any()):
        row = int(np.argmax(steps)) if steps.any() else 0
        raise RecordingError(
            f"{path}: frame {frames[row]} is followed by frame {frames[min(row + 1, len(frames) - 1)]}: frames are "
            "missing; export every frame, with missing markers blank"
        )
    return frames


def _name_triples(path: Path, names: Sequence[str], axes: Sequence[str]) -> list[str]:
    """Return one name for every three columns X, Y and Z."""
    if len(axes) % 3 or any(axis.upper() != "XYZ"[k % 3] for k, axis in enumerate(axes)):
        raise RecordingError(f"{path}: the columns of the markers are not X, Y, Z for each marker; export it again")
    if any(names[k] != names[k - k % 3] for k in range(len(axes))):
        raise RecordingError(f"{path}: the names of the markers are not above their columns X, Y, Z; export it again")
    return [name.strip() for name in names[::3]]


def _compute_times(path: Path, frames: np.ndarray, declared: str, name: str) -> tuple[np.ndarray, float]:
    rate = parse_rate(path, declared.split(",", maxsplit=1)[0], name)
    if rate is None:
        raise RecordingError(f"{path}: {name} is {declared[:40]!r}, expected a number in Hz; export it with the times")
    check_rate(path, rate, name)
    if len(frames) < 2:
        raise RecordingError(f"{path}: the file contains one frame, expected at least two")
    return frames / rate, rate


def _split_cells(line: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line]), [])]
    except csv.Error:
        return [cell.strip() for cell in line.split(",")]


def _pad(cells: Sequence[str], width: int) -> list[str]:
    return [*cells[:width], *[""] * (width - len(cells))]


def _get_after(cells: Sequence[str], name: str) -> str:
    """Return the cell after the cell with this name, or an empty text."""
    return cells[cells.index(name) + 1].strip() if name in cells[:-1] else ""
