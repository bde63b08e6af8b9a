"""Tables of numbers as text: OpenSim's MOT and STO, and what TRC and CSV share with them."""

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

_HEADER_LINES = 100
_MOST_BLANK = 10_000_000
"""Cells that lines may leave out: many names above many short lines would take any memory."""

_WHOLE = re.compile("[0-9]+")
_REFUSED = re.compile("column #([0-9]+): Row #([0-9]+): .*?'(.*)'", re.DOTALL)
"""How Arrow says which cell is no number."""


@dataclass(frozen=True)
class TextTable:
    """Lines of cells, of which numbers are still to be made.

    Parameters
    ----------
    path : Path
    names : sequence of str, length C
    lines : sequence of str
        Below the names; blank ones do not count.
    first : int
        Number of the first of them in the file, from 1.
    separator : str or None
        None where cells are parted by any white space.
    """

    path: Path
    names: Sequence[str]
    lines: Sequence[str]
    first: int
    separator: str | None

    def numbers(self) -> FloatArray:
        """The cells as numbers (K, C); NaN where one is empty, or missing at the end of its line.

        Raises
        ------
        RecordingError
            A cell holds text, lines have more cells than there are names or next to none, or a quote swallows lines.
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
                f"{self.path}: line {self._line(worst)} has {breaks[worst] + 1} cells, expected {width} at most; "
                "export it again"
            )
        if width * len(rows) > _MOST_BLANK + sum(map(len, rows)):
            raise RecordingError(f"{self.path}: {len(rows)} lines leave most of {width} columns out; export it again")
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
            raise RecordingError(f"{self.path}: not a table of numbers: {self._refused(str(error))}") from None
        if len(table) != len(rows):
            raise RecordingError(
                f"{self.path}: {len(rows)} lines follow the names, but they make {len(table)} rows: a quote or a stray "
                "character runs over the ends of lines; export it again"
            )
        return np.concatenate([part.to_tensor(null_to_nan=True).to_numpy() for part in table.to_batches()])

    def _line(self, row: int) -> int:
        """Where a row stands in the file, as editors count lines."""
        return [number for number, line in enumerate(self.lines, self.first) if line.strip()][row]

    def _refused(self, said: str) -> str:
        found = _REFUSED.search(said)
        if found is None:
            return " ".join(said.split())[:160]
        name, line = self.names[int(found[1])], self._line(int(found[2]) - 1)
        return f"`{name}` is {found[3].strip()[:40]!r} in line {line}; expected numbers in every cell, or empty ones"


@dataclass(frozen=True)
class MotionTable:
    """A MOT or STO file.

    Parameters
    ----------
    time : (T,) array
        s.
    columns : tuple of str
        All but time.
    values : (T, C) array
        As in the file.
    in_degrees : bool
        The header's ``inDegrees``; False where it is missing.
    """

    time: FloatArray
    columns: tuple[str, ...]
    values: FloatArray
    in_degrees: bool

    def __getitem__(self, column: str) -> FloatArray:
        return self.values[:, self.columns.index(column)]


def read_table(path: Path) -> MotionTable:
    """Read a MOT or STO table.

    Raises
    ------
    RecordingError
        The file is missing, no such table, shorter than its header says, or its time does not increase.
    """
    return parse_table(path, read_text(path))


def read_text(path: Path) -> str:
    """A text file's content, whatever its line ends."""
    with opened(path) as stream:
        data = stream.read()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def lines_of(text: str) -> list[str]:
    """The lines of a table, whatever their ends; other separators (form feeds, U+0085) are no ends of lines."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if not lines[-1] else lines


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A recording, open for reading; a RecordingError says why it cannot be read, or that it changed meanwhile."""
    try:
        with plain_files.opened(path) as stream:
            yield stream
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise RecordingError(f"{path}: is a folder, expected a recording (.c3d, .trc or .mot)") from None
    except PermissionError:
        raise RecordingError(f"{path}: may not be read; check its permissions") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None


def parse_table(path: Path, text: str) -> MotionTable:
    """Parse a MOT or STO table; errors as :func:`read_table`."""
    lines = lines_of(text)
    header = next((i for i, line in enumerate(lines[:_HEADER_LINES]) if line.strip().lower() == "endheader"), None)
    if header is None:
        raise RecordingError(f"{path}: not a MOT or STO table: no 'endheader' in its first {_HEADER_LINES} lines")
    keys = dict(line.split("=", 1) for line in lines[:header] if "=" in line)
    keys = {key.strip().lower(): value.strip() for key, value in keys.items()}
    start = next((i for i in range(header + 1, len(lines)) if lines[i].strip()), len(lines))
    sample = next((line for line in lines[start + 1 :] if line.strip()), None)
    if sample is None:
        raise RecordingError(f"{path}: the table is empty")
    separator = "\t" if "\t" in sample.rstrip() else None
    names = [name.strip() for name in lines[start].rstrip().split(separator)]
    values = TextTable(path, names, lines[start + 1 :], start + 2, separator).numbers()
    filled = np.flatnonzero(~np.isnan(values).all(axis=0))
    columns, values = [names[column] for column in filled], values[:, filled]
    if not columns or columns[0].lower() != "time":
        raise RecordingError(f"{path}: the first column is {columns[:1]}, expected 'time'")
    declared = counted(keys.get("nrows") or keys.get("datarows"))
    if declared is not None and declared != len(values):
        raise RecordingError(
            f"{path}: the header promises {declared} rows, the file holds {len(values)}; export it again"
        )
    time = values[:, 0]
    if len(time) < 2 or not np.isfinite(time).all() or not np.all(np.diff(time) > 0):
        raise RecordingError(f"{path}: the time column does not increase from row to row")
    return MotionTable(time, tuple(columns[1:]), values[:, 1:], keys.get("indegrees", "no").lower() == "yes")


def counted(declared: str | None) -> int | None:
    """A number of rows or markers as a header declares it; None where that is no whole number."""
    digits = (declared or "").strip()
    if not _WHOLE.fullmatch(digits):
        return None
    return int(digits) if len(digits) < 19 else 10**18  # more than any file holds


def read_csv(path: Path) -> TextTable:
    """A table of comma-separated values, names in its first line.

    Raises
    ------
    RecordingError
        The file is missing or empty.
    """
    lines = lines_of(read_text(path))
    start = next((i for i, line in enumerate(lines) if line.strip()), None)
    if start is None:
        raise RecordingError(f"{path}: no CSV table: the file is empty")
    try:
        names = next(csv.reader([lines[start].rstrip()], skipinitialspace=True))
    except csv.Error as error:
        raise RecordingError(f"{path}: no CSV table ({error})") from None
    return TextTable(path, [name.strip() for name in names], lines[start + 1 :], start + 2, ",")
