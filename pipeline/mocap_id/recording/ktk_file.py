"""Reader of the files of Kinetics Toolkit, ``.ktk.zip``: TimeSeries of points and of force platforms."""

from __future__ import annotations

import json
import os
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.lab_plates import reverse_force_on_plate
from mocap_id.recording.marker_tables import MarkerTable
from mocap_id.recording.markers import assemble_recording
from mocap_id.recording.model import (
    Plate,
    ReadingOptions,
    Recording,
    find_force_scale,
    find_length_scale,
    find_moment_scale,
    rotate_plate,
)
from mocap_id.recording.sample_checks import MARKER_HZ, SENSOR_HZ, fit_even_clock

MAGIC = b"PK\x03\x04"
CLASS, SERIES = "class__", "ktk.TimeSeries"
POINTS, PLATES = "Points", "ForcePlatforms"
"""Names under which ``ktk.read_c3d`` returns its series."""

_LARGEST, _BYTES_PER_BYTE = 38 << 20, 6
"""Limit of the unpacked text: the first number of bytes, plus the second for each byte of the file. The numbers need
ten times this memory."""
_FORCE = re.compile(r"(.+)_Force")
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, KeyError, NotImplementedError, OSError, RuntimeError)


@dataclass(frozen=True)
class Series:
    """A TimeSeries of Kinetics Toolkit with T samples."""

    name: str
    time: FloatArray  # (T,) s
    data: Mapping[str, FloatArray]  # arrays with T rows, by name
    units: Mapping[str, str]  # unit of each array; empty without a unit

    @property
    def points(self) -> list[str]:
        """Names of the arrays that contain points: (T, 4) with a last column of ones, or (T, 3)."""
        found = {name: values for name, values in self.data.items() if values.ndim == 2}
        return [
            name
            for name, values in found.items()
            if values.shape[1] == 3
            or (values.shape[1] == 4 and bool((np.nan_to_num(values[:, 3], nan=1.0) == 1).all()))
        ]


def read_ktk(path: Path, stream: BinaryIO, options: ReadingOptions) -> Recording:
    """Read markers and force platforms; parameters and errors as for :func:`mocap_id.recording.read`."""
    oddities: list[str] = []
    series = read_series(path, stream)
    candidates = [each for name, each in series.items() if each.points and name != PLATES]
    chosen = [each for each in candidates if each.name == POINTS] or candidates
    if len(chosen) != 1:
        names = ", ".join(each.name for each in chosen)
        raise RecordingError(
            f"{path}: {f'several TimeSeries contain points, {names}' if chosen else 'no TimeSeries contains points'}; "
            f"expected the markers in a TimeSeries named {POINTS!r}, as from `ktk.read_c3d`"
        )
    points = chosen[0]
    start, rate = _fit_clock(path, points, MARKER_HZ, oddities)
    labels = points.points
    declared = {points.units[name] for name in labels}
    if len({find_length_scale(unit) for unit in declared}) > 1:
        raise RecordingError(f"{path}: the points have different units: {', '.join(sorted(map(repr, declared)))}")
    positions = np.stack([points.data[label][:, :3] for label in labels], axis=1)
    numbers = np.arange(len(positions))
    frames = numbers + max(round(start * rate), 0) + 1
    time, rate = start + numbers / rate, float(f"{rate:.9g}")
    table = MarkerTable("Kinetics Toolkit", labels, frames, time, positions, rate, min(declared), "Z")
    plates = _read_plates(path, series[PLATES], options.force_units, oddities) if PLATES in series else []
    force = sum((np.nan_to_num(plate.force).mean(axis=0) for plate in plates), np.zeros(3))
    recording, rotation = assemble_recording(path, table, force, options, oddities)
    rotated = []
    for plate in (rotate_plate(plate, rotation) for plate in plates):
        ok = np.isfinite(plate.force[:, 2])
        force, moment = reverse_force_on_plate(plate.index, plate.force, plate.moment, ok, oddities)
        rotated.append(replace(plate, force=force, moment=moment))
    analog_rate = rotated[0].rate if rotated else None
    return replace(recording, plates=tuple(rotated), analog_rate=analog_rate, oddities=tuple(oddities))


