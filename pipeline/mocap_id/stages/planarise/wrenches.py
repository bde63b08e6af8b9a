"""Wrenches on the body: of the ground, of a chair on its own plate, and of force sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.kinematics.base_motion import BaseMotion
from mocap_id.plates import PlateChoice, ZeroRule, find_contradictions, measure_empty_chair
from mocap_id.recording import Plate, PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.held_samples import describe_held
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.trial_keys import ExternalForce
from mocap_id.verdict import Reason

_ZERO_UNKNOWN = Reason(
    "seat-zero-unknown",
    "the person never stands in these frames, so the reading of the empty chair's plate is not known. It was not "
    "corrected, and the chair's weight counts as the person's. If the plate was zeroed with the chair on it, set "
    "`planarise: {seat_zero: none}`",
)
COMPONENTS = ("Fx", "Fy", "tauz")
"""Components of a wrench in the plane."""


_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")

_MIRROR = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])  # of a wrench, for z → -z: moments are axial vectors


@dataclass(frozen=True)
class ExternalWrenches:
    """External wrenches at the F frames, for wrench.parquet."""

    columns: dict[str, FloatArray] = field(default_factory=dict)  # (F,) by name
    facts: tuple[dict[str, Any], ...] = ()  # items of the fact ``external``
    reasons: tuple[Reason, ...] = ()
    vertical: FloatArray | float = 0.0  # upward force at the thinned frames, N

    def __add__(self, other: ExternalWrenches) -> ExternalWrenches:
        return ExternalWrenches(
            self.columns | other.columns,
            self.facts + other.facts,
            self.reasons + other.reasons,
            self.vertical + other.vertical,
        )


@dataclass(frozen=True)
class UsedFrames:
    """Frames that are used, with the plane and the motion of the base."""

    labels: Sequence[str]  # M names
    positions: FloatArray  # (F, M, 3) in the lab, m
    time: FloatArray  # (F,) s
    thinned: ThinnedFrames
    frame: PlaneFrame
    base: BaseMotion | None = None  # None if the base is fixed


def add_wrenches(
    samples: Sequence[PlateSamples], plates: Sequence[int], frame: PlaneFrame
) -> tuple[FloatArray, BoolArray]:
    """Return the sum of the wrenches of ``plates`` in the plane (F, 3), and the samples (F,) in which all are valid."""
    each = [frame.wrench_to_plane(samples[index].force, samples[index].moment) for index in plates]
    return sum(each[1:], each[0]), np.logical_and.reduce([samples[index].ok for index in plates], axis=0)


def measure_seat(
    used: UsedFrames, samples: Sequence[PlateSamples], choice: PlateChoice, zero: ZeroRule
) -> ExternalWrenches:
    """Return the chair's wrench on the body, measured by the plates under the chair; no columns if there are none."""
    thinned = used.thinned
    doubts = find_contradictions(thinned.samples, choice, thinned.positions)
    reasons = [_describe_doubt(index, choice, why) for index, why in doubts.items()]
    plates = [index for index in choice.indices("seat") if index not in doubts]
    if not plates:
        return ExternalWrenches(reasons=tuple(reasons))
    wrench, ok = add_wrenches(samples, plates, used.frame)
    empty = measure_empty_chair(
        *add_wrenches(thinned.samples, plates, used.frame), thinned.positions, thinned.rate, zero
    )
    if empty.reading is None:
        reasons.append(_ZERO_UNKNOWN)
    else:
        wrench = wrench - empty.reading
    if used.base is not None:
        chair = np.zeros(3) if empty.reading is None else empty.reading
        wrench = _subtract_chair([samples[index] for index in plates], chair, used, used.base)
    wrench[~ok] = np.nan
    fact = {
        "name": "seat",
        "columns": "seat",
        "clock": "plates",
        "plates": [index + 1 for index in plates],
        "zero": None if empty.reading is None else _by_component(empty.reading),
        "zero_sd": None if empty.spread is None else _by_component(empty.spread),
    }
    return ExternalWrenches(_name_columns(wrench, "seat"), (fact,), tuple(reasons))


