"""Text of TRC, MOT and STO files in the form that OpenSim reads."""

from __future__ import annotations

import io
from collections.abc import Sequence
from math import isnan

import numpy as np

from mocap_id.arrays import FloatArray, IntArray

_MILLIMETRES = 1e3


def format_trc(
    name: str, labels: Sequence[str], positions: FloatArray, *, time: FloatArray, frames: IntArray, rate: float
) -> str:
    """Return markers as the text of a TRC file in mm; missing markers are blank.

    Parameters
    ----------
    name : str
        File name for the first line.
    labels : sequence of str, length M
    positions : (F, M, 3) array
        Marker positions, axes with Y up, m; NaN if missing.
    time : (F,) array
        Times, s.
    frames : (F,) int array
        Frame numbers.
    rate : float
        Frames per second.

    Raises
    ------
    ValueError
        Labels, frames and positions do not fit together.
    """
    count, markers = positions.shape[:2]
    if len(labels) != markers or len(time) != count or len(frames) != count:
        raise ValueError(f"positions of shape {positions.shape} do not fit {len(labels)} labels, {len(time)} times")
    first = frames[0] if count else 1
    header = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.9g}\t{rate:.9g}\t{count}\t{markers}\tmm\t{rate:.9g}\t{first}\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(labels),
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, markers + 1)),
        "",
    ]
    numbers = zip(frames.tolist(), time.tolist(), (positions.reshape(count, -1) * _MILLIMETRES).tolist(), strict=True)
    rows = [f"{frame}\t{at:.9g}\t{_format_row(row)}" for frame, at, row in numbers]
    return "\n".join([*header, *rows, ""])


def _format_row(row: Sequence[float]) -> str:
    """Return the coordinates of a frame as text; after a blank last cell OpenSim needs another tab."""
    cells = "\t".join("" if isnan(value) else f"{value:.5f}" for value in row)
    return f"{cells}\t" if row and isnan(row[-1]) else cells


def format_motion_table(
    name: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> str:
    """Return a table as the text of a MOT or STO file.

    Parameters
    ----------
    name : str
        Name of the table for the first line.
    columns : sequence of str, length C
        Names of all columns except time.
    values : (T, C) array
        Values; NaN is written as ``nan``, at which OpenSim's own programs stop reading.
    time : (T,) array
        Times, s.
    in_degrees : bool
        Value of ``inDegrees`` in the header; the values themselves are not converted.

    Raises
    ------
    ValueError
        Columns, times and values do not fit together.
    """
    if values.shape != (len(time), len(columns)):
        raise ValueError(f"values of shape {values.shape} do not fit {len(time)} times and {len(columns)} columns")
    header = [
        name,
        "version=1",
        f"nRows={len(time)}",
        f"nColumns={len(columns) + 1}",
        f"inDegrees={'yes' if in_degrees else 'no'}",
        "endheader",
        "\t".join(["time", *columns]),
        "",
    ]
    body = io.StringIO()
    np.savetxt(body, np.column_stack([time, values]), fmt="%.10g", delimiter="\t")
    return "\n".join(header) + body.getvalue()
