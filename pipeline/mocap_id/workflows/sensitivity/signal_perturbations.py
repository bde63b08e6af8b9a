"""Perturbations of the signals: angles, wrench, clock offset, and the noise settings of the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.plates import GRAVITY
from mocap_id.store import Table
from mocap_id.workflows.sensitivity.kinds import ALL
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.trial_inputs import LAST, TrialInputs

_HALF_DEPTH_M = 0.119  # distance of the cells of a balance board from its centre, along the motion
STATES, WRENCH = "states.parquet", "wrench.parquet"


def filter_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Set the filter's noise (3.17) instead of estimating it: sigma_v of every joint, and the markers' sd."""
    return trial.with_settings("ukf-smooth", sigma_v=change.level, marker_sd=float(change.target))


def joints_of(trial: TrialInputs, change: Perturbation) -> IntArray:
    """Return the indices of the joints that a perturbation acts on."""
    joints = trial.joints
    return np.arange(len(joints)) if change.target == ALL else np.array([joints.index(change.target)])


def angle_bias(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Add a constant to angles, not to their derivatives."""
    table = trial.table(STATES)
    columns = [f"theta_{j + 1}" for j in joints_of(trial, change)]
    return trial.with_artefacts(table.with_columns(**{name: table[name] + change.level for name in columns}))


def clock_offset(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Delay the plates' samples by the level; the program may estimate the offset."""
    return trial.with_artefacts(_later(trial.table(WRENCH), change.level))


def clock_offset_ignored(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Delay the plates' samples by exactly the level, without clock correction by the program.

    The offset that the program corrected in the unperturbed trial is corrected first.
    """
    found = trial.tree("dynamics.h5").facts["clock_offset_s"]
    applied = getattr(trial.settings[LAST], "apply_clock_offset", False)
    in_force = found if applied and found is not None else 0.0
    return clock_offset(trial, replace(change, level=change.level - in_force)).with_settings(
        LAST, apply_clock_offset=False
    )


def _later(table: Table, delay: float | FloatArray) -> Table:
    """Return wrench.parquet delayed by ``delay`` s; sensors with their own clock do not change."""
    if not np.any(delay):
        return table
    time = table["time"]
    beside = [fact["columns"] for fact in table.facts.get("external") or () if fact["clock"] != "plates"]
    still = {"time", "plate_ok", *(f"{name}_{each}" for name in ("Fx", "Fy", "tauz") for each in beside)}
    moved = {
        name: SampledWrench.of(time, table[name][:, None])(time + delay)[:, 0]
        for name in table.names
        if name not in still
    }
    nearest = np.searchsorted(time, time + delay - (time[1] - time[0]) / 2)
    sound = table["plate_ok"][np.clip(nearest, 0, len(time) - 1)]
    return table.with_columns(**moved, plate_ok=sound & np.isfinite(moved["Fy"]))


def wrench_bias(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Add a constant to a component of the plates' wrench."""
    return _added(trial, change, change.level)


def wrench_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Add white noise, a sample a frame, to a component of the plates' wrench."""
    return _added(trial, change, change.level * change.rng().standard_normal(trial.table(WRENCH).length))


def board_steps(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Add the rounding errors of four cells in the place of a balance board's: to Fy and, by their distance, tauz."""
    error = change.level * (change.rng().random((trial.table(WRENCH).length, 4)) - 0.5) * GRAVITY
    front, back = error[:, :2].sum(axis=1), error[:, 2:].sum(axis=1)
    trial = _added(trial, replace(change, target="Fy"), front + back)
    return _added(trial, replace(change, target="tauz"), _HALF_DEPTH_M * (front - back))


def stamp_jitter(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Take every sample of the plates at a time that is wrong at random, with the level as standard deviation."""
    length = trial.table(WRENCH).length
    return trial.with_artefacts(_later(trial.table(WRENCH), change.level * change.rng().standard_normal(length)))


def _added(trial: TrialInputs, change: Perturbation, error: float | FloatArray) -> TrialInputs:
    """Return the trial with an error in a component, and with the quantities that planarise derives from it."""
    table = trial.table(WRENCH)
    table = table.with_columns(**{change.target: table[change.target] + error})
    facts = dict(table.facts)
    if change.target == "Fy" and facts.get("mass_kg") is not None:
        gravity = getattr(trial.settings[LAST], "gravity")  # noqa: B009  the settings are a stage's own
        facts["mass_kg"] = float(facts["mass_kg"] + np.mean(error) / gravity)
    above = table["Fy"] > facts["cop_threshold_N"]
    cop = np.divide(table["tauz"], table["Fy"], out=np.full(table.length, np.nan), where=above)
    return trial.with_artefacts(replace(table.with_columns(cop_x=cop), facts=facts))
