"""Time to read a recording and to write its arrays with the libraries alone: ``scale_floor.py FILE.c3d [--quick]``.

Prints JSON, s: reading by numpy (``numpy``), by ezc3d, and by the c3d package unless it fails or with ``--quick``;
writing marker positions as a long table (``parquet``) and as an array (``hdf5``) until they are on the disk.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import ezc3d
import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

BLOCK = 512  # bytes
MISSING = -1.0


def read_by_numpy(file: Path) -> Any:
    """Read positions (F, M, 3), mm, of an Intel file of floats, by the offsets in its header."""
    header = np.fromfile(file, "<u2", BLOCK // 2)
    markers, analog, start = int(header[1]), int(header[2]), int(header[8])
    values = np.fromfile(file, "<f4", offset=(start - 1) * BLOCK)
    width = 4 * markers + analog
    frames = len(values) // width
    points = values[: frames * width].reshape(frames, width)[:, : 4 * markers].reshape(frames, markers, 4)
    return np.where(points[..., 3:] == MISSING, np.nan, points[..., :3].astype(np.float64))


def read_by_c3d(file: Path) -> int:
    import c3d  # noqa: PLC0415

    with file.open("rb") as stream:
        return sum(len(points) > 0 for _, points, _ in c3d.Reader(stream).read_frames(copy=False))


def write_parquet(points: Any, place: Path) -> None:
    """Write a row for each frame and marker."""
    frames, markers, _ = points.shape
    label = pd.Categorical.from_codes(np.tile(np.arange(markers), frames), [f"M{k}" for k in range(markers)])
    number = np.repeat(np.arange(frames), markers)
    flat = points.reshape(-1, 3)
    columns = {"frame": number, "time": number * 0.01, "marker": label, "x": flat[:, 0], "y": flat[:, 1]}
    table = pa.Table.from_pandas(pd.DataFrame(columns | {"z": flat[:, 2]}), preserve_index=False)
    pq.write_table(table, place / "points.parquet")
    sync(place / "points.parquet")


def write_hdf5(points: Any, file: Path) -> None:
    with h5py.File(file, "w") as stream:
        stream["points"] = points
    sync(file)


def sync(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def time_shortest(function: Callable[[], object], times: int = 3) -> float:
    """Return the shortest time of several calls, s."""
    found = []
    for _ in range(times):
        start = perf_counter()
        function()
        found.append(perf_counter() - start)
    return min(found)


def main() -> None:
    file = Path(sys.argv[1])
    points = read_by_numpy(file)
    times = {"numpy": time_shortest(lambda: read_by_numpy(file)), "ezc3d": time_shortest(lambda: ezc3d.c3d(str(file)))}
    if "--quick" not in sys.argv:
        with contextlib.suppress(ValueError):  # it fails on the two-word frame fields that ezc3d writes
            times["c3d"] = time_shortest(lambda: read_by_c3d(file), 1)
    with tempfile.TemporaryDirectory() as place:
        times["parquet"] = time_shortest(lambda: write_parquet(points, Path(place)))
        times["hdf5"] = time_shortest(lambda: write_hdf5(points, Path(place) / "points.h5"))
    print(json.dumps(times))


if __name__ == "__main__":
    main()
