"""Conversion of recordings from and to arrays in memory, data frames, and datasets of xarray."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.extras import optional
from mocap_id.recording.clock import SENSOR_HZ, check_rate, check_times
from mocap_id.recording.lab_plates import rotate_plate
from mocap_id.recording.model import Plate, Recording, check_axis, to_z_up
from mocap_id.recording.units import check_length_unit

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

AXES = tuple("xyz")
_EVEN = 1e-3  # largest deviation of a time from an even clock, as a fraction of the time between frames


def plate_from_arrays(
    force: ArrayLike, rate: float, units: str, start: float, **optional_arrays: ArrayLike | None
) -> Plate:
    """Return a plate; parameters and errors as for :meth:`mocap_id.recording.Plate.from_arrays`."""
    metres, newtons = check_length_unit(units), _check_shape("force", force)
    check_rate("plate", rate, "`rate`", SENSOR_HZ)
    counts = {"moment": len(newtons), "cop": len(newtons), "free_moment": len(newtons), "corners": 4}
    arrays = {
        name: metres * _check_shape(name, values, counts[name])
        for name, values in optional_arrays.items()
        if values is not None
    }
    if ("moment" in arrays) == ("cop" in arrays):
        raise RecordingError("plate: expected either `moment` or `cop`")
    if {"moment", "free_moment"} <= arrays.keys():
        raise RecordingError("plate: `free_moment` belongs to `cop`; `moment` is the moment about the lab's origin")
    if "moment" in arrays:
        moment = arrays["moment"]
    else:
        arrays["cop"][(newtons == 0.0).all(axis=1)] = 0.0
        moment = np.cross(arrays["cop"], newtons) + arrays.get("free_moment", 0.0)
    ok = np.asarray(np.isfinite(np.hstack([newtons, moment])).all(axis=1))
    return Plate(1, "arrays", arrays.get("corners"), newtons, moment, ok, float(rate), start)


def recording_from_arrays(
    labels: Sequence[str],
    positions: ArrayLike,
    rate: float,
    plates: Sequence[Plate],
    *,
    units: str,
    vertical: str,
    start: float,
) -> Recording:
    """Return a recording; parameters and errors as for :meth:`mocap_id.recording.Recording.from_arrays`."""
    found = np.array(positions, np.float64) * check_length_unit(units)
    if found.ndim != 3 or not len(found) or found.shape[1:] != (len(labels), 3):
        raise RecordingError(
            f"positions: the shape is {found.shape}; expected (frames, {len(labels)}, 3) for {len(labels)} labels"
        )
    if len(set(labels)) < len(labels):
        raise RecordingError("labels: a name occurs twice; expected a unique name for each marker")
    check_rate("recording", rate, "`rate`")
    axis = check_axis(vertical)
    if axis != "Z":
        rotation = to_z_up(axis)
        found = found @ rotation.T
        plates = [rotate_plate(plate, rotation) for plate in plates]
    frames = np.arange(len(found)) + round(start * rate) + 1
    return Recording(
        files=(),
        format="arrays",
        labels=tuple(map(str, labels)),
        positions=found,
        frames=frames,
        time=start + np.arange(len(found)) / rate,
        rate=float(rate),
        units=units,
        vertical=axis,
        analog_rate=plates[0].rate if plates else None,
        plates=tuple(replace(plate, index=number) for number, plate in enumerate(plates, 1)),
        oddities=(),
    )


def to_frame(recording: Recording) -> pd.DataFrame:
    """Return the markers as a data frame; see :meth:`mocap_id.recording.Recording.to_frame`."""
    import pandas as pd  # noqa: PLC0415  a run needs no data frames

    columns = pd.MultiIndex.from_product([recording.labels, AXES], names=["marker", "axis"])
    index = pd.Index(recording.time, name="time")
    frame = pd.DataFrame(recording.positions.reshape(len(index), -1), index=index, columns=columns)
    frame.attrs["units"] = {"time": "s", "x": "m", "y": "m", "z": "m"}
    return frame


def from_frame(frame: pd.DataFrame, plates: Sequence[Plate], *, units: str, vertical: str) -> Recording:
    """Return a recording; parameters and errors as for :meth:`mocap_id.recording.Recording.from_frame`."""
    labels = list(dict.fromkeys(name for name, *_ in _list_pairs(frame.columns)))
    wanted = [(label, axis) for label in labels for axis in AXES]
    if sorted(map(str, wanted)) != sorted(map(str, _list_pairs(frame.columns))):
        raise RecordingError(
            f"data frame: its columns are {list(frame.columns[:3])} …; expected x, y and z of each marker, "
            "as in Recording.to_frame"
        )
    positions = frame[wanted].to_numpy(np.float64).reshape(len(frame), len(labels), 3)
    rate, start = _measure_clock("data frame", np.asarray(frame.index))
    return recording_from_arrays(labels, positions, rate, plates, units=units, vertical=vertical, start=start)


def to_dataset(recording: Recording) -> xr.Dataset:
    """Return markers and plates as a dataset; see :meth:`mocap_id.recording.Recording.to_xarray`."""
    xarray = optional("xarray", "xarray", "Recording.to_xarray")
    found: dict[str, Any] = {"position": (("time", "marker", "axis"), recording.positions, {"units": "m"})}
    coordinates: dict[str, Any] = {
        "time": ("time", recording.time, {"units": "s"}),
        "marker": list(recording.labels),
        "axis": list(AXES),
    }
    for plate in recording.plates:
        k, clock = plate.index, f"time_{plate.index}"
        coordinates[clock] = (clock, plate.start + np.arange(len(plate.force)) / plate.rate, {"units": "s"})
        found[f"force_{k}"] = ((clock, "axis"), plate.force, {"units": "N"})
        found[f"moment_{k}"] = ((clock, "axis"), plate.moment, {"units": "N m"})
        found[f"ok_{k}"] = ((clock,), plate.ok, {})
        if plate.corners is not None:
            found[f"corners_{k}"] = (("corner", "axis"), plate.corners, {"units": "m"})
    dataset: xr.Dataset = xarray.Dataset(found, coordinates, {"rate": recording.rate, "vertical": "Z"})
    return dataset


def from_dataset(dataset: xr.Dataset, *, units: str, vertical: str) -> Recording:
    """Return a recording; parameters and errors as for :meth:`mocap_id.recording.Recording.from_xarray`."""
    dimensions = set(dataset["position"].dims) if "position" in dataset else set()
    if dimensions != {"time", "marker", "axis"} or not dimensions <= set(dataset.coords):
        raise RecordingError(
            f"dataset: its variables are {', '.join(map(str, dataset.data_vars)) or 'none'}; expected `position` with "
            "the dimensions time, marker and axis, and a coordinate for each of them"
        )
    axes = [str(axis) for axis in dataset["axis"].to_numpy()]
    if sorted(axes) != list(AXES):
        raise RecordingError(f"dataset: the coordinate `axis` is {', '.join(axes)}; expected x, y, z")
    ordered = dataset.sel(axis=list(AXES)).transpose("time", ..., "marker", "axis", missing_dims="ignore")
    rate, start = _measure_clock("dataset", ordered["time"].to_numpy())
    plates = []
    for name in ordered.data_vars:
        kind, _, number = str(name).partition("_")
        if kind == "force":
            plates.append(_read_plate(ordered, number, units))
    labels = [str(label) for label in ordered["marker"].to_numpy()]
    positions = ordered["position"].to_numpy()
    return recording_from_arrays(labels, positions, rate, plates, units=units, vertical=vertical, start=start)


def _read_plate(dataset: xr.Dataset, number: str, units: str) -> Plate:
    """Return the plate of a dataset whose variables end with ``number``; RecordingError if a variable is missing."""
    missing = [name for name in (f"moment_{number}", f"time_{number}") if name not in dataset]
    if missing:
        raise RecordingError(
            f"dataset: plate {number} has no `{missing[0]}`; expected the variables that Recording.to_xarray writes"
        )
    rate, start = _measure_clock("dataset", dataset[f"time_{number}"].to_numpy())
    force, moment = (dataset[f"{kind}_{number}"].to_numpy() for kind in ("force", "moment"))
    corners = dataset[f"corners_{number}"].to_numpy() if f"corners_{number}" in dataset else None
    plate = Plate.from_arrays(force, rate, moment=moment, corners=corners, units=units, start=start)
    ok = dataset[f"ok_{number}"].to_numpy().astype(bool) if f"ok_{number}" in dataset else plate.ok
    return replace(plate, ok=plate.ok & ok)


def _list_pairs(columns: Iterable[Any]) -> list[tuple[Any, ...]]:
    return [column if isinstance(column, tuple) else (column,) for column in columns]


def _measure_clock(owner: str, time: FloatArray) -> tuple[float, float]:
    """Return rate (Hz) and start (s) of evenly spaced times; RecordingError if they are not evenly spaced."""
    if time.dtype.kind not in "fiu":
        raise RecordingError(f"{owner}: its times are not numbers; expected the time of each frame in s")
    time = np.asarray(time, np.float64)
    check_times(owner, time, "its time", SENSOR_HZ, pauses=True)
    rate = (len(time) - 1) / float(time[-1] - time[0])
    even = float(time[0]) + np.arange(len(time)) / rate
    if np.abs(time - even).max() * rate > _EVEN:
        raise RecordingError(f"{owner}: its times are not evenly spaced; expected one frame every 1/rate")
    return float(f"{rate:.9g}"), float(time[0])


def _check_shape(name: str, values: ArrayLike | None, count: int | None = None) -> FloatArray:
    """Return values as an array (count, 3), or (any, 3) if ``count`` is None; RecordingError for another shape."""
    array = np.array(values, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or count not in (None, len(array)) or not len(array):
        expected = "(samples, 3)" if count is None else f"({count}, 3)"
        raise RecordingError(f"plate: `{name}` has the shape {array.shape}; expected {expected}")
    return array
