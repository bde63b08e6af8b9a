"""Parser of the text of TRC files, whose header may contradict itself or the rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.errors import RecordingError
from mocap_id.recording.marker_table import MarkerTable, check_frame_numbers, fit_clock
from mocap_id.recording.text_tables import TextTable, has_final_line_end, parse_count, split_lines

_HEADER_LINES = 12
_NAMES = re.compile(r"\W*frame\b", re.IGNORECASE)
_AXIS = re.compile(r"[XYZ]\d+")
_SHORT_KEYS = {"nummarker": "nummarkers", "numframe": "numframes"}  # spellings of other programs, by lower-case name


@dataclass(frozen=True)
class _Header:
    """Header of a TRC file."""

    values: dict[str, str]  # named values, by lower-case name
    names: list[str]  # cells of the line with marker names
    axes: int  # number of cells such as X1
    first_row: int  # index of the first row of numbers
    separator: str | None  # None if white space separates the cells


def parse_trc(path: Path, text: str, oddities: list[str]) -> MarkerTable:
    """Parse the text of a TRC file.

    The number of markers follows from NumMarkers, the line with names, the line with X1 Y1 Z1 … and the widest row. If
    they contradict each other, the number on which all of them but one agree is used, with a note in ``oddities``.
    Raises RecordingError if the text is not a TRC file, contradicts itself or is truncated.
    """
    lines = split_lines(text)
    header = _find_header(path, lines)
    body = lines[header.first_row :]
    if all(row[:1] in ("\t", "") for row in body):  # the first column is blank
        body = [row[1:] for row in body]
    separator = _find_row_separator(body[0], header.separator)
    labels, table = _cut_table(path, header, body, separator, oddities)
    rows = table.numbers()
    table.check_triples(rows, 2)
    declared = parse_count(header.values.get("numframes"))
    if declared is None:
        stated = header.values.get("numframes", "")[:40]
        oddities.append(f"the header has no valid number of frames ({stated!r}): {len(rows)} were read")
    oddities += table.check_count(declared, rows, ended=has_final_line_end(text))
    frames = check_frame_numbers(path, np.where(np.isfinite(rows[:, 1]), rows[:, 0], np.nan), consecutive=False)
    time, rate = fit_clock(path, header.values.get("datarate", ""), rows[:, 1], oddities, "DataRate")
    units = header.values.get("units", "")
    return MarkerTable("TRC", labels, frames, time, rows[:, 2:].reshape(len(rows), -1, 3), rate, units, "Y")


def _find_header(path: Path, lines: Sequence[str]) -> _Header:
    """Find the lines of the header by their content; lines may be missing or added."""
    if not lines:
        raise RecordingError(f"{path}: the file is empty")
    names = next((k for k in range(1, min(len(lines), _HEADER_LINES)) if _NAMES.match(lines[k])), None)
    if "pathfiletype" not in lines[0].lower() or (names is None and len(lines) >= 5):
        raise RecordingError(f"{path}: not a TRC file: the first line is {lines[0][:40]!r}, expected 'PathFileType …'")
    if names is None:
        raise RecordingError(f"{path}: the file ends within its header; copy or export it again")
    keys = next((k for k in range(1, names) if "datarate" in lines[k].lower()), None)
    if keys is None:
        raise RecordingError(
            f"{path}: the second line should contain DataRate, NumMarkers, Units …; export it again as TRC"
        )
    following = next((line for line in lines[keys + 1 : names] if line.strip()), "")
    values = _parse_values(lines[keys], following)
    first = next((k for k in range(names + 1, len(lines)) if lines[k].lstrip()[:1].isdigit()), None)
    if first is None:
        raise RecordingError(f"{path}: no frames follow the header")
    separator = next((each for each in ("\t", ",") if each in lines[names]), None)
    axes = sum(len(_AXIS.findall(line)) for line in lines[names + 1 : first])
    cells = lines[names].rstrip().rstrip(separator).split(separator)
    if separator == "\t" and sum(map(bool, cells)) <= 2:  # spaces separate the names
        separator, cells = None, lines[names].split()
    return _Header(values, [cell.strip() for cell in cells], axes, first, separator)


def _parse_values(names: str, line: str) -> dict[str, str]:
    """Return the header's values by lower-case name; a value may contain spaces only if tabs separate the values."""
    separator = "," if "," in names and "\t" not in names else "\t"
    keys = [key.lower() for key in names.replace(separator, " ").split()]
    cells = [cell.strip() for cell in line.split(separator)]
    words = line.replace(separator, " ").split()
    if len(words) >= len(keys) and len(cells) != len(keys):  # a blank cell would shift the words
        cells = words
    return dict(zip((_SHORT_KEYS.get(key, key) for key in keys), cells, strict=False))