def _subtract_chair(
    samples: Sequence[PlateSamples], chair: FloatArray, used: UsedFrames, base: BaseMotion
) -> FloatArray:
    """Return the wrench of a chair on the body (F, 3), relative to a base that moves, while the chair does not move.

    ``chair`` (3,) is the wrench of the empty chair in the plane.
    """
    x, y, z = used.frame.axes
    weight = chair[0] * x + chair[1] * y
    force = sum((each.force for each in samples), -weight)
    moment = sum((each.moment for each in samples), -chair[2] * z - np.cross(used.frame.origin, weight))
    return used.frame.wrench_to_plane(*base.undo_wrench(force, moment, used.time))


def measure_sensors(used: UsedFrames, sensors: Sequence[ExternalForce], source: Recording) -> ExternalWrenches:
    """Return the wrenches of the sensors in the configuration.

    Raises ConfigError if the marker at which a force acts does not exist. Raises RecordingError if a sensor's file is
    unusable or shares no time with the recording.
    """
    each = [_measure_sensor(number, sensor, used, source) for number, sensor in enumerate(sensors, start=1)]
    return sum(each, ExternalWrenches())


def _measure_sensor(number: int, sensor: ExternalForce, used: UsedFrames, source: Recording) -> ExternalWrenches:
    log = recording.read_force_log(sensor.file)
    turn = recording.to_z_up(source.vertical) * (-1.0 if sensor.force == "on-sensor" else 1.0)
    ok = find_complete_rows(np.hstack([log.force, log.moment]))
    start = log.start + sensor.clock_offset_s
    plate = recording.Plate(0, "sensor", None, log.force @ turn.T, log.moment @ turn.T, ok, log.rate, start)
    sampled = recording.decimate(plate, used.time, source.rate)
    if not sampled.ok.any():
        raise RecordingError(
            f"{sensor.file}: it has no sample between {used.time[0]:g} and {used.time[-1]:g} s, the times of the "
            f"recording; it runs from {start:g} to {log.end + sensor.clock_offset_s:g} s on the same clock (with "
            f"`clock_offset_s: {sensor.clock_offset_s:g}`): check `time_s` and the offset"
        )
    moment = sampled.moment + np.cross(_find_point(sensor, used, source), sampled.force)
    acting = sampled.force, moment
    wrench = used.frame.wrench_to_plane(*(acting if used.base is None else used.base.undo_wrench(*acting, used.time)))
    wrench[~find_complete_rows(wrench)] = np.nan
    fact = {
        "name": sensor.name,
        "columns": f"external_{number}",
        "clock": "cameras",
        "segment": sensor.segment,
        "file": sensor.file.name,
        "rate_hz": log.rate,
        "known_fraction": float(find_complete_rows(wrench).mean()),
        "measures": sensor.measures,
    }
    held = describe_held(log.held, used.time[0] - sensor.clock_offset_s, used.time[-1] - sensor.clock_offset_s)
    if sensor.measures == "beyond":  # not a force of the surroundings
        return ExternalWrenches(_name_columns(wrench, f"external_{number}"), (fact,), held)
    vertical = recording.decimate(plate, used.thinned.time, used.thinned.rate).force[:, 2]
    return ExternalWrenches(_name_columns(wrench, f"external_{number}"), (fact,), held, vertical)


def _find_point(sensor: ExternalForce, used: UsedFrames, source: Recording) -> FloatArray:
    """Return the point of application, (F, 3) or (3,), lab axes with Z up, m."""
    if not isinstance(sensor.at, str):
        return np.asarray(recording.to_z_up(source.vertical) @ np.array(sensor.at))
    found = find_markers(used.labels, (sensor.at,), f"external: {sensor.name}: at")
    if len(found) > 1:
        raise ConfigError(f"external: {sensor.name}: at: {sensor.at} matches {len(found)} markers, expected one")
    return used.positions[:, found[0]]


def _name_columns(wrench: FloatArray, suffix: str) -> dict[str, FloatArray]:
    return {f"{name}_{suffix}": column for name, column in zip(COMPONENTS, wrench.T.copy(), strict=True)}


def _by_component(wrench: FloatArray) -> dict[str, float]:
    return dict(zip(COMPONENTS, wrench.tolist(), strict=True))


