"""Parsers of text tables: MOT and STO files, CSV files, and the rows of TRC files."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow

from mocap_id import plain_files
from mocap_id.arrays import FloatArray, is_time_axis
from mocap_id.errors import RecordingError

_HEADER_LINES = 100
_MAX_DECLARED = 10**9  # a larger number of rows in a header is an error
_MAX_OMITTED_CELLS = 10_000_000
"""Limit of omitted cells: many column names with many short lines would need unlimited memory."""

_TIME = ("time", "times")
_WHOLE = re.compile("[0-9]+")
_DECIMAL = re.compile(r"-?[0-9]{1,9}(\.[0-9]{0,9})?")
_HEADER_VALUE = re.compile(r"\s*(?P<key>[A-Za-z]\w*)\s*(?:=|\s)(?P<value>.*)")
_ARROW_ERROR = re.compile("column #([0-9]+): Row #([0-9]+): .*?'(.*)'", re.DOTALL)
"""Pattern of Arrow's message for a cell that is not a number."""


@dataclass(frozen=True)
class TextTable:
    """Text table whose cells are not yet parsed."""

    path: Path
    names: Sequence[str]  # column names
    lines: Sequence[str]  # lines below the names; blank lines are ignored
    first: int  # number of the first of these lines in the file, from 1
    separator: str | None  # None if any white space separates the cells

    def numbers(self) -> FloatArray:
        """Parse the cells as numbers (K, C); NaN if a cell is empty, or missing at the end of a line.

        Raises RecordingError if a cell contains text, a line has too many cells, most cells are omitted, or a quote
        spans several lines.
        """
        between = self.separator or "\t"
        rows = [row for line in self.lines if (row := line.rstrip())]
        if self.separator is None:
            rows = [between.join(row.split()) for row in rows]
        breaks = [row.count(between) for row in rows]
        width = len(self.names)
        if not rows:
            return np.empty((0, width))
        if max(breaks) >= width:
            worst = breaks.index(max(breaks))
            raise RecordingError(
                f"{self.path}: line {self._line_number(worst)} has {breaks[worst] + 1} cells, expected at most "
                f"{width}; export it again"
            )
        if width * len(rows) > _MAX_OMITTED_CELLS + sum(map(len, rows)):
            raise RecordingError(f"{self.path}: {len(rows)} lines omit most of {width} columns; export it again")
        text = "\n".join(row + between * (width - 1 - count) for row, count in zip(rows, breaks, strict=True))
        if " " in text:
            text = re.sub(f"(^|{between}) +(?={between}|$)", r"\1", text, flags=re.MULTILINE)
        columns = [str(column) for column in range(width)]
        try:
            table = arrow.read_csv(
                pa.BufferReader(text.encode()),
                arrow.ReadOptions(column_names=columns, use_threads=False),
                arrow.ParseOptions(delimiter=between, quote_char='"' if between == "," else False),
                arrow.ConvertOptions(column_types=dict.fromkeys(columns, pa.float64())),
            )
        except pa.ArrowInvalid as error:
            raise RecordingError(f"{self.path}: not a table of numbers: {self._explain_error(str(error))}") from None
        if len(table) != len(rows):
            raise RecordingError(
                f"{self.path}: {len(rows)} lines follow the column names, but they were read as {len(table)} rows: a "
                "quotation mark or another special character joins or splits lines; export the file again"
            )
        return np.concatenate([part.to_tensor(null_to_nan=True).to_numpy() for part in table.to_batches()])

    def select(self, names: Sequence[str]) -> FloatArray:
        """Parse the cells of some columns as numbers, (K, len(names)); errors as for :meth:`numbers`."""
        return self.numbers()[:, [self.names.index(name) for name in names]]

    def check_count(self, declared: int | None, values: FloatArray, *, ended: bool) -> list[str]:
        """Compare the number of rows with the number in the header; return a note if they differ, else an empty list.

        ``declared`` is the number in the header, None if there is none. A file that was shortened by hand ends with a
        whole row and is accepted. If the file ends within the last cell, this cell may have lost digits and becomes NaN
        in ``values`` (K, C). ``ended`` says whether a line end follows the last row. Raises RecordingError if the
        numbers differ and the last row is incomplete, or if the declared number is impossible.
        """
        count = len(values)
        if declared == count or not count or (declared is None and ended):
            return []
        stated = "no number of" if declared is None else str(declared)
        found = f"the header declares {stated} rows, the file contains {count}"
        rows = [line for line in self.lines if line.strip()]
        cells = [len(row.split(self.separator)) for row in rows]
        last_cell_ended = ended or (self.separator is not None and rows[-1].endswith(self.separator))
        whole = cells[-1] in cells[:-1] if last_cell_ended else cells[-1] >= len(self.names)
        if not whole or (declared or 0) > _MAX_DECLARED:
            short = "truncated: " if declared is None or count < declared else ""
            raise RecordingError(f"{self.path}: {short}{found}; copy or export it again")
        if last_cell_ended:
            return [f"{found}: all were read; the last row is whole"]
        values[-1, -1] = np.nan
        return [f"{found}: all were read; the file may end within the last cell, which was set to missing"]

    def _line_number(self, row: int) -> int:
        """Return the line number of a row in the file, from 1."""
        return [number for number, line in enumerate(self.lines, self.first) if line.strip()][row]

    def _explain_error(self, arrow_message: str) -> str:
        """Return a text that says which cell is not a number, from Arrow's message."""
        match = _ARROW_ERROR.search(arrow_message)
        if match is None:
            return " ".join(arrow_message.split())[:160]
        name, line = self.names[int(match[1])], self._line_number(int(match[2]) - 1)
        return f"`{name}` is {match[3].strip()[:40]!r} in line {line}; expected a number or an empty cell"


