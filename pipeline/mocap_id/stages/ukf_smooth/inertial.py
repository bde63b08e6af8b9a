"""Inertial sensors of a trial, for the stage ukf-smooth: their logs, their facts for the summary, and reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.estimation.inertial import SensorResult, SensorSignals
from mocap_id.estimation.inertial.clock import OBSERVABLE_SD
from mocap_id.recording.held_samples import describe_held
from mocap_id.recording.imu_log import read_imu
from mocap_id.stages.trial_keys import InertialSensor
from mocap_id.verdict import Reason

_SATURATED = 3e-3  # fraction of saturated samples above which they are reported
_DIFFERS, _LEAST_RATE = 0.15, 0.8  # fraction of the angular velocity from which a difference is reported; rad/s


def check_method(method: str, engine: str) -> None:
    """Raise ConfigError if inertial sensors in the plane cannot be used with these settings of ukf-smooth."""
    if method != "rts" or engine != "compiled":
        raise ConfigError("imus: inertial sensors need `ukf-smooth: {method: rts, engine: compiled}`")


def read_sensors(
    names: Sequence[str], sensors: Mapping[str, InertialSensor], mirrored: bool = False
) -> dict[int, SensorSignals]:
    """Read the log of each sensor; return the signals by the index of the segment in ``names``.

    ``sensors`` are the logs by segment, and ``mirrored`` is as for :func:`read_sensor`.

    Raises
    ------
    ConfigError
        A sensor is on a segment that does not exist.
    RecordingError
        A log cannot be read.
    """
    for name in sensors:
        if name not in names:
            raise ConfigError(
                f"imus: there is no segment {name!r}; the segments are {', '.join(names)}. If the motion is too small "
                "to separate all segments, name a trial in which all joints move as `calibration:`"
            )
    return {names.index(name): read_sensor(sensor, mirrored) for name, sensor in sensors.items()}


def describe_sensors(
    names: Sequence[str],
    sensors: Mapping[str, InertialSensor],
    signals: Mapping[int, SensorSignals],
    results: Mapping[int, SensorResult],
) -> tuple[dict[str, dict[str, Any]], tuple[Reason, ...]]:
    """Return the facts of all sensors for the summary, by segment, and the reasons for the verdict.

    ``names`` are the segments, ``sensors`` the logs by segment, ``signals`` and ``results`` the signals and results of
    the sensors by index of the segment.
    """
    facts = {names[s]: describe_sensor(result) for s, result in results.items()}
    reasons = [
        reason for s, result in results.items() for reason in _reasons(names, s, sensors[names[s]].file.name, result)
    ]
    return facts, (*(reason for each in signals.values() for reason in each.reasons), *reasons)


def read_sensor(sensor: InertialSensor, mirrored: bool = False) -> SensorSignals:
    """Read the log of a sensor.

    If ``mirrored``, as for a left arm, the signs of the force along z of the sensor and of the rotations about its x
    and y are reversed.
    """
    log = read_imu(sensor.file, sensor.rate_hz)
    reasons = describe_held(log.held)
    if not mirrored:
        return SensorSignals(log.time, log.gyro, log.acc, reasons)
    gyro, acc = log.gyro * np.array([-1.0, -1.0, 1.0]), log.acc * np.array([1.0, 1.0, -1.0])
    return SensorSignals(log.time, gyro, acc, reasons)


def describe_sensor(result: SensorResult) -> dict[str, Any]:
    """Return the facts of a sensor for the summary."""
    found = result.calibration
    facts: dict[str, Any] = {"used": result.used is not None, "why": result.why}
    if found is None:
        return facts
    known = bool(np.isfinite(found.clock.sd))
    return facts | {
        "clock_offset_s": found.clock.offset if known else None,
        "sd_s": found.clock.sd if known else None,
        "ppm": 1e6 * found.clock.drift if known else None,
        "observable": found.clock.observable and result.why is None,
        "gyro_bias_rad_s": found.gyro_bias.tolist(),
        "gyro_bias_sd_rad_s": found.sd["gyro_bias"].tolist(),
        "acc_bias_m_s2": found.acc_bias.tolist(),
        "acc_bias_sd_m_s2": found.sd["acc_bias"].tolist(),
        "mounting": found.mount.tolist(),
        "mounting_sd_deg": float(np.degrees(np.max(found.sd["turn"]))),
        "position_m": found.place.tolist(),
        "position_sd_m": found.sd["place"].tolist(),
        "skin_share": found.lag,
        "gyro_residual_rad_s": float(found.residual[0]),
        "acc_residual_m_s2": float(found.residual[1]),
        "saturated": result.saturated,
    }


def _reasons(names: Sequence[str], s: int, file: str, result: SensorResult) -> list[Reason]:
    name, found = names[s].replace("_", " "), result.calibration
    if result.why is not None:
        better = result.better_segment
        other = "" if better is None else f" It fits the motion of the {names[better].replace('_', ' ')}."
        message = f"the sensor on the {name} ({file}) is left out: {result.why}.{other} Check its segment and its file."
        return [Reason("imu-disagrees", message)]
    reasons = []
    off = 0.0 if found is None else float(np.sqrt(3.0) * found.residual[0])
    limit = _DIFFERS * max(_LEAST_RATE, 0.0 if found is None else found.segment_rate)
    if off > limit:
        message = (
            f"the angular velocity of the {name} from its sensor ({file}) differs from that of its markers by "
            f"{off:.2f} rad/s rms; usual is less than {limit:.2f}. The markers may be on another segment or hidden for "
            "a long time, or the sensor may be loose."
        )
        reasons.append(Reason("imu-differs", message, off, limit))
    if found is not None and not found.clock.observable:
        reasons.append(report_clock(name, found.clock.sd))
    return reasons + report_saturation(name, result.saturated)


def report_clock(segment: str, sd: float) -> Reason:
    """Return a note that the motion does not determine a sensor's clock; ``sd`` is its standard deviation, s."""
    message = (
        f"the motion of the {segment} does not determine the clock of its sensor to 2 ms (standard deviation "
        f"{1e3 * sd:.1f} ms)."
    )
    return Reason("imu-clock", message, sd, OBSERVABLE_SD, "ok")


def report_saturation(segment: str, share: float) -> list[Reason]:
    """Return a caution if too many samples of a segment's sensor are saturated; ``share`` is their fraction."""
    if share <= _SATURATED:
        return []
    message = f"{100 * share:.1f} % of the samples of the sensor on the {segment} are saturated and left out."
    return [Reason("imu-saturated", message, share, _SATURATED)]
