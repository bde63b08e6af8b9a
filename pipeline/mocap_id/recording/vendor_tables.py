"""Parsers of markers in the text exports of Qualisys QTM (TSV), OptiTrack Motive (CSV) and Vicon Nexus (CSV)."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap_id.errors import RecordingError
from mocap_id.recording.clock import check_rate
from mocap_id.recording.marker_positions import MarkerTable, check_frame_numbers, fit_clock, parse_rate
from mocap_id.recording.text_tables import TextTable, has_final_line_end, parse_count, split_lines

NEXUS_SECTIONS = frozenset(("trajectories", "devices", "joints", "model outputs", "segments"))
"""Names of the parts of a Nexus export, in lower case."""

_HEADER_LINES = 1000
_QTM_KEY = re.compile(r"[A-Z][A-Z_]+(\t|$)")
_NUMBER = re.compile(r"[-+.,\d][-+.,\deE]*|NULL|NaN", re.IGNORECASE)  # decimal commas are an error of their own
_PADDING = ",;\t \ufeff"  # characters that spreadsheets add to short lines


def parse_qtm(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a QTM motion data file (TSV, 3D data), whose positions are in mm.

    Source: Qualisys Track Manager manual, "Motion data (.tsv)". Raises RecordingError if the file contains other data,
    its header is incomplete, or its rows contradict the header.
    """
    lines = split_lines(text)
    first = _find_first_qtm_row(lines)
    split = [line.rstrip().split("\t") for line in lines[:first]]
    header = {cells[0].strip().lower(): cells[1:] for cells in split if len(cells) > 1}
    included = _get_first(header, "data_included")
    labels = [cell.strip() for cell in header.get("marker_names", [])]
    if included.upper() not in ("", "3D") or not labels:
        raise RecordingError(
            f"{path}: the QTM file contains {included or 'no'} data and {len(labels)} MARKER_NAMES, expected 3D data "
            "with names; export the 3D data with the TSV header"
        )
    if first == len(lines):
        raise RecordingError(f"{path}: no frames follow the header")
    timed = "frame" in header or _has_times(path, lines[first:], len(labels))
    names = [*(["Frame", "Time"] if timed else ["Frame"]), *(f"{label} {axis}" for label in labels for axis in "XYZ")]
    body = [line.removesuffix("\t") for line in lines[first:]]  # some versions end each line with a separator
    table = TextTable(path, names, body if timed else _number_rows(path, body, first), first + 1, "\t")
    rows = table.numbers()
    table.check_triples(rows, len(names) - 3 * len(labels))
    declared = parse_count(_get_first(header, "no_of_frames"))
    if not timed and declared != len(rows):  # a missing row could be anywhere
        raise RecordingError(
            f"{path}: NO_OF_FRAMES is {declared}, the file contains {len(rows)} rows without frame numbers; export it "
            "again, with the time data"
        )
    oddities += table.check_count(declared, rows, ended=has_final_line_end(text))
    stated = _get_first(header, "frequency")
    frames = check_frame_numbers(path, rows[:, 0], consecutive=True)
    if timed:
        time, rate = fit_clock(path, stated, rows[:, 1], oddities, "FREQUENCY")
    else:
        time, rate = _compute_times(path, frames - 1, stated, "FREQUENCY")
    count = parse_count(_get_first(header, "no_of_markers"))
    if count is not None and count != len(labels):
        oddities.append(f"the header declares {count} markers but names {len(labels)}: the rows have {len(labels)}")
    kinds = [kind.strip().lower() for kind in header.get("trajectory_types", [])]
    virtual = [label for label, kind in zip(labels, kinds, strict=False) if kind == "virtual"]
    positions = rows[:, len(names) - 3 * len(labels) :].reshape(len(rows), -1, 3)
    return MarkerTable("QTM TSV", labels, frames, time, positions, rate, "mm", "Z", virtual)


def parse_motive(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a Motive CSV export: measured markers only, not markers that Motive computed from bodies.

    Source: OptiTrack documentation, "Data Export: CSV". Raises RecordingError if there are no measured markers, the
    coordinates are local, or rows and header contradict each other.
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

    Source: Vicon Nexus user guide, "Export ASCII". Raises RecordingError if there is no such section, or if its lines
    contradict each other.
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


def _name_triples(path: Path, names: Sequence[str], axes: Sequence[str]) -> list[str]:
    """Return one name for every three columns X, Y and Z."""
    if len(axes) % 3 or any(axis.upper() != "XYZ"[k % 3] for k, axis in enumerate(axes)):
        raise RecordingError(f"{path}: the columns of the markers are not X, Y, Z for each marker; export it again")
    if any(names[k] != names[k - k % 3] for k in range(len(axes))):
        raise RecordingError(f"{path}: the names of the markers are not above their columns X, Y, Z; export it again")
    return [name.strip() for name in names[::3]]


def _find_first_qtm_row(lines: Sequence[str]) -> int:
    """Return the index of the first row of numbers, after the last key and after any line of column names."""
    keys = [k for k, line in enumerate(lines[:_HEADER_LINES]) if _QTM_KEY.match(line)]
    first = keys[-1] + 1 if keys else 0
    while first < len(lines) and (not lines[first] or _has_words(lines[first])):
        first += 1
    return first


def _has_words(line: str) -> bool:
    """Return whether a cell contains text other than a number or a mark for a missing value."""
    return any(cell.strip() and not _NUMBER.fullmatch(cell.strip()) for cell in line.split("\t"))


def _number_rows(path: Path, rows: Sequence[str], first: int) -> list[str]:
    """Put a frame number, from 1, before each row, so that rows without any visible marker are kept."""
    kept = list(rows)
    while kept and not kept[-1]:
        kept.pop()
    if "" in kept:
        raise RecordingError(f"{path}: line {first + kept.index('') + 1} is empty; export the file with frame numbers")
    return [f"{number}\t{row}" for number, row in enumerate(kept, start=1)]


def _has_times(path: Path, rows: Sequence[str], markers: int) -> bool:
    """Return whether a frame number and a time precede the coordinates, judged by the number of cells in ``rows``."""
    width = max(row.rstrip("\r\n ").rstrip("\t").count("\t") + 1 for row in rows)
    most = max(row.count("\t") + 1 for row in rows)
    for extra in (0, 2):
        if width <= 3 * markers + extra <= most <= 3 * markers + extra + 1:
            return bool(extra)
    raise RecordingError(
        f"{path}: the rows have {most} cells; {markers} MARKER_NAMES need {3 * markers}, or {3 * markers + 2} with "
        "frame and time; export it again"
    )


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


def _get_first(header: dict[str, list[str]], key: str) -> str:
    return next(iter(header.get(key, [])), "").strip()


def _get_after(cells: Sequence[str], name: str) -> str:
    """Return the cell after the cell with this name, or an empty text."""
    return cells[cells.index(name) + 1].strip() if name in cells[:-1] else ""
