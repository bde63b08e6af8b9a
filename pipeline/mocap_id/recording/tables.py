"""OpenSim's MOT and STO tables."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from mocap_id import plain_files
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError

_HEADER_LINES = 100
_WHOLE = re.compile("[0-9]+")
_LINE_END = re.compile("\r\n|\n|\r")

NOT_NUMBERS = (ValueError, OverflowError, pd.errors.ParserError, pd.errors.EmptyDataError)
"""What pandas raises on a table that is none of numbers."""


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
    data = read_bytes(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def lines_of(text: str) -> list[str]:
    """The lines of a table, whatever their ends; other separators (form feeds, U+0085) are no ends of lines."""
    lines = _LINE_END.split(text)
    return lines[:-1] if not lines[-1] else lines


def read_bytes(path: Path) -> bytes:
    """A file's bytes, or the reason why there are none."""
    try:
        return plain_files.read(path)
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
    frame = numeric_lines(path, lines[header + 1 :])
    columns = [str(column).strip() for column in frame.columns]
    if not columns or columns[0].lower() != "time":
        raise RecordingError(f"{path}: the first column is {columns[:1]}, expected 'time'")
    declared = counted(keys.get("nrows") or keys.get("datarows"))
    if declared is not None and declared != len(frame):
        raise RecordingError(
            f"{path}: the header promises {declared} rows, the file holds {len(frame)}; export it again"
        )
    values = frame.to_numpy(np.float64)
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


def read_csv(path: Path, text: str) -> pd.DataFrame:
    """A table of comma-separated values, names first.

    Raises
    ------
    RecordingError
        It is no such table, or a quote that is never closed swallows rows.
    """
    try:
        frame = pd.read_csv(io.StringIO(text), skipinitialspace=True)
    except NOT_NUMBERS as error:
        raise RecordingError(f"{path}: no CSV table ({' '.join(str(error).split())[:160]})") from None
    rows = sum(bool(line.strip()) for line in lines_of(text)) - 1
    if len(frame) != rows:
        raise RecordingError(
            f"{path}: {rows} lines follow the names, but they make {len(frame)} rows: a quote or a stray character "
            "runs over the ends of lines; export it again"
        )
    return frame


def numeric_lines(path: Path, lines: list[str]) -> pd.DataFrame:
    """A block of text, names first, as numbers; blank cells are NaN."""
    body = [line.rstrip() for line in lines if line.strip()]
    if len(body) < 2:
        raise RecordingError(f"{path}: the table is empty")
    separator = "\t" if "\t" in body[1] else r"\s+"
    try:
        frame = pd.read_csv(
            io.StringIO("\n".join(body)),
            sep=separator,
            index_col=False,
            skipinitialspace=True,
            quoting=csv.QUOTE_NONE,  # a stray quote would swallow rows
        )
        return frame.dropna(axis=1, how="all").astype(np.float64)
    except NOT_NUMBERS as error:
        raise RecordingError(f"{path}: not a table of numbers: {' '.join(str(error).split())[:160]}") from None
