"""Perturbations of inertial sensors: errors that the program does not estimate, added to their logs.

A constant offset or drift of a clock, a constant bias and a constant mounting are estimated for every trial. What
varies during the trial is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog, imu_csv, read_imu
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.trial_inputs import TrialInputs

_WANDERS = 7.0  # s, period of a clock's wander
_SLIPS = 0.5  # s, in which a sensor turns


def with_perturbed_logs(trial: TrialInputs, change: Perturbation, folder: Path) -> TrialInputs:
    """Return the trial with perturbed logs of all inertial sensors, which are written to a folder."""
    files = {}
    for number, (segment, file) in enumerate(trial.source.keys.imus.items()):
        rng = np.random.default_rng([number, *change.rng().integers(2**32, size=4)])
        files[segment] = folder / f"{number}.csv"
        files[segment].write_bytes(imu_csv(LOG_CHANGES[change.kind](read_imu(file), change.level, rng)))
    keys = trial.source.keys.model_copy(update={"imus": files})
    return replace(trial, source=replace(trial.source, keys=keys))


def _wandering_clock(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log with time stamps that wander by ``level`` s."""
    phase = rng.uniform(0, 2 * np.pi)
    return replace(log, time=log.time + level * np.sin(2 * np.pi * log.time / _WANDERS + phase))


def _drifting_bias(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log with a bias of the gyroscope from ``-level`` to ``level`` rad/s, along a random direction."""
    ramp = np.interp(log.time, log.time[[0, -1]], [-level, level])
    return replace(log, gyro=log.gyro + ramp[:, None] * _direction(rng))


def _turned_sensor(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return the log of a sensor that turns by ``level`` rad on its segment in the middle of the trial."""
    middle, axis = float(log.time[[0, -1]].mean()), _direction(rng)
    share = np.clip((log.time - middle) / _SLIPS + 0.5, 0.0, 1.0)
    back = so3.exp(-level * share[:, None] * axis)
    speed = level * np.gradient(share, log.time)
    gyro = np.einsum("fij,fj->fi", back, log.gyro) + speed[:, None] * axis
    return replace(log, gyro=gyro, acc=np.einsum("fij,fj->fi", back, log.acc))


def _direction(rng: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    found = rng.standard_normal(3)
    return np.asarray(found / np.linalg.norm(found))


LOG_CHANGES: Mapping[str, Callable[[ImuLog, float, np.random.Generator], ImuLog]] = {
    "imu-clock": _wandering_clock,
    "imu-bias": _drifting_bias,
    "imu-mounting": _turned_sensor,
}
"""The function of each kind, which changes the log of one sensor."""
