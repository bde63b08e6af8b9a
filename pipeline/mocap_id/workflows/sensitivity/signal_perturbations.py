"""Perturbations of the signals: angles, wrench, clock offset, noise of the filter, and logs of inertial sensors.

The program estimates a constant offset or drift of an inertial sensor's clock, a constant bias and a constant mounting
for every trial. The perturbations of the logs therefore vary during the trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.geometry import so3
from mocap_id.plates import GRAVITY
from mocap_id.recording.imu_log import ImuLog, format_imu_csv, read_imu
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.store import Table
from mocap_id.workflows.sensitivity.kinds import ALL, COMPONENTS
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.trial_inputs import LAST, TrialInputs

_HALF_DEPTH_M = 0.119  # distance of the cells of a balance board from its centre, along the motion
_WANDER_PERIOD = 7.0  # s
_SLIP_TIME = 0.5  # s, in which a sensor rotates on its segment
STATES, WRENCH = "states.parquet", "wrench.parquet"


def filter_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with fixed noise of the filter (3.17), which is otherwise estimated: sigma_v and marker sd."""
    return trial.with_settings("ukf-smooth", sigma_v=change.level, marker_sd=float(change.target))


def joints_of(trial: TrialInputs, change: Perturbation) -> IntArray:
    """Return the indices of the joints that a perturbation changes."""
    joints = trial.joints
    return np.arange(len(joints)) if change.target == ALL else np.array([joints.index(change.target)])


