"""A recording in one form for all file formats (markers, plates, notes), and names of axes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.extras import optional
from mocap_id.recording.sample_checks import SENSOR_HZ, HeldSamples, check_rate, check_times

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

LENGTHS: dict[str, float] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1e-3),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
}
"""Metres per length unit, by name."""

FORCES: dict[str, float] = {
    **dict.fromkeys(("n", "nt", "newt", "newto", "newton", "newtons"), 1.0),
    **dict.fromkeys(("kn", "kilonewton", "kilonewtons"), 1e3),
    **dict.fromkeys(("dan", "decanewton", "decanewtons"), 10.0),
    **dict.fromkeys(("millinewton", "millinewtons"), 1e-3),
    **dict.fromkeys(("lb", "lbs", "lbf", "pound", "pounds"), 4.4482216152605),
    **dict.fromkeys(("kgf", "kp", "kilopond"), 9.80665),
}
"""Newtons per force unit, by lower-case name, including truncated forms of ``newton``."""

_FEET = dict.fromkeys(("ft", "foot", "feet"), 0.3048)
_ARMS: dict[str, float] = {**LENGTHS, **_FEET}

_SHORTEST_PREFIX = 3


_TIMES = r"[\s.*·x-]"


def find_length_scale(declared: str) -> float | None:
    """Return the size of a declared unit of length, m; None if the name is empty, unknown or ambiguous.

    C3D files truncate strings. A prefix of at least three letters is accepted if all matching names are the same unit.

    Examples
    --------
    >>> find_length_scale("MM"), find_length_scale("mete"), find_length_scale("furlong")
    (0.001, 1.0, None)
    """
    name = strip_padding(declared).strip("()").lower()
    if name in LENGTHS:
        return LENGTHS[name]
    if len(name) < _SHORTEST_PREFIX:
        return None
    meanings = {scale for full, scale in LENGTHS.items() if full.startswith(name)}
    return meanings.pop() if len(meanings) == 1 else None


def check_length_unit(units: str) -> float:
    """Return the size of the unit of length in the user's setting ``units``, m; ConfigError if it is unknown."""
    scale = find_length_scale(units)
    if scale is None:
        raise ConfigError(f"units: {units!r} is not a unit of length; expected one of {', '.join(LENGTHS)}")
    return scale


def find_force_scale(declared: str) -> float | None:
    """Return the size of a declared unit of force, N; None if the name is empty or not a unit of force.

    Examples
    --------
    >>> find_force_scale("N"), find_force_scale("lbf"), find_force_scale("V")
    (1.0, 4.4482216152605, None)
    """
    return FORCES.get(_fold_case(declared))


def find_moment_scale(declared: str) -> float | None:
    """Return the size of a declared unit of moment, N·m; None if the name is empty or not a unit of moment.

    The name consists of a unit of force and a unit of length, with or without a separator. The length may come first;
    without a separator only feet and inches may, because ``mN`` is a millinewton.

    Examples
    --------
    >>> find_moment_scale("N.mm"), round(find_moment_scale("ft-lb"), 4), find_moment_scale("N")
    (0.001, 1.3558, None)
    """
    match = _MOMENT.fullmatch(_fold_case(declared))
    if match is None:
        return None
    force = match["force"] or match["second_force"] or match["last_force"]
    arm = match["arm"] or match["first_arm"] or match["feet"]
    return FORCES[force] * _ARMS[arm]


def strip_padding(declared: str) -> str:
    """Return a text field without blanks and NUL characters at its ends."""
    return declared.strip().strip("\x00").strip()


def _fold_case(declared: str) -> str:
    """Convert a unit to lower case; ``mN`` becomes ``millinewton``, so that it differs from ``MN``."""
    return re.sub("^mN", "millinewton", strip_padding(declared)).lower()


def _join_names(names: dict[str, float]) -> str:
    return "|".join(sorted(names, key=len, reverse=True))


_IMPERIAL = _join_names({**_FEET, **dict.fromkeys(("in", "inch", "inches"), 0.0254)})
_MOMENT = re.compile(
    rf"(?P<force>{_join_names(FORCES)}){_TIMES}*(?P<arm>{_join_names(_ARMS)})"
    rf"|(?P<first_arm>{_join_names(_ARMS)}){_TIMES}+(?P<second_force>{_join_names(FORCES)})"
    rf"|(?P<feet>{_IMPERIAL})(?P<last_force>{_join_names(FORCES)})"
)