def read_series(path: Path, stream: BinaryIO) -> dict[str, Series]:
    """Return every TimeSeries of a file by name; if the file is a single TimeSeries, its name is ``Points``.

    Raises RecordingError if the file is damaged, too large, or contains no TimeSeries.
    """
    stream.seek(0, os.SEEK_END)
    most = _LARGEST + _BYTES_PER_BYTE * stream.tell()
    try:
        with zipfile.ZipFile(stream) as archive:
            size = archive.getinfo("data.json").file_size
            if size > most:
                raise RecordingError(
                    f"{path}: it unpacks to {size / 1e6:.0f} MB of text, expected at most {most / 1e6:.0f} MB; save "
                    f"only {POINTS} and {PLATES}, or use the C3D file"
                )
            with archive.open("data.json") as text:
                content = json.loads(text.read(size))
        parts = {POINTS: content} if _is_series(content) else content
        found = {}
        for name, part in ((str(name), part) for name, part in parts.items() if _is_series(part)):
            time = np.asarray(part["time"], np.float64)
            data = {str(key): np.asarray(values, np.float64) for key, values in part["data"].items()}
            info = part.get("info") or part.get("data_info") or {}  # before version 0.17, `data_info`
            for key, values in data.items():
                if len(values) != len(time):
                    raise ValueError(f"{key} has {len(values)} samples for {len(time)} times")
            units = {key: str((info.get(key) or {}).get("Unit", "")) for key in data}
            found[name] = Series(name, time, data, units)
    except (AttributeError, RecursionError, TypeError, ValueError) as error:
        words = str(error).partition("\n")[0][:80]
        raise RecordingError(f"{path}: not a valid file of Kinetics Toolkit ({words}); save it again") from None
    except _UNREADABLE as error:
        raise RecordingError(f"{path}: a damaged file of Kinetics Toolkit ({error}); save it again") from None
    if not found:
        raise RecordingError(
            f"{path}: the file contains no TimeSeries; save the TimeSeries from `ktk.read_c3d` with `ktk.save`"
        )
    return found


def _is_series(part: Any) -> bool:
    return isinstance(part, Mapping) and part.get(CLASS) == SERIES


def _fit_clock(path: Path, series: Series, fastest: float, oddities: list[str]) -> tuple[float, float]:
    start, rate, note = fit_even_clock(path, series.time, name=f"the time of {series.name}", fastest=fastest)
    if note:
        oddities.append(f"{series.name}: {note}")
    return start, rate


def _read_plates(path: Path, series: Series, units: Mapping[str, str], oddities: list[str]) -> list[Plate]:
    """Return the platforms in the axes of the file, with moments about the origin."""
    names = [match[1] for name in series.data if (match := _FORCE.fullmatch(name))]
    if not names:
        return []
    start, rate = _fit_clock(path, series, SENSOR_HZ, oddities)
    plates = []
    for index, name in enumerate(names, 1):
        force = _read_vector(path, series, f"{name}_Force", find_force_scale, units.get("force"))
        corners = [f"{name}_Corner{k}" for k in (1, 2, 3, 4)]
        known = all(corner in series.data for corner in corners)
        corner = np.stack([_read_vector(path, series, one, find_length_scale)[0] for one in corners]) if known else None
        if corner is not None and f"{name}_MomentAtCenter" in series.data:
            point: FloatArray = corner.mean(axis=0)
            moment = _read_vector(path, series, f"{name}_MomentAtCenter", find_moment_scale, units.get("moment"))
        elif {f"{name}_COP", f"{name}_MomentAtCOP"} <= set(series.data):
            point = _read_vector(path, series, f"{name}_COP", find_length_scale)
            point[(force == 0.0).all(axis=1)] = 0.0
            moment = _read_vector(path, series, f"{name}_MomentAtCOP", find_moment_scale, units.get("moment"))
        else:
            raise RecordingError(
                f"{path}: {name} has a force, but neither {name}_MomentAtCenter with the corners {name}_Corner1 to "
                f"{name}_Corner4, nor {name}_COP with {name}_MomentAtCOP; save {PLATES} as `ktk.read_c3d` returns it"
            )
        about = np.cross(point, force) + moment
        ok = np.asarray(np.isfinite(np.hstack([force, about])).all(axis=1))
        plates.append(Plate(index, "Kinetics Toolkit", corner, force, about, ok, rate, start))
    return plates


def _read_vector(path: Path, series: Series, name: str, scale: Any, configured: str | None = None) -> FloatArray:
    """Return a vector (T, 3) in SI units.

    ``scale`` returns the SI value of a unit; the unit ``configured`` replaces the declared unit.
    """
    values, unit = series.data[name], configured or series.units[name]
    factor = scale(unit)
    if values.ndim != 2 or values.shape[1] not in (3, 4) or factor is None:
        what = f"the unit {unit!r}" if factor is None else f"the shape {values.shape}"
        raise RecordingError(f"{path}: {name} has {what}; expected a vector of 4 columns in N, m or Nm")
    return np.asarray(values[:, :3] * factor)
