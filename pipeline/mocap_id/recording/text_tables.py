"""Parsers of text tables: MOT and STO files, CSV files."""

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
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.sample_checks import SENSOR_HZ, check_times

_HEADER_LINES = 100
_MAX_DECLARED = 10**9  # a larger number of rows in a header is an error
_MAX_OMITTED_CELLS = 10_000_000
"""Limit of omitted cells: many column names with many short lines would need unlimited memory."""

_TIME = ("time", "times")
_WHOLE = re.compile("[0-9]+")
_DECIMAL = re.compile(r"-?[0-9]{1,9}(\.[0-9]{0,9})?")
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+(e[-+]?[0-9]+)?", re.IGNORECASE)
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
        """Parse the cells as numbers (K, C); NaN if a cell is empty, or missing at the end of a line."""
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
            comma = "; a decimal comma also separates cells: export with decimal points"
            raise RecordingError(
                f"{self.path}: line {self._line_number(worst)} has {breaks[worst] + 1} cells, expected at most "
                f"{width}{comma if between == ',' else '; export it again'}"
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
            match, found = _ARROW_ERROR.search(str(error)), " ".join(str(error).split())[:160]
            if match is not None:
                name, line = self.names[int(match[1])], self._line_number(int(match[2]) - 1)
                found = f"`{name}` is {match[3].strip()[:40]!r} in line {line}; expected a number or an empty cell"
                if _DECIMAL_COMMA.fullmatch(match[3].strip()):
                    found += ". Its numbers have decimal commas: export it with decimal points"
            raise RecordingError(f"{self.path}: not a table of numbers: {found}") from None
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
        """Compare the number of rows with the number in the header, if any; return a list with a note if they differ.

        A file that was shortened by hand ends with a whole row and is accepted; RecordingError if the last row is
        incomplete. A last cell that no line end follows (``ended``) may have lost digits and becomes NaN in ``values``
        (K, C).
        """
        count = len(values)
        if count and declared == count and not ended and self.is_cut():
            row = next(line for line in reversed(self.lines) if line.strip())
            values[-1, len(row.rstrip().split(self.separator)) - 1] = np.nan
            return ["the file ends within its last row: its last number may have lost digits and was set to missing"]
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

    def check_triples(self, values: FloatArray, first: int) -> None:
        """Raise RecordingError if a line above the last ends between the coordinates of a marker.

        ``values`` (K, C) are the parsed cells, with X, Y, Z of each marker from the column ``first`` on. Such a line
        has lost cells, so that others are in wrong columns. Blank cells may be missing behind the last visible marker.
        """
        shown = np.isfinite(values[:-1, first:])
        last = np.where(shown.any(axis=1), shown.shape[1] - np.argmax(shown[:, ::-1], axis=1), 0)
        rows = [line for line in self.lines if line.strip()]
        for row in np.flatnonzero(last % 3):
            line = rows[row].rstrip(f"\r\n{self.separator or ' '}")
            if len(line.split(self.separator)) == first + last[row]:  # no mark for a missing value follows
                raise RecordingError(
                    f"{self.path}: line {self._line_number(int(row))} ends between the coordinates of a marker, after "
                    f"{first + last[row]} cells: it has lost cells, so that others are in wrong columns. Copy or "
                    "export the file again, or make all coordinates of this line blank"
                )

    def is_cut(self) -> bool:
        """Return whether the last line, which no line end follows, seems to have lost cells or digits.

        It has fewer cells than all lines above, or its last number has fewer decimals than all numbers above. If their
        decimals vary, or they are whole numbers, it is shorter than the number above and differs from it by more than
        three times the largest step of the column.
        """
        rows = [line.strip(" \r").split(self.separator) for line in self.lines if line.strip()]
        if len(rows) < 4:
            return False
        last, above = rows[-1], rows[:-1]
        if len(last) < min(map(len, above)):
            return True
        column = [row[len(last) - 1].strip() for row in above if len(row) >= len(last)]
        cell, column = last[-1].strip(), [each for each in column if each]  # blank if the file ends with a separator
        decimals = {len(each.partition(".")[2]) for each in column}
        if not column or not cell or len(cell.partition(".")[2]) < min(decimals):
            return bool(column and cell)
        if len(decimals) == 1 and 0 not in decimals:
            return False
        try:
            value, *others = (float(each) for each in (cell, *column[-1:-200:-1]))
        except ValueError:
            return False  # the cell that is not a number is an error of its own
        largest = float(np.abs(np.diff(others)).max(initial=0.0))
        return abs(value - others[0]) > 3.0 * largest and len(cell) < len(column[-1])

    def _line_number(self, row: int) -> int:
        """Return the line number of a row in the file, from 1."""
        return [number for number, line in enumerate(self.lines, self.first) if line.strip()][row]


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
    """Read a MOT or STO table; RecordingError if it is no such table, cut, or its time does not increase."""
    return parse_table(path, read_text(path))


def read_text(path: Path) -> str:
    """Read a text file as UTF-8 or, if it is not UTF-8, as Latin-1; RecordingError if it is UTF-16 or no text."""
    with open_recording(path) as stream:
        data = stream.read()
    check_encoding(path, data)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def check_encoding(path: Path, data: bytes) -> None:
    """Raise RecordingError if the bytes of a text file are UTF-16 or UTF-32, or contain the character NUL."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or data[:200].count(0) > len(data[:200]) // 4:
        raise RecordingError(
            f"{path}: the text is in UTF-16 (Unicode); expected UTF-8. Save it again as UTF-8 or ASCII"
        )
    if b"\0" in data:
        raise RecordingError(
            f"{path}: the text contains NUL characters, the first after {data.index(0)} bytes; the file is damaged. "
            "Copy or export it again"
        )


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
    # values by lower-case name: `name=value` of OpenSim, or `name value` of SIMM
    matches = filter(None, map(_HEADER_VALUE.match, lines[:header]))
    keys = {match["key"].lower(): match["value"].strip() for match in matches}
    start = next((i for i in range(header + 1, len(lines)) if lines[i].strip()), len(lines))
    sample = next((line for line in lines[start + 1 :] if line.strip()), None)
    if sample is None:
        raise RecordingError(f"{path}: the table is empty")
    separator = "\t" if "\t" in sample.rstrip() else None
    names = [name.strip() for name in lines[start].rstrip().split(separator)]
    check_unique(path, names)
    table = TextTable(path, names, lines[start + 1 :], start + 2, separator)
    values = table.numbers()
    declared = parse_count(keys.get("nrows") or keys.get("datarows"))
    notes = table.check_count(declared, values, ended=has_final_line_end(text))
    filled = np.flatnonzero(~np.isnan(values).all(axis=0))
    columns, values = [names[column] for column in filled], values[:, filled]
    if not columns or columns[0].lower() not in _TIME:  # a SIMM table without times has a range in its header
        declared_range = keys.get("range", "")
        span = [float(word) for word in declared_range.split() if _DECIMAL.fullmatch(word)]
        if any(name.lower() in _TIME for name in columns) or len(span) != 2 or len(values) < 2:
            raise RecordingError(f"{path}: the first column is {columns[:1]}, expected 'time'")
        notes.append(
            f"the table has no times: its rows were spread evenly over the range of its header, {declared_range} s"
        )
        columns = ["time", *columns]
        values = np.column_stack([np.linspace(span[0], span[1], len(values)), values])
    time = values[:, 0]
    check_times(path, time, "`time`", SENSOR_HZ, pauses=True)
    in_degrees = keys.get("indegrees", "no").lower() == "yes"
    return MotionTable(time, tuple(columns[1:]), values[:, 1:], in_degrees, tuple(notes))


def parse_count(declared: str | None) -> int | None:
    """Return the number of rows or markers in a header; None if it is not a whole number."""
    digits = (declared or "").strip()
    if not _WHOLE.fullmatch(digits):
        return None
    return int(digits) if len(digits) < 19 else 10**18  # more than any file contains


def check_unique(path: Path, names: Sequence[str]) -> None:
    """Raise RecordingError if a column name occurs twice, in small or capital letters; names may be empty."""
    seen: set[str] = set()
    for name in filter(None, (name.strip() for name in names)):
        if name.casefold() in seen:
            raise RecordingError(
                f"{path}: the column `{name[:60]}` occurs twice, so it is not clear which one is meant; remove or "
                "rename one of them"
            )
        seen.add(name.casefold())


def read_csv(path: Path) -> TextTable:
    """Read a CSV table with the column names in the first line that is not blank."""
    text = read_text(path)
    lines = split_lines(text)
    start = next((i for i, line in enumerate(lines) if line.strip()), None)
    if start is None:
        raise RecordingError(f"{path}: not a CSV table: the file is empty")
    for separator, word in ((";", "semicolons (;)"), ("\t", "tabs")):
        if "," not in lines[start] and separator in lines[start].strip():
            raise RecordingError(
                f"{path}: its cells are separated by {word}: export it with commas and with decimal points"
            )
    try:
        names = next(csv.reader([lines[start].rstrip()], skipinitialspace=True))
    except csv.Error as error:
        raise RecordingError(f"{path}: not a CSV table ({error})") from None
    check_unique(path, names)
    table = TextTable(path, [name.strip() for name in names], lines[start + 1 :], start + 2, ",")
    check_end(path, table, text)
    return table


def check_end(path: Path, table: TextTable, text: str) -> None:
    """Raise RecordingError if a log ends within its last line, so that the last number may have lost digits."""
    if has_final_line_end(text) or not table.is_cut():
        return
    raise RecordingError(
        f"{path}: the file ends within its last line, {table.lines[-1].strip()[-40:]!r}: it has fewer cells or digits "
        "than the lines above. Copy the file again, or delete this line"
    )