def _find_row_separator(row: str, separator: str | None) -> str | None:
    """Return the separator of the rows; None if white space separates them, so that no cell can be blank."""
    separator = separator if separator == "," else "\t"
    if separator in row and len(row.split(separator, 1)[0].split()) == 1:
        return separator
    return None


def _cut_table(
    path: Path, header: _Header, body: Sequence[str], separator: str | None, oddities: list[str]
) -> tuple[list[str], TextTable]:
    """Return the marker names, and a table of the rows without the columns to the right of the named markers."""
    filled = [row.rstrip() if separator is None else row.rstrip().rstrip(separator) for row in body]
    counts = [len(row.split()) if separator is None else row.count(separator) + 1 for row in filled]
    labels = _find_labels(path, header, max(counts), oddities)
    width = 2 + 3 * len(labels)
    if separator is None:
        odd = next((k for k, count in enumerate(counts) if count not in (0, width)), None)
        if odd is not None:
            raise RecordingError(
                f"{path}: line {header.first_row + odd + 1} has {counts[odd]} cells between spaces, expected {width}: "
                "a missing marker cannot be located; export the file with tabs"
            )
    rows = list(body)
    if max(counts) > width:
        assert separator is not None
        rows = [separator.join(row.split(separator)[:width]) if separator in row else row for row in rows]
    names = ["Frame#", "Time", *(f"{axis}{marker}" for marker in range(1, len(labels) + 1) for axis in "XYZ")]
    return labels, TextTable(path, names, rows, header.first_row + 1, separator)


def _find_labels(path: Path, header: _Header, widest: int, oddities: list[str]) -> list[str]:
    """Return the marker names in the order of the columns.

    Names usually start three columns apart. If they do not, they belong to the columns in their order, provided that
    every other line has as many markers as there are names.
    """
    cells = header.names[2:]
    spaced = cells[::3] if header.separator is not None else cells
    listed = [cell for cell in cells if cell]
    in_place = header.separator is None or not any(cell for k, cell in enumerate(cells) if k % 3)
    declared = parse_count(header.values.get("nummarkers"))
    numbers = {"NumMarkers": declared, "the X1 Y1 Z1 line": header.axes // 3 or None}
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
    if not in_place or (header.separator is None and others and len(spaced) not in others):
        raise RecordingError(
            f"{path}: the lines contradict each other on the number of markers: {len(listed)} names, which are not "
            f"three columns apart; {found or 'no NumMarkers'}; rows with the coordinates of {width}. Correct the "
            "header, or export it again"
        )
    if width > len(spaced):
        _note_extra_columns(path, len(spaced), widest - 2, stated, oddities)
    elif declared is not None and declared != len(spaced):
        oddities.append(f"the header declares {declared} markers but names {len(spaced)}: the named markers were read")
    return spaced


def _note_extra_columns(path: Path, named: int, columns: int, stated: dict[str, int], oddities: list[str]) -> None:
    """Add a note if whole triples of columns follow those of the named markers; RecordingError for other columns."""
    if columns % 3 or named not in stated.values():
        found = ", ".join(f"{name} {count}" for name, count in stated.items()) or "no NumMarkers"
        raise RecordingError(
            f"{path}: the widest row has {2 + columns} cells, expected at most {2 + 3 * named} for {named} names "
            f"({found}); export it again"
        )
    agreeing = " and ".join(name for name, count in stated.items() if count == named)
    oddities.append(
        f"{columns // 3 - named} trajectories to the right of the {named} named markers have no name and were not read "
        f"({agreeing} also has {named})"
    )