@dataclass(frozen=True)
class MotionTable:
    """Content of a MOT or STO file: T rows, C columns."""

    time: FloatArray  # (T,) s
    columns: tuple[str, ...]  # names of all columns except time
    values: FloatArray  # (T, C) as in the file
    in_degrees: bool  # ``inDegrees`` of the header; False if it is missing
    notes: tuple[str, ...] = ()  # contradictions between header and rows, and how they were read

    def __getitem__(self, column: str) -> FloatArray:
        return self.values[:, self.columns.index(column)]


def read_table(path: Path) -> MotionTable:
    """Read a MOT or STO table.

    Raises RecordingError if the file is missing or not such a table, if it ends within a row, or if its time does not
    increase.
    """
    return parse_table(path, read_text(path))


def read_text(path: Path) -> str:
    """Read a text file as UTF-8 or, if it is not UTF-8, as Latin-1."""
    with open_recording(path) as stream:
        data = stream.read()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def has_final_line_end(text: str) -> bool:
    """Return whether a line end follows the last line of a text."""
    return text.endswith(("\n", "\r"))


def split_lines(text: str) -> list[str]:
    """Split text at any line ending, but not at other separators such as form feeds or U+0085."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if not lines[-1] else lines


@contextmanager
def open_recording(path: Path) -> Iterator[BinaryIO]:
    """Open a recording for reading; RecordingError if it cannot be read or changes while it is open."""
    try:
        with plain_files.open_file(path) as stream:
            yield stream
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; check the path{plain_files.suggest(path)}") from None
    except IsADirectoryError:
        raise RecordingError(f"{path}: is a folder, expected a recording (.c3d, .trc or .mot)") from None
    except PermissionError:
        raise RecordingError(f"{path}: permission to read it is denied; check its permissions") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None


def parse_table(path: Path, text: str) -> MotionTable:
    """Parse the text of a MOT or STO table; errors as in :func:`read_table`."""
    lines = split_lines(text)
    header = next((i for i, line in enumerate(lines[:_HEADER_LINES]) if line.strip().lower() == "endheader"), None)
    if header is None:
        raise RecordingError(f"{path}: not a MOT or STO table: no 'endheader' in its first {_HEADER_LINES} lines")
    keys = _read_header_values(lines[:header])
    start = next((i for i in range(header + 1, len(lines)) if lines[i].strip()), len(lines))
    sample = next((line for line in lines[start + 1 :] if line.strip()), None)
    if sample is None:
        raise RecordingError(f"{path}: the table is empty")
    separator = "\t" if "\t" in sample.rstrip() else None
    names = [name.strip() for name in lines[start].rstrip().split(separator)]
    table = TextTable(path, names, lines[start + 1 :], start + 2, separator)
    values = table.numbers()
    declared = parse_count(keys.get("nrows") or keys.get("datarows"))
    notes = table.check_count(declared, values, ended=has_final_line_end(text))
    filled = np.flatnonzero(~np.isnan(values).all(axis=0))
    columns, values = [names[column] for column in filled], values[:, filled]
    columns, values = _put_time_first(path, columns, values, keys.get("range", ""), notes)
    time = values[:, 0]
    if not is_time_axis(time):
        problem = "the table has only one row" if len(time) == 1 else "the times do not increase from row to row"
        raise RecordingError(f"{path}: {problem}; export a trial with at least two rows of increasing time")
    in_degrees = keys.get("indegrees", "no").lower() == "yes"
    return MotionTable(time, tuple(columns[1:]), values[:, 1:], in_degrees, tuple(notes))


def _read_header_values(lines: Sequence[str]) -> dict[str, str]:
    """Return the values of a header by lower-case name: ``name=value`` of OpenSim, or ``name value`` of SIMM."""
    found: dict[str, str] = {}
    for line in lines:
        match = _HEADER_VALUE.match(line)
        if match is not None:
            found[match["key"].lower()] = match["value"].strip()
    return found


def _put_time_first(
    path: Path, columns: list[str], values: FloatArray, declared: str, notes: list[str]
) -> tuple[list[str], FloatArray]:
    """Return the names and the values of the columns, with the time first.

    If a SIMM table has no times, they are spread evenly over the range in its header, and a note is added to ``notes``.
    Raises RecordingError if the first column is not the time and there is no such range.
    """
    if columns and columns[0].lower() in _TIME:
        return columns, values
    span = [float(word) for word in declared.split() if _DECIMAL.fullmatch(word)]
    if any(name.lower() in _TIME for name in columns) or len(span) != 2 or len(values) < 2:
        raise RecordingError(f"{path}: the first column is {columns[:1]}, expected 'time'")
    notes.append(f"the table has no times: its rows were spread evenly over the range of its header, {declared} s")
    return ["time", *columns], np.column_stack([np.linspace(span[0], span[1], len(values)), values])


def parse_count(declared: str | None) -> int | None:
    """Return the number of rows or markers in a header; None if it is not a whole number."""
    digits = (declared or "").strip()
    if not _WHOLE.fullmatch(digits):
        return None
    return int(digits) if len(digits) < 19 else 10**18  # more than any file contains


def read_csv(path: Path) -> TextTable:
    """Read a CSV table with the column names in the first line that is not blank.

    Raises RecordingError if the file is missing, empty or not a CSV table.
    """
    lines = split_lines(read_text(path))
    start = next((i for i, line in enumerate(lines) if line.strip()), None)
    if start is None:
        raise RecordingError(f"{path}: not a CSV table: the file is empty")
    try:
        names = next(csv.reader([lines[start].rstrip()], skipinitialspace=True))
    except csv.Error as error:
        raise RecordingError(f"{path}: not a CSV table ({error})") from None
    return TextTable(path, [name.strip() for name in names], lines[start + 1 :], start + 2, ",")