SCALES: dict[str, Callable[[str], float | None]] = {
    "force": find_force_scale,
    "point": find_length_scale,
    "moment": find_moment_scale,
}
"""Functions for the units of the channels of a force plate, by quantity."""


@dataclass(frozen=True)
class ReadingOptions:
    """Options of :func:`mocap_id.recording.read`, whose values it has checked."""

    units: str | None
    vertical: str | None
    force_units: Mapping[str, str]  # configured units of force and moment by quantity, in place of those in the file
    unit_required: bool


AXES = ("X", "Y", "Z")
_XYZ = tuple("xyz")  # axes in data frames and datasets
_EVEN = 1e-3  # largest deviation of a time from an even clock, as a fraction of the time between frames


def parse_axis(text: str) -> str | None:
    """Return an axis name in capitals and without plus, such as ``"Z"`` or ``"-Y"``; None if it is not an axis."""
    name = text.strip().strip("\x00").upper()
    sign = "-" if name.startswith("-") else ""
    name = name.lstrip("+-").strip()
    return sign + name if name in AXES else None


def check_axis(vertical: str) -> str:
    """Return the axis name of the user's setting ``vertical``; raise ConfigError if it is not an axis."""
    axis = parse_axis(vertical)
    if axis is None:
        raise ConfigError(f"vertical: {vertical!r} is not an axis; expected X, Y or Z, with a minus if it points down")
    return axis


