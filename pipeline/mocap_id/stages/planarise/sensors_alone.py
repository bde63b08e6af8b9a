"""The stage planarise for a trial of inertial sensors alone: a recording without any measured marker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, RecordingError, Refused
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.plates import PlateChoice
from mocap_id.recording import Recording, ThinnedFrames
from mocap_id.recording.imu_log import read_imu
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration_trial import FORMAT, get_calibration, read_chain
from mocap_id.stages.planarise.plate_reasons import describe_plates
from mocap_id.stages.planarise.used_part import UsedPart
from mocap_id.stages.planarise.wrenches import ExternalWrenches, compute_ground_wrench
from mocap_id.stages.trial_keys import InertialSensor, TrialKeys, list_sensors
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH

_RATES = (50.0, 250.0)  # Hz, of the frames
_LEAST_S = 5.0


def planarise_sensors(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet without any measured marker, at the times of the first sensor.

    The trajectories are those of the calibration's markers, all missing; there is no plate.

    Raises ConfigError if the window is outside the recording. Raises RecordingError if a log cannot be read, or the
    sensors have too little time in common. Raises Refused if a moving segment has no sensor, in this trial or in the
    calibration.
    """
    tree = read_chain(get_calibration(context.trial))
    _check_complete(context.trial, tree.texts("segments/name"))
    sensors = list_sensors(context.trial.imus)
    time = _find_common_times(sensors, context.trial.window)
    labels = tree.texts("markers/name")
    rate = 1.0 / float(time[1] - time[0])
    missing = np.full((len(time), len(labels)), np.nan)
    source = Recording(
        files=tuple(sensor.file for sensor in sensors.values()),
        format=FORMAT,
        labels=tuple(labels),
        positions=np.repeat(missing[..., None], 3, axis=2),
        frames=np.arange(1, len(time) + 1),
        time=time,
        rate=rate,
        units="m",
        vertical="by gravity",
        analog_rate=None,
        plates=(),
        oddities=(),
    )
    planar_facts = {
        **UsedPart(source, 0, len(time), source.labels, source.positions, proposed=False).facts,
        "swaps": [],
        "bursts": {},
        "plane": {"yaw_deg": None, "planarity": None, "lean_deg": None, "origin_m": None, "facing": None},
        "missing_fraction": 1.0,
    }
    values = {"x": missing, "y": missing, "z": missing, "visible": np.isfinite(missing)}
    planar = LongTable(PLANAR, source.frames, time, source.labels, values, planar_facts, ())
    choice, threshold = PlateChoice((), (), ()), context.settings.cop_threshold_N
    thinned = ThinnedFrames.of(source.positions, time, rate, ())
    facts, reasons = describe_plates(source, thinned, choice, ExternalWrenches(), threshold)
    reasons = tuple(replace(each, level="ok") for each in reasons)  # nobody expects a plate here
    facts["registration"] = {}
    return planar, Table(WRENCH, compute_ground_wrench(time, (), choice, PlaneFrame(0.0), threshold), facts, reasons)


def _check_complete(trial: TrialKeys, segments: Sequence[str]) -> None:
    """Raise Refused if a moving segment has no sensor, and ConfigError if a sensor is on no segment."""
    calibration = get_calibration(trial)
    without = [name for name in segments[1:] if name not in trial.imus or name not in calibration.imus]
    for name in trial.imus:
        if name not in segments:
            raise ConfigError(f"imus: there is no segment {name!r}; the segments are {', '.join(segments)}")
    if without:
        raise Refused(
            "imus-alone-incomplete",
            f"without markers, every moving segment ({', '.join(segments[1:])}) needs an inertial sensor in this trial "
            f"and in {calibration.trial.name}; one of the two trials has none on the {' and '.join(without)}.",
        )


def _find_common_times(sensors: Mapping[str, InertialSensor], window: tuple[float, float] | None) -> FloatArray:
    """Return times with a constant step, s, that all sensors cover, on the assumption that their clocks agree."""
    logs = {segment: read_imu(sensor.file, sensor.rate_hz) for segment, sensor in sensors.items()}
    first, last = max(log.time[0] for log in logs.values()), min(log.time[-1] for log in logs.values())
    steps = [float(np.median(np.diff(log.time))) for log in logs.values()]
    rate = float(np.clip(round(1.0 / max(steps)), *_RATES))
    if last - first < _LEAST_S:
        files = ", ".join(sensor.file.name for sensor in sensors.values())
        raise RecordingError(
            f"{files}: the sensors have {max(last - first, 0):.1f} s in common, expected at least {_LEAST_S:g} s; use "
            "logs of one recording"
        )
    start, stop = (first, last) if window is None else (max(first, window[0]), min(last, window[1]))
    if stop - start < _LEAST_S:
        raise ConfigError(
            f"`window:` contains less than {_LEAST_S:g} s of the sensor logs, which run from {first:g} to {last:g} s"
        )
    return np.asarray(np.arange(np.ceil(start * rate), np.floor(stop * rate) + 1) / rate)
