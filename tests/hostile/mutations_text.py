"""Damage specific to text tables (TRC, MOT, CSV): encodings, line ends, cells, rows, columns, wrong headers."""

from __future__ import annotations

from collections.abc import Callable

import mutations_bytes
import numpy as np

CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e400", "1e308", "-1e308", "1e-320", "-", ".", "1,5", "1.5.2", "0x10"),
    *("NA", "null", "None", "True", "#", "#N/A", "(null)", "1_000", "１２", "²", "٣", "ü", "𝟙", '"', "'", '"5', "1d3"),
    *(
        "\x00",
        "\x0b",
        "\x0c",
        "\x1c",
        "\x85",
        "\u2028",
        "\ufeff",
        "\t",
        "9" * 25,
        "9" * 400,
        "9" * 5000,
        "-0",
        "+1",
        "1e",
    ),
    *(
        "9223372036854775808",
        "1e19",
        "-1e19",
        "1e16",
        "0",
        "1",
        "-1",
        "65536",
        "4294967296",
        "a" * 3000,
        "\\N",
        "%s",
        "{0}",
    ),
)
KEYS = (
    "nRows",
    "nColumns",
    "inDegrees",
    "NumFrames",
    "NumMarkers",
    "DataRate",
    "Units",
    "endheader",
    "version",
    "time",
)


def lines_of(data: bytearray) -> list[bytes]:
    return bytes(data).split(b"\n")


def cell(data: bytearray, rng: np.random.Generator) -> None:
    """Replace a few cells, mostly near the top."""
    lines = lines_of(data)
    for _ in range(int(2 ** rng.uniform(0, 4))):
        top = min(len(lines), 12) if rng.random() < 0.5 else len(lines)
        row = int(rng.integers(top))
        for separator in (b"\t", b",", b"=", b" "):
            if separator in lines[row]:
                cells = lines[row].split(separator)
                cells[rng.integers(len(cells))] = str(rng.choice(CELLS)).encode("utf-8", "surrogatepass")
                lines[row] = separator.join(cells)
                break
    data[:] = b"\n".join(lines)


def header_number(data: bytearray, rng: np.random.Generator) -> None:
    """Change a number in the first lines."""
    lines = lines_of(data)
    rows = [row for row in range(min(len(lines), 8)) if any(byte in b"0123456789" for byte in lines[row])]
    if not rows:
        return
    row = int(rng.choice(rows))
    for separator in (b"\t", b"=", b" "):
        cells = lines[row].split(separator)
        numeric = [k for k, text in enumerate(cells) if text.strip().replace(b".", b"", 1).isdigit()]
        if numeric:
            k = int(rng.choice(numeric))
            value = float(cells[k])
            lies = (
                0,
                -1,
                value + 1,
                value - 1,
                2 * value,
                1e9,
                1e30,
                2**31,
                2**63,
                "",
                "x",
                "²",
                "nan",
                "inf",
                "1e999",
            )
            lie = lies[rng.integers(len(lies))]
            cells[k] = (f"{lie:g}" if isinstance(lie, float) else str(lie)).encode()
            lines[row] = separator.join(cells)
            break
    data[:] = b"\n".join(lines)


def rows(data: bytearray, rng: np.random.Generator) -> None:
    """Remove, duplicate, exchange, extend or shorten rows."""
    lines = lines_of(data)
    for _ in range(int(rng.integers(1, 4))):
        k, other = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
        what = int(rng.integers(7))
        if what == 0:
            del lines[k]
        elif what == 1:
            lines.insert(k, lines[k])
        elif what == 2:
            lines[k], lines[other] = lines[other], lines[k]
        elif what == 3:
            lines[k] += b"\t1.0" * int(rng.integers(1, 50))
        elif what == 4:
            lines[k] = lines[k][: len(lines[k]) // 2]
        elif what == 5:
            lines.insert(k, b"")
        else:
            lines[k] = b"#" + lines[k]
        lines = lines or [b""]
    data[:] = b"\n".join(lines)


def column(data: bytearray, rng: np.random.Generator) -> None:
    """Remove a column, duplicate it or move it to the front."""
    separator = b"\t" if b"\t" in data else b","
    lines, k, what = lines_of(data), int(rng.integers(8)), int(rng.integers(3))
    for row, line in enumerate(lines):
        cells = line.split(separator)
        if k < len(cells):
            taken = cells.pop(k)
            cells = [*cells, taken, taken] if what == 0 else [taken, *cells] if what == 1 else cells
            lines[row] = separator.join(cells)
    data[:] = b"\n".join(lines)


def encoding(data: bytearray, rng: np.random.Generator) -> None:
    text = bytes(data).decode("latin-1")
    code = str(rng.choice(["utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp037", "utf-7"]))
    data[:] = text.encode(code, "replace")


def line_ends(data: bytearray, rng: np.random.Generator) -> None:
    ends = (b"\r\n", b"\r", b"\n\n", b"\n\r", b"\r\r\n", b"\x0b", b"\x85", b"\x00\n", b"\x1c")
    data[:] = bytes(data).replace(b"\n", ends[rng.integers(len(ends))])


def separator(data: bytearray, rng: np.random.Generator) -> None:
    old, new = ((b"\t", b" "), (b"\t", b","), (b",", b";"), (b",", b"\t"), (b".", b","), (b"=", b":"))[rng.integers(6)]
    data[:] = bytes(data).replace(old, new)


def insert(data: bytearray, rng: np.random.Generator) -> None:
    at = int(rng.integers(min(len(data), 400) + 1)) if rng.random() < 0.5 else int(rng.integers(len(data) + 1))
    data[at:at] = str(rng.choice(CELLS)).encode("utf-8", "surrogatepass")


def key(data: bytearray, rng: np.random.Generator) -> None:
    """Change the case of a header's name, remove it or duplicate it."""
    old = str(rng.choice(KEYS)).encode()
    new = (old.upper(), b"", old + b" " + old, old[::-1], old + b"\n" + old)[rng.integers(5)]
    data[:] = bytes(data).replace(old, new, 1)


STRUCTURED: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    cell,
    cell,
    cell,
    header_number,
    header_number,
    rows,
    rows,
    column,
    encoding,
    line_ends,
    separator,
    insert,
    insert,
    key,
)


def apply(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 4))):
        if rng.random() < 0.85:
            STRUCTURED[rng.integers(len(STRUCTURED))](data, rng)
        else:
            mutations_bytes.apply(data, rng, 1)