def axis_vector(axis: str) -> FloatArray:
    """Return the unit vector (3,) of an axis name such as ``"-Y"``, in the axes of the file."""
    vector = np.zeros(3)
    vector[AXES.index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


_TO_Z_UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "X": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-X": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


def to_z_up(axis: str) -> FloatArray:
    """Return the rotation (3, 3) from the file's axes to the axes of the lab, where Z is up.

    The first horizontal axis of the file becomes the lab's X (X for files with Z or Y up, Y for files with X up).
    """
    return np.array(_TO_Z_UP[axis], dtype=np.float64)


def nearest_axis(vector: FloatArray, least_cosine: float = 0.95) -> str | None:
    """Return the signed name of the axis to which a vector (3,) is nearly parallel; None if to none."""
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length == 0.0:
        return None
    unit = vector / length
    index = int(np.argmax(np.abs(unit)))
    if abs(unit[index]) < least_cosine:
        return None
    return ("-" if unit[index] < 0 else "") + AXES[index]


@dataclass(frozen=True)
class Plate:
    """Force plate in lab axes (Z up), SI units.

    Sign convention: force and moment are those of the ground on the body, not of the body on the plate.

    Parameters
    ----------
    index : int
        Number in the file, from 1.
    kind : str
        ``"type 1"`` … ``"type 4"`` (C3D), ``"mot"`` or the name of another source.
    corners : (4, 3) array or None
        Corners of the working surface in the lab, m; None if the file does not contain them.
    force : (K, 3) array
        Force of the ground on the body, N.
    moment : (K, 3) array
        Moment of the ground on the body about the *lab origin*, N·m.
    ok : (K,) bool array
        Whether every channel is finite and not saturated, for each sample.
    rate : float
        Samples per second.
    start : float
        Time of sample 0 on the clock of the recording, s; sample k is at ``start + k / rate``.
    problem : str
        Reason why the plate cannot be used, or empty; the samples of an unusable plate are NaN.
    assumptions : tuple of str
        Assumptions that affect the forces and that the file does not confirm. They are also among the oddities of
        the recording.
    saturated : (K,) bool array or None
        Whether a channel is saturated, for each sample; None if no channel ever is.
    dead : tuple of (str, (3,) array)
        Channels of horizontal force that read the same value in every sample although the plate is loaded: the name of
        each channel and the direction of its force, a unit vector.
    """

    index: int
    kind: str
    corners: FloatArray | None
    force: FloatArray
    moment: FloatArray
    ok: BoolArray
    rate: float
    start: float = 0.0
    problem: str = ""
    assumptions: tuple[str, ...] = ()
    saturated: BoolArray | None = None
    dead: tuple[tuple[str, FloatArray], ...] = ()

    @property
    def centre(self) -> FloatArray | None:
        """Centre of the working surface in the lab, (3,), m; None if the corners are not known."""
        return None if self.corners is None else self.corners.mean(axis=0)

    @property
    def usable(self) -> bool:
        """Whether the plate can be used."""
        return not self.problem

    @classmethod
    def from_arrays(
        cls,
        force: ArrayLike,
        rate: float,
        *,
        moment: ArrayLike | None = None,
        cop: ArrayLike | None = None,
        free_moment: ArrayLike | None = None,
        corners: ArrayLike | None = None,
        units: str = "m",
        start: float = 0.0,
    ) -> Plate:
        """Return a plate made of arrays in memory: force and moment, or force and centre of pressure.

        Parameters
        ----------
        force : (K, 3) array
            Force of the ground on the body in the lab, N. NaN marks an invalid sample in all arrays.
        rate : float
            Samples per second.
        moment : (K, 3) array, optional
            Moment of the ground on the body about the lab's origin.
        cop : (K, 3) array, optional
            Point of application of the force in the lab, instead of ``moment``. It may be NaN where the force is 0.
        free_moment : (K, 3) array, optional
            Moment about the point of application; 0 by default.
        corners : (4, 3) array, optional
            Corners of the surface in the lab. If omitted, the program cannot check whether the force acts on the plate.
        units : str
            Length unit of ``cop`` and ``corners``; moments are in newtons times this unit.
        start : float
            Time of the first sample, s.

        Raises
        ------
        RecordingError
            The arrays do not fit together, or both or neither of ``moment`` and ``cop`` are given.
        ConfigError
            The unit is unknown.
        """
        given = {"moment": moment, "cop": cop, "free_moment": free_moment, "corners": corners}
        metres, newtons = check_length_unit(units), _check_shape("force", force)
        check_rate("plate", rate, "`rate`", SENSOR_HZ)
        counts = {"moment": len(newtons), "cop": len(newtons), "free_moment": len(newtons), "corners": 4}
        arrays = {
            name: metres * _check_shape(name, values, counts[name])
            for name, values in given.items()
            if values is not None
        }
        if ("moment" in arrays) == ("cop" in arrays):
            raise RecordingError("plate: expected either `moment` or `cop`")
        if {"moment", "free_moment"} <= arrays.keys():
            raise RecordingError("plate: `free_moment` belongs to `cop`; `moment` is the moment about the lab's origin")
        if "moment" in arrays:
            about = arrays["moment"]
        else:
            arrays["cop"][(newtons == 0.0).all(axis=1)] = 0.0
            about = np.cross(arrays["cop"], newtons) + arrays.get("free_moment", 0.0)
        ok = np.asarray(np.isfinite(np.hstack([newtons, about])).all(axis=1))
        return cls(1, "arrays", arrays.get("corners"), newtons, about, ok, float(rate), start)

    def mean_vertical(self) -> float:
        """Return the mean upward force of the valid samples, N; NaN if there are none."""
        vertical = self.force[self.ok, 2]
        return float(vertical.mean()) if vertical.size else float("nan")


@dataclass(frozen=True)
class Recording:
    """Marker trajectories and force plates of one trial, in SI units and lab axes with Z up.

    Parameters
    ----------
    files : tuple of Path
        Files that were read.
    format : str
        ``"C3D (Intel, real)"``, ``"TRC"``, ``"TRC + MOT"``.
    labels : tuple of str, length M
        Unique marker names.
    positions : (F, M, 3) array
        Marker positions, m; NaN if a marker was not seen.
    frames : (F,) int array
        Frame numbers in the file.
    time : (F,) array
        Time on the clock of the file, s: 0 at frame 1 (or at frame 0, if the file counts from 0).
    rate : float
        Marker frames per second.
    units : str
        Length unit declared in the file or by the caller.
    vertical : str
        Axis of the file that points up (``"Z"``, ``"Y"``, ``"-Y"``, …); the recording is already rotated so that Z
        points up.
    analog_rate : float or None
        Samples per second of the analog channels; None if there are none.
    plates : tuple of Plate
    oddities : tuple of str
        Notes on all repairs, omissions, assumptions and contradictions, one sentence each.
    left_out : tuple of str
        Labels of unlabelled pieces and of objects, which are not among the markers.
    people : tuple of str
        Beginnings of the labels of each person, such as ``subject-1:``, if the recording shows several people.
    held : tuple of HeldSamples
        Stretches that software repeated or filled with straight lines; these samples are missing or not ``ok``.
    """

    files: tuple[Path, ...]
    format: str
    labels: tuple[str, ...]
    positions: FloatArray
    frames: IntArray
    time: FloatArray
    rate: float
    units: str
    vertical: str
    analog_rate: float | None
    plates: tuple[Plate, ...]
    oddities: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    people: tuple[str, ...] = ()
    held: tuple[HeldSamples, ...] = ()

    @property
    def visible(self) -> BoolArray:
        """Whether each marker is visible in each frame, (F, M)."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    @property
    def missing_fraction(self) -> float:
        """Fraction of the marker samples that are missing; 1 if there are no samples."""
        return float(1.0 - self.visible.mean()) if self.positions.size else 1.0

    @classmethod
    def from_arrays(
        cls,
        labels: Sequence[str],
        positions: ArrayLike,
        rate: float,
        plates: Sequence[Plate] = (),
        *,
        units: str = "m",
        vertical: str = "Z",
        start: float = 0.0,
    ) -> Recording:
        """Return a recording made of arrays in memory.

        Parameters
        ----------
        labels : sequence of str, length M
            Unique marker names.
        positions : (F, M, 3) array
            Marker positions in the lab; NaN where a marker was not seen.
        rate : float
            Frames per second.
        plates : sequence of Plate, optional
            Each starts at its own ``start``, on the clock of the frames. They are numbered from 1 in this order.
        units : str
            Length unit of the positions: ``"m"``, ``"cm"``, ``"mm"`` or ``"in"``.
        vertical : str
            Axis of positions and plates that points up: ``"X"``, ``"Y"`` or ``"Z"``, with a minus if it points down.
        start : float
            Time of the first frame, s.

        Raises
        ------
        RecordingError
            The arrays do not fit together.
        ConfigError
            A unit or an axis is unknown.
        """
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
        return cls(
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

    @classmethod
    def from_frame(
        cls, frame: pd.DataFrame, plates: Sequence[Plate] = (), *, units: str = "m", vertical: str = "Z"
    ) -> Recording:
        """Return a recording made of a data frame that has the format of :meth:`to_frame`.

        The frame has a row for each time (index, s); its columns are pairs of marker and ``x``, ``y`` or ``z``. Other
        parameters and errors are those of :meth:`from_arrays`; RecordingError is also raised if the times are not
        evenly spaced.
        """
        labels = list(dict.fromkeys(name for name, *_ in _list_pairs(frame.columns)))
        wanted = [(label, axis) for label in labels for axis in _XYZ]
        if sorted(map(str, wanted)) != sorted(map(str, _list_pairs(frame.columns))):
            raise RecordingError(
                f"data frame: its columns are {list(frame.columns[:3])} …; expected x, y and z of each marker, "
                "as in Recording.to_frame"
            )
        positions = frame[wanted].to_numpy(np.float64).reshape(len(frame), len(labels), 3)
        rate, start = _measure_clock("data frame", np.asarray(frame.index))
        return cls.from_arrays(labels, positions, rate, plates, units=units, vertical=vertical, start=start)

    def to_frame(self) -> pd.DataFrame:
        """Return the markers as a data frame: a row for each time (index, s), columns of marker and axis, m."""
        import pandas as pd  # noqa: PLC0415  a run needs no data frames

        columns = pd.MultiIndex.from_product([self.labels, _XYZ], names=["marker", "axis"])
        index = pd.Index(self.time, name="time")
        frame = pd.DataFrame(self.positions.reshape(len(index), -1), index=index, columns=columns)
        frame.attrs["units"] = {"time": "s", "x": "m", "y": "m", "z": "m"}
        return frame

    @classmethod
    def from_xarray(cls, dataset: xr.Dataset, *, units: str = "m", vertical: str = "Z") -> Recording:
        """Return a recording made of a dataset that has the format of :meth:`to_xarray`.

        The package xarray is not imported. The dataset contains ``position`` with the dimensions time, marker and axis.
        For each plate k it may contain ``force_k`` and ``moment_k`` (``time_k``, axis), ``ok_k`` (``time_k``) and
        ``corners_k`` (corner, axis). Moments are in newtons times ``units``. Other parameters and errors are those of
        :meth:`from_arrays`; RecordingError is also raised if a variable is missing or times are not evenly spaced.
        """
        dimensions = set(dataset["position"].dims) if "position" in dataset else set()
        if dimensions != {"time", "marker", "axis"} or not dimensions <= set(dataset.coords):
            raise RecordingError(
                f"dataset: its variables are {', '.join(map(str, dataset.data_vars)) or 'none'}; expected `position` "
                "with the dimensions time, marker and axis, and a coordinate for each of them"
            )
        axes = [str(axis) for axis in dataset["axis"].to_numpy()]
        if sorted(axes) != list(_XYZ):
            raise RecordingError(f"dataset: the coordinate `axis` is {', '.join(axes)}; expected x, y, z")
        ordered = dataset.sel(axis=list(_XYZ)).transpose("time", ..., "marker", "axis", missing_dims="ignore")
        rate, start = _measure_clock("dataset", ordered["time"].to_numpy())
        plates = []
        for name in ordered.data_vars:
            kind, _, number = str(name).partition("_")
            if kind != "force":
                continue
            missing = [one for one in (f"moment_{number}", f"time_{number}") if one not in ordered]
            if missing:
                raise RecordingError(
                    f"dataset: plate {number} has no `{missing[0]}`; expected the variables that Recording.to_xarray "
                    "writes"
                )
            hertz, begin = _measure_clock("dataset", ordered[f"time_{number}"].to_numpy())
            force, moment = (ordered[f"{what}_{number}"].to_numpy() for what in ("force", "moment"))
            corners = ordered[f"corners_{number}"].to_numpy() if f"corners_{number}" in ordered else None
            plate = Plate.from_arrays(force, hertz, moment=moment, corners=corners, units=units, start=begin)
            ok = ordered[f"ok_{number}"].to_numpy().astype(bool) if f"ok_{number}" in ordered else plate.ok
            plates.append(replace(plate, ok=plate.ok & ok))
        labels = [str(label) for label in ordered["marker"].to_numpy()]
        positions = ordered["position"].to_numpy()
        return cls.from_arrays(labels, positions, rate, plates, units=units, vertical=vertical, start=start)

    def to_xarray(self) -> xr.Dataset:
        """Return markers and plates as a dataset of xarray, in SI units with z up; ConfigError if xarray is missing."""
        xarray = optional("xarray", "xarray", "Recording.to_xarray")
        found: dict[str, Any] = {"position": (("time", "marker", "axis"), self.positions, {"units": "m"})}
        coordinates: dict[str, Any] = {
            "time": ("time", self.time, {"units": "s"}),
            "marker": list(self.labels),
            "axis": list(_XYZ),
        }
        for plate in self.plates:
            k, clock = plate.index, f"time_{plate.index}"
            coordinates[clock] = (clock, plate.start + np.arange(len(plate.force)) / plate.rate, {"units": "s"})
            found[f"force_{k}"] = ((clock, "axis"), plate.force, {"units": "N"})
            found[f"moment_{k}"] = ((clock, "axis"), plate.moment, {"units": "N m"})
            found[f"ok_{k}"] = ((clock,), plate.ok, {})
            if plate.corners is not None:
                found[f"corners_{k}"] = (("corner", "axis"), plate.corners, {"units": "m"})
        dataset: xr.Dataset = xarray.Dataset(found, coordinates, {"rate": self.rate, "vertical": "Z"})
        return dataset


def rotate_plate(plate: Plate, rotation: FloatArray) -> Plate:
    """Return a plate in other axes; ``rotation`` (3, 3) converts vectors from the old to the new axes."""
    corners = None if plate.corners is None else plate.corners @ rotation.T
    dead = tuple((name, rotation @ direction) for name, direction in plate.dead)
    force, moment = plate.force @ rotation.T, plate.moment @ rotation.T
    return replace(plate, corners=corners, force=force, moment=moment, dead=dead)


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