def _describe_doubt(index: int, choice: PlateChoice, why: str) -> Reason:
    if choice.uses[index] == "seat":
        advice = "a chair does not do this; its wrench was left out. Are they swapped in `plates: {feet: …, seat: …}`?"
    else:
        advice = "it looks like a chair's, but was added to the feet's; if a chair stands on it, name it under `seat:`"
    return Reason("plates-doubtful", f"plate {index + 1}, named under `{choice.uses[index]}:`, {why}: {advice}")


def compute_ground_wrench(
    time: FloatArray, samples: Sequence[PlateSamples], choice: PlateChoice, frame: PlaneFrame, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns of wrench.parquet: the sum of the feet's plates and, if several plates exist, each plate alone.

    ``samples`` are the wrenches of all plates at the marker times ``time`` (F,), s. The centre of pressure is NaN up to
    the vertical force ``threshold``, N.
    """
    feet, count = choice.indices("feet"), len(time)
    total, ok = add_wrenches(samples, feet, frame) if feet else (np.empty((count, 3)), np.zeros(count, np.bool_))
    columns = _build_columns(time, COMPONENTS, total, ok, threshold)
    if len(samples) > 1:
        for number, plate in enumerate(samples, start=1):
            alone = frame.wrench_to_plane(plate.force, plate.moment).T.copy()
            columns |= {f"{name}_p{number}": each for name, each in zip(COMPONENTS, alone, strict=True)}
    return columns


def compute_ground_wrench_in_space(
    time: FloatArray,
    samples: Sequence[PlateSamples],
    choice: PlateChoice,
    frame: PlaneFrame,
    threshold: float,
    *,
    mirrored: bool = False,
) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns of wrench.parquet in space: the six components of the sum of the feet's plates at marker times.

    Parameters are as in :func:`compute_ground_wrench`. ``frame`` is the frame of the trial (y up), about whose origin
    the moments are. ``mirrored`` says whether the trial is mirrored, z → -z.
    """
    feet, count = choice.indices("feet"), len(time)
    ok = np.logical_and.reduce([samples[index].ok for index in feet]) if feet else np.zeros(count, np.bool_)
    force = sum((samples[index].force for index in feet), np.zeros((count, 3)))
    moment = sum((samples[index].moment for index in feet), np.zeros((count, 3))) - np.cross(frame.origin, force)
    total = np.concatenate([force @ frame.axes.T, moment @ frame.axes.T], axis=1)
    if mirrored:
        total *= _MIRROR
    return _build_columns(time, _IN_SPACE, total, ok, threshold)


def _build_columns(
    time: FloatArray, names: Sequence[str], total: FloatArray, ok: BoolArray, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of a wrench (F, len(names)) whose second component is Fy and whose last is tauz."""
    total[~ok] = np.nan
    with np.errstate(invalid="ignore"):
        vertical = np.where(total[:, 1] > threshold, total[:, 1], np.nan)
    components = dict(zip(names, total.T.copy(), strict=True))
    return {"time": time, **components, "cop_x": total[:, -1] / vertical, "plate_ok": ok}


def find_plates_centre(
    plates: Sequence[Plate], choice: PlateChoice, frame: PlaneFrame, *, mirrored: bool
) -> list[float] | None:
    """Return the centre (3,) of the feet's plates in the frame of a trial in space, m; None if it is not known."""
    centres = [plates[index].centre for index in choice.indices("feet")]
    known = [each for each in centres if each is not None]
    if not known or len(known) < len(centres):
        return None
    centre = frame.to_plane(np.mean(known, axis=0))
    return [float(x) for x in (centre * [1.0, 1.0, -1.0] if mirrored else centre)]


def measure_lateral_cop(samples: Sequence[PlateSamples], frame: PlaneFrame, threshold: float) -> list[float | None]:
    """Return the median centre of pressure of each plate along z, m; None if never loaded above ``threshold``, N."""
    medians: list[float | None] = []
    for plate in samples:
        force = plate.force @ frame.axes.T
        moment = (plate.moment - np.cross(frame.origin, plate.force)) @ frame.axes.T
        loaded = plate.ok & (np.nan_to_num(force[:, 1]) > threshold)
        medians.append(float(np.median(-moment[loaded, 0] / force[loaded, 1])) if loaded.any() else None)
    return medians
