"""Writers of C3D, TRC, MOT and STO files, for simulated trials and export."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import RecordingError
from mocap_id.recording.lab_plates import PlateSignals, compute_plate_axes
from mocap_id.recording.model import Recording, to_z_up

_CHANNEL_NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_SAME_FRAME = 0.01
"""Largest accepted difference between the time of the first frame and the time of its number, in frames."""

_LAST_TIME = 1e5  # largest time in a text file, s; its nine digits are too coarse for later times


def write_c3d(
    path: Path,
    labels: Sequence[str],
    positions: FloatArray,
    rate: float,
    *,
    first_frame: int = 1,
    plates: Sequence[PlateSignals] = (),
) -> None:
    """Write markers and force plates as a C3D file (Intel, real, mm, N, N·mm, Z up).

    ``positions`` (F, M, 3) are in lab axes with Z up, m; NaN becomes residual -1. ``rate`` is in frames per second.
    ``first_frame`` counts from 1. The plates are of type 2 and cover every frame, all with the same rate, an integer
    multiple of the frame rate. The file is written under a temporary name and renamed when complete. Raises ValueError
    if labels, frames and plates do not match.
    """
    frames, markers = positions.shape[:2]
    if len(labels) != markers or positions.shape != (frames, markers, 3) or not frames:
        raise ValueError(f"positions of shape {positions.shape} do not fit {len(labels)} labels")
    import ezc3d  # noqa: PLC0415  only needed for writing

    content: Any = ezc3d.c3d()
    point = content["parameters"]["POINT"]
    point["UNITS"]["value"] = ["mm"]
    point["RATE"]["value"] = [float(rate)]
    point["LABELS"]["value"] = tuple(labels)
    content.add_parameter("POINT", "X_SCREEN", "+X")
    content.add_parameter("POINT", "Y_SCREEN", "+Z")
    points = np.ones((4, markers, frames))
    points[:3] = positions.transpose(2, 1, 0) * 1e3
    residuals = np.where(np.isfinite(positions).all(axis=2).T, 0.0, -1.0)
    content["data"]["points"] = points
    content["data"]["meta_points"]["residuals"] = residuals[None]
    content["header"]["points"]["first_frame"] = min(first_frame, 65535) - 1
    # The first and last frame are two 16-bit words each, since a word of the header cannot exceed 65,535.
    for name, number in (("ACTUAL_START_FIELD", first_frame), ("ACTUAL_END_FIELD", first_frame + frames - 1)):
        low, high = number % 65536, number // 65536
        content.add_parameter("TRIAL", name, [low - 65536 if low > 32767 else low, high])
        content["parameters"]["TRIAL"][name]["type"] = 2  # 16-bit words; without this, ezc3d writes floats
    if plates:
        per_frame = round(plates[0].rate / rate)
        for plate in plates:
            if plate.kind != 2 or plate.rate != plates[0].rate or len(plate.channels) != frames * per_frame:
                raise ValueError("plates must be of type 2, share one rate and cover every frame")
        if abs(per_frame * rate - plates[0].rate) > 1e-6 * plates[0].rate:
            raise ValueError(
                f"the analog rate {plates[0].rate} Hz is not an integer multiple of the frame rate {rate} Hz"
            )
        numbers = range(1, len(plates) + 1)
        analog = content["parameters"]["ANALOG"]
        analog["RATE"]["value"] = [float(plates[0].rate)]
        analog["LABELS"]["value"] = tuple(f"{name}{n}" for n in numbers for name in _CHANNEL_NAMES)
        analog["UNITS"]["value"] = ("N", "N", "N", "Nmm", "Nmm", "Nmm") * len(plates)
        analog["SCALE"]["value"] = [1.0] * 6 * len(plates)
        analog["OFFSET"]["value"] = [0] * 6 * len(plates)
        to_file = np.array([1, 1, 1, 1e3, 1e3, 1e3])
        content["data"]["analogs"] = np.concatenate([plate.channels * to_file for plate in plates], axis=1).T[None]
        force = content["parameters"]["FORCE_PLATFORM"]
        force["USED"]["value"] = [len(plates)]
        force["TYPE"]["value"] = [2] * len(plates)
        force["ZERO"]["value"] = [0, 0]
        force["CHANNEL"]["value"] = np.arange(1, 6 * len(plates) + 1).reshape(len(plates), 6).T
        force["CORNERS"]["value"] = np.stack([plate.corners.T * 1e3 for plate in plates], axis=2)
        force["ORIGIN"]["value"] = np.stack([plate.origin * 1e3 for plate in plates], axis=1)
    _write_atomically(path, lambda partial: content.write(str(partial)))


def write_recording(path: Path, recording: Recording) -> None:
    """Write a recording as a C3D file.

    Raises RecordingError if a C3D file cannot store the recording. The frames must be evenly spaced, and the first must
    be at 0 s or a multiple of the frame interval later. All usable plates must have corners and cover every frame with
    the same rate, a multiple of the frame rate.
    """
    _check_even(recording)
    at = float(recording.time[0] * recording.rate)  # frame 1 of a C3D file is at 0 s
    if at < -_SAME_FRAME or abs(at - round(at)) > _SAME_FRAME:
        raise RecordingError(
            f"the first frame is at {recording.time[0]:.9g} s; a C3D file stores times from 0 s on that are multiples "
            f"of 1/{recording.rate:g} s: subtract a constant from all times, also from those of the plates"
        )
    first = round(at) + 1
    plates = []  # channels with which plates of type 2 measure the wrenches; NaN for invalid samples
    for plate in (plate for plate in recording.plates if plate.usable):
        if plate.corners is None:
            raise RecordingError(f"plate {plate.index} has no corners; expected (4, 3), in m")
        if abs(plate.start - recording.time[0]) > 0.5 / plate.rate:
            raise RecordingError(
                f"plate {plate.index} starts at {plate.start} s; expected {recording.time[0]} s, the time of the first "
                "frame: resample the plate"
            )
        axes = compute_plate_axes(plate.corners)
        about_centre = plate.moment - np.cross(plate.corners.mean(axis=0), plate.force)
        channels = np.concatenate([plate.force @ axes, about_centre @ axes], axis=1)
        channels[~plate.ok] = np.nan
        plates.append(PlateSignals(2, channels, np.zeros(3), plate.corners, plate.rate))
    try:
        write_c3d(path, recording.labels, recording.positions, recording.rate, first_frame=first, plates=plates)
    except ValueError as error:
        raise RecordingError(f"the recording cannot be written as C3D: {error}") from error


def write_recording_as_text(path: Path, recording: Recording) -> None:
    """Write the markers of a recording as a TRC file, and its usable plates as a MOT file beside it.

    The MOT file contains each wrench as force and moment at the lab's origin, and no corners of plates. Both files have
    Y up, as in OpenSim, and the times of the recording. Raises RecordingError if the frames are not evenly spaced, a
    time is too large for the format, or the plates have different sample times.
    """
    _check_even(recording)
    if np.abs(recording.time).max() > _LAST_TIME:
        raise RecordingError(
            f"the recording runs from {recording.time[0]:g} to {recording.time[-1]:g} s; expected times below "
            f"{_LAST_TIME:g} s: subtract a constant from all times"
        )
    plates = [plate for plate in recording.plates if plate.usable]
    clocks = {(plate.rate, plate.start, len(plate.force)) for plate in plates}
    if len(clocks) > 1:
        raise RecordingError(
            "the plates have different rates, starts or numbers of samples; resample them to the same times"
        )
    first, begin = max(int(recording.frames[0]), 1), float(recording.time[0])
    write_trc(path, recording.labels, recording.positions, recording.rate, first_frame=first, start=begin)
    if not plates:
        return
    rate, start, count = clocks.pop()
    time = start + np.arange(count) / rate
    rotation = to_z_up("Y").T
    kinds = ("v", "p", "m")
    names = [f"ground_force_{k}_{kind}{axis}" for k in range(1, len(plates) + 1) for kind in kinds for axis in "xyz"]
    values = []
    for plate in plates:
        known = np.where(plate.ok[:, None], 1.0, np.nan)
        values += [known * plate.force @ rotation.T, np.zeros((count, 3)), known * plate.moment @ rotation.T]
    text = format_motion_table(path.stem, names, np.concatenate(values, axis=1), time=time)
    _write_atomically(path.with_suffix(".mot"), lambda partial: partial.write_text(text, encoding="utf-8"))


def _check_even(recording: Recording) -> None:
    if not np.allclose(np.diff(recording.time) * recording.rate, 1.0, atol=1e-3):
        raise RecordingError("the frames are not evenly spaced in time; expected one frame every 1/rate")


def write_trc(
    path: Path,
    labels: Sequence[str],
    positions: FloatArray,
    rate: float,
    *,
    first_frame: int = 1,
    start: float | None = None,
) -> None:
    """Write markers as a TRC file (mm, Y up as in OpenSim); missing markers are blank.

    Other parameters are those of :func:`write_c3d`; ``start`` is the time of the first frame, s, by default with frame
    1 at 0 s.
    """
    y_up = np.stack([positions[..., 0], positions[..., 2], -positions[..., 1]], axis=-1)
    numbers = first_frame + np.arange(len(positions))
    time = (numbers - 1) / rate if start is None else start + np.arange(len(positions)) / rate
    text = format_trc(path.name, labels, y_up, time=time, frames=numbers, rate=rate)
    _write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def _write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        write(partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def format_trc(
    name: str, labels: Sequence[str], positions: FloatArray, *, time: FloatArray, frames: IntArray, rate: float
) -> str:
    """Return markers as the text of a TRC file in mm; missing markers are blank.

    ``name`` is the file name for the first line. ``positions`` (F, M, 3) have Y up, m; NaN if missing. Raises
    ValueError if the arrays do not fit together.
    """
    count, markers = positions.shape[:2]
    if len(labels) != markers or len(time) != count or len(frames) != count:
        raise ValueError(
            f"positions of shape {positions.shape} do not fit {len(labels)} labels, {len(time)} times and "
            f"{len(frames)} frame numbers"
        )
    first = frames[0] if count else 1
    header = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.9g}\t{rate:.9g}\t{count}\t{markers}\tmm\t{rate:.9g}\t{first}\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(labels),
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, markers + 1)),
        "",
    ]
    numbers = zip(frames.tolist(), time.tolist(), (positions.reshape(count, -1) * 1e3).tolist(), strict=True)
    rows = []
    for frame, at, row in numbers:
        cells = "\t".join("" if isnan(value) else f"{value:.5f}" for value in row)
        end = "\t" if row and isnan(row[-1]) else ""  # after a blank last cell OpenSim needs another tab
        rows.append(f"{frame}\t{at:.9g}\t{cells}{end}")
    return "\n".join([*header, *rows, ""])


def format_motion_table(
    name: str, columns: Sequence[str], values: FloatArray, *, time: FloatArray, in_degrees: bool = False
) -> str:
    """Return values (T, C) at times (T,), s, as the text of a MOT or STO file.

    ``name`` is the name of the table for the first line. NaN is written as ``nan``; OpenSim's own programs cannot read
    files that contain it. ``in_degrees`` is the value of ``inDegrees`` in the header; the values are not converted.
    Raises ValueError if columns, times and values do not fit together.
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
