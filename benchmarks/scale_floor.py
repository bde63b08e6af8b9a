"""What reading a recording and writing its arrays takes without any of our code: ``scale_floor.py FILE.c3d``.

Prints JSON, seconds: the file read by numpy alone (``numpy``), by ezc3d, and by the c3d package (``c3d``, frame by
frame in Python; left out with ``--quick``, and where that package cannot read the file); the marker positions with
frame, time and label as a long table (``parquet``) and as they are (``hdf5``) written with each library's own
defaults and synced.
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


def by_numpy(file: Path) -> Any:
    """Positions (F, M, 3), mm, of an Intel file of floats, by the offsets in its header."""
    header = np.fromfile(file, "<u2", BLOCK // 2)
    markers, analog, start = int(header[1]), int(header[2]), int(header[8])
    values = np.fromfile(file, "<f4", offset=(start - 1) * BLOCK)
    width = 4 * markers + analog
    frames = len(values) // width
    points = values[: frames * width].reshape(frames, width)[:, : 4 * markers].reshape(frames, markers, 4)
    return np.where(points[..., 3:] == MISSING, np.nan, points[..., :3].astype(np.float64))


def by_ezc3d(file: Path) -> Any:
    """The same by the reader that this program uses."""
    return ezc3d.c3d(str(file))["data"]["points"]


def by_c3d(file: Path) -> int:
    """Frames, each with its points and analog samples, by the c3d package."""
    import c3d  # noqa: PLC0415

    with file.open("rb") as stream:
        return sum(len(points) > 0 for _, points, _ in c3d.Reader(stream).read_frames(copy=False))


def as_parquet(points: Any, place: Path) -> None:
    """A row a frame and marker."""
    frames, markers, _ = points.shape
    label = pd.Categorical.from_codes(np.tile(np.arange(markers), frames), [f"M{k}" for k in range(markers)])
    number = np.repeat(np.arange(frames), markers)
    flat = points.reshape(-1, 3)
    columns = {"frame": number, "time": number * 0.01, "marker": label, "x": flat[:, 0], "y": flat[:, 1]}
    table = pa.Table.from_pandas(pd.DataFrame(columns | {"z": flat[:, 2]}), preserve_index=False)
    pq.write_table(table, place / "points.parquet")
    synced(place / "points.parquet")


def as_hdf5(points: Any, place: Path) -> None:
    """One array."""
    with h5py.File(place / "points.h5", "w") as file:
        file["points"] = points
    synced(place / "points.h5")


def synced(path: Path) -> None:
    """Have a file on the disk."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def least(function: Callable[[], object], times: int = 3) -> float:
    """Shortest of several runs, s."""
    found = []
    for _ in range(times):
        start = perf_counter()
        function()
        found.append(perf_counter() - start)
    return min(found)


def main() -> None:
    """Measure and tell."""
    file = Path(sys.argv[1])
    points = by_numpy(file)
    told = {"numpy": least(lambda: by_numpy(file)), "ezc3d": least(lambda: by_ezc3d(file))}
    if "--quick" not in sys.argv:
        with contextlib.suppress(ValueError):  # it fails on the two-word frame fields that ezc3d writes
            told["c3d"] = least(lambda: by_c3d(file), 1)
    with tempfile.TemporaryDirectory() as place:
        told["parquet"] = least(lambda: as_parquet(points, Path(place)))
        told["hdf5"] = least(lambda: as_hdf5(points, Path(place)))
    print(json.dumps(told))


if __name__ == "__main__":
    main()
