"""What else than the ground acts on the body, as planarise reads it: a chair on its own plate, other force sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import known
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.plane import PlaneFrame
from mocap_id.plates import PlateChoice, ZeroRule, doubtful, empty_chair
from mocap_id.recording import Look, PlateSamples, Recording
from mocap_id.stages.base import ExternalForce
from mocap_id.stages.marker_names import columns
from mocap_id.verdict import Reason

COMPONENTS = ("Fx", "Fy", "tauz")
"""Of a wrench in the plane."""


@dataclass(frozen=True)
class Measured:
    """Columns for wrench.parquet, rows for its fact ``external``, what to know, and the force upwards as looked at."""

    columns: dict[str, FloatArray] = field(default_factory=dict)
    facts: tuple[dict[str, Any], ...] = ()
    reasons: tuple[Reason, ...] = ()
    vertical: FloatArray | float = 0.0

    def __add__(self, other: Measured) -> Measured:
        return Measured(
            self.columns | other.columns,
            self.facts + other.facts,
            self.reasons + other.reasons,
            self.vertical + other.vertical,
        )


@dataclass(frozen=True)
class Seen:
    """The frames that are used: labels, positions (F, M, 3) in the lab, times (F,), a look at them; the plane."""

    labels: Sequence[str]
    positions: FloatArray
    time: FloatArray
    look: Look
    frame: PlaneFrame


def summed(samples: Sequence[PlateSamples], plates: Sequence[int], frame: PlaneFrame) -> tuple[FloatArray, BoolArray]:
    """Wrench (F, 3) of some plates together in the plane, and where (F,) all of them are known."""
    each = [frame.wrench_to_plane(samples[index].force, samples[index].moment) for index in plates]
    return sum(each[1:], each[0]), np.logical_and.reduce([samples[index].ok for index in plates], axis=0)


def measure_seat(seen: Seen, samples: Sequence[PlateSamples], choice: PlateChoice, zero: ZeroRule) -> Measured:
    """The chair's wrench on the body, from the plates under it."""
    look = seen.look
    doubts = doubtful(look.samples, choice, look.positions)
    reasons = [_doubtful(index, choice, why) for index, why in doubts.items()]
    plates = [index for index in choice.indexes("seat") if index not in doubts]
    if not plates:
        return Measured(reasons=tuple(reasons))
    wrench, ok = summed(samples, plates, seen.frame)
    empty = empty_chair(*summed(look.samples, plates, seen.frame), look.positions, look.rate, zero)
    if empty.reading is None:
        reasons.append(_zero_unknown())
    else:
        wrench = wrench - empty.reading
    wrench[~ok] = np.nan
    fact = {
        "name": "seat",
        "columns": "seat",
        "clock": "plates",
        "plates": [index + 1 for index in plates],
        "zero": None if empty.reading is None else _by_component(empty.reading),
        "zero_sd": None if empty.spread is None else _by_component(empty.spread),
    }
    return Measured(_columns(wrench, "seat"), (fact,), tuple(reasons))


def measure_sensors(seen: Seen, sensors: Sequence[ExternalForce], source: Recording) -> Measured:
    """The wrenches of the sensors that the configuration names.

    Raises
    ------
    ConfigError
        A force acts at a marker that is not there.
    RecordingError
        A sensor's file is unusable or shares no time with the recording.
    """
    each = [_sensor(number, sensor, seen, source) for number, sensor in enumerate(sensors, start=1)]
    return sum(each, Measured())


def _sensor(number: int, sensor: ExternalForce, seen: Seen, source: Recording) -> Measured:
    log = recording.read_force_log(sensor.file)
    turn = recording.to_z_up(source.vertical) * (-1.0 if sensor.force == "on-sensor" else 1.0)
    ok = known(np.hstack([log.force, log.moment]))
    start = log.start + sensor.clock_offset_s
    plate = recording.Plate(0, "sensor", None, log.force @ turn.T, log.moment @ turn.T, ok, log.rate, start)
    sampled = recording.decimate(plate, seen.time, source.rate)
    if not sampled.ok.any():
        raise RecordingError(
            f"{sensor.file}: has no sample in {seen.time[0]:g} to {seen.time[-1]:g} s, the recording's frames; "
            f"it runs from {start:g} to {log.end + sensor.clock_offset_s:g} s on the recording's clock (with "
            f"`clock_offset_s: {sensor.clock_offset_s:g}`): look at `time_s` and the offset"
        )
    moment = sampled.moment + np.cross(_point(sensor, seen, source), sampled.force)
    wrench = seen.frame.wrench_to_plane(sampled.force, moment)
    wrench[~known(wrench)] = np.nan
    fact = {
        "name": sensor.name,
        "columns": f"external_{number}",
        "clock": "cameras",
        "segment": sensor.segment,
        "file": sensor.file.name,
        "rate_hz": log.rate,
        "known_fraction": float(known(wrench).mean()),
    }
    vertical = recording.decimate(plate, seen.look.time, seen.look.rate).force[:, 2]
    return Measured(_columns(wrench, f"external_{number}"), (fact,), (), vertical)


def _point(sensor: ExternalForce, seen: Seen, source: Recording) -> FloatArray:
    """Where the force acts, (F, 3) or (3,), lab axes with Z up, m."""
    if not isinstance(sensor.at, str):
        return np.asarray(recording.to_z_up(source.vertical) @ np.array(sensor.at))
    found = columns(seen.labels, (sensor.at,), f"external: {sensor.name}: at")
    if len(found) > 1:
        raise ConfigError(f"external: {sensor.name}: at: {sensor.at} means {len(found)} markers, expected one")
    return seen.positions[:, found[0]]


def _columns(wrench: FloatArray, suffix: str) -> dict[str, FloatArray]:
    return {f"{name}_{suffix}": column for name, column in zip(COMPONENTS, wrench.T.copy(), strict=True)}


def _by_component(wrench: FloatArray) -> dict[str, float]:
    return dict(zip(COMPONENTS, wrench.tolist(), strict=True))


def _doubtful(index: int, choice: PlateChoice, why: str) -> Reason:
    if choice.uses[index] == "seat":
        advice = "that is no chair's; its wrench was left out. Look at `plates: {feet: …, seat: …}`: are they swapped?"
    else:
        advice = "it looks like a chair's, and was added to the feet's; if a chair stands on it, name it under `seat:`"
    return Reason("plates-doubtful", f"plate {index + 1}, named as the {choice.uses[index]}'s, {why}: {advice}")


def _zero_unknown() -> Reason:
    return Reason(
        "seat-zero-unknown",
        "nobody stands in these frames, so what the chair's plate reads without the person is unknown; its reading was "
        "taken as it is, and the chair's weight counts as the person's. If the plate was zeroed with the chair on it, "
        "say so: `planarise: {seat_zero: none}`",
    )