def angle_bias(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with a constant added to angles, but not to their derivatives."""
    table = trial.table(STATES)
    columns = [f"theta_{j + 1}" for j in joints_of(trial, change)]
    return trial.with_artefacts(table.with_columns(**{name: table[name] + change.level for name in columns}))


def clock_offset(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with the plates' samples delayed by the level; the program may estimate this offset."""
    return trial.with_artefacts(_delay(trial.table(WRENCH), change.level))


def clock_offset_ignored(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with the plates' samples delayed by ``change.level``, s, which the program does not correct.

    If the program corrected the clock offset of the unperturbed trial, the samples are first corrected by this offset.
    """
    table, offset = trial.table(WRENCH), trial.tree("dynamics.h5").facts["clock_offset_s"]
    is_applied = getattr(trial.settings[LAST], "apply_clock_offset", False)
    coarse = float((table.facts.get("clock") or {}).get("offset_s") or 0.0)  # already corrected in the table
    corrected = offset - coarse if is_applied and offset is not None else 0.0
    if is_applied and coarse:
        trial = trial.with_artefacts(replace(table, facts={**table.facts, "clock": None}))
    delayed = clock_offset(trial, replace(change, level=change.level - corrected))
    return delayed.with_settings(LAST, apply_clock_offset=False)


def _delay(table: Table, delay: float | FloatArray) -> Table:
    """Return wrench.parquet delayed by ``delay`` (one value or (T,)), s; sensors with their own clock do not change."""
    if not np.any(delay):
        return table
    time = table["time"]
    sensors = [fact["columns"] for fact in table.facts.get("external") or () if fact["clock"] != "plates"]
    fixed = {"time", "plate_ok", *(f"{name}_{sensor}" for name in COMPONENTS for sensor in sensors)}
    delayed = {
        name: SampledWrench.of(time, table[name][:, None])(time + delay)[:, 0]
        for name in table.names
        if name not in fixed
    }
    nearest = np.searchsorted(time, time + delay - (time[1] - time[0]) / 2)
    plate_ok = table["plate_ok"][np.clip(nearest, 0, len(time) - 1)]
    return table.with_columns(**delayed, plate_ok=plate_ok & np.isfinite(delayed["Fy"]))


def wrench_bias(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with a constant added to a component of the plates' wrench."""
    return _add_error(trial, change.target, change.level)


def wrench_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with white noise, one value for each frame, added to a component of the plates' wrench."""
    return _add_error(trial, change.target, change.level * change.rng().standard_normal(trial.table(WRENCH).length))


def board_steps(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with rounding errors of a balance board's four load cells added to Fy and tauz."""
    error = change.level * (change.rng().random((trial.table(WRENCH).length, 4)) - 0.5) * GRAVITY
    front, back = error[:, :2].sum(axis=1), error[:, 2:].sum(axis=1)
    return _add_error(_add_error(trial, "Fy", front + back), "tauz", _HALF_DEPTH_M * (front - back))


def stamp_jitter(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with random shifts of the plates' sample times; the level is their standard deviation."""
    length = trial.table(WRENCH).length
    return trial.with_artefacts(_delay(trial.table(WRENCH), change.level * change.rng().standard_normal(length)))


def _add_error(trial: TrialInputs, component: str, error: float | FloatArray) -> TrialInputs:
    """Return the trial with an error added to a component, and with updated mass and centre of pressure."""
    table = trial.table(WRENCH)
    table = table.with_columns(**{component: table[component] + error})
    facts = dict(table.facts)
    if component == "Fy" and facts.get("mass_kg") is not None:
        gravity = getattr(trial.settings[LAST], "gravity")  # noqa: B009  the settings are a stage's own
        facts["mass_kg"] = float(facts["mass_kg"] + np.mean(error) / gravity)
    loaded = table["Fy"] > facts["cop_threshold_N"]
    cop = np.divide(table["tauz"], table["Fy"], out=np.full(table.length, np.nan), where=loaded)
    return trial.with_artefacts(replace(table.with_columns(cop_x=cop), facts=facts))


def perturb_logs(trial: TrialInputs, change: Perturbation, folder: Path) -> TrialInputs:
    """Write perturbed logs of all inertial sensors to ``folder``, and return the trial with these logs."""
    files = {}
    for number, (segment, sensor) in enumerate(list_sensors(trial.source.keys.imus).items()):
        rng = np.random.default_rng([number, *change.rng().integers(2**32, size=4)])
        files[segment] = folder / f"{number}.csv"
        files[segment].write_bytes(
            format_imu_csv(LOG_CHANGES[change.kind](read_imu(sensor.file, sensor.rate_hz), change.level, rng))
        )
    keys = trial.source.keys.model_copy(update={"imus": files})
    return replace(trial, source=replace(trial.source, keys=keys))


def _wander_clock(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log whose time stamps have a sinusoidal error with an amplitude of ``level`` s."""
    phase = rng.uniform(0, 2 * np.pi)
    return replace(log, time=log.time + level * np.sin(2 * np.pi * log.time / _WANDER_PERIOD + phase))


def _drift_bias(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log with a bias of the gyroscope from ``-level`` to ``level`` rad/s, along a random direction."""
    ramp = np.interp(log.time, log.time[[0, -1]], [-level, level])
    return replace(log, gyro=log.gyro + ramp[:, None] * _draw_direction(rng))


def _rotate_sensor(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return the log of a sensor that rotates by ``level`` rad on its segment in the middle of the trial."""
    middle, axis = float(log.time[[0, -1]].mean()), _draw_direction(rng)
    share = np.clip((log.time - middle) / _SLIP_TIME + 0.5, 0.0, 1.0)
    back = so3.exp(-level * share[:, None] * axis)
    speed = level * np.gradient(share, log.time)
    gyro = np.einsum("fij,fj->fi", back, log.gyro) + speed[:, None] * axis
    return replace(log, gyro=gyro, acc=np.einsum("fij,fj->fi", back, log.acc))


def _draw_direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


LOG_CHANGES: Mapping[str, Callable[[ImuLog, float, np.random.Generator], ImuLog]] = {
    "imu-clock": _wander_clock,
    "imu-bias": _drift_bias,
    "imu-mounting": _rotate_sensor,
}
"""The function that changes the log of one sensor, by kind."""
