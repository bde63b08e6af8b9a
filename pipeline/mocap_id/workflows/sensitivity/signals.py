"""Perturbations of what identify-dim and the filter are given: angles, wrench, clock, and the filter's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.clock import SampledWrench
from mocap_id.store import Table
from mocap_id.workflows.sensitivity.kinds import ALL
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.subject import LAST, Perturbed

STATES, WRENCH = "states.parquet", "wrench.parquet"


def filter_noise(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Give the filter its noise (3.17), rather than estimate it: sigma_v of every joint, and the markers' sd."""
    return trial.set_to("ukf-smooth", sigma_v=change.level, marker_sd=float(change.target))


def joints_of(trial: Perturbed, change: Perturbation) -> IntArray:
    """Numbers of the joints that a perturbation acts on, from 0."""
    joints = trial.joints
    return np.arange(len(joints)) if change.target == ALL else np.array([joints.index(change.target)])


def angle_bias(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Add a constant to angles; their derivatives stay what they are."""
    table = trial.table(STATES)
    columns = [f"theta_{j + 1}" for j in joints_of(trial, change)]
    return trial.having(table.having(**{name: table[name] + change.level for name in columns}))


def clock_offset(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Have the plates' samples taken later by the level than their clock says; the program may find out."""
    return trial.having(_later(trial.table(WRENCH), change.level))


def clock_offset_ignored(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Leave the wrench off by the level, exactly, and keep the program from looking for it.

    The offset that the program took out of the unperturbed trial is taken out beforehand.
    """
    found = trial.tree("dynamics.h5").facts["clock_offset_s"]
    applied = getattr(trial.settings[LAST], "apply_clock_offset", False)
    in_force = found if applied and found is not None else 0.0
    return clock_offset(trial, replace(change, level=change.level - in_force)).set_to(LAST, apply_clock_offset=False)


def _later(table: Table, delay: float) -> Table:
    """wrench.parquet whose row at t holds what stood at t + delay, s; the sensors beside the plates stay."""
    if delay == 0:
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
    return table.having(**moved, plate_ok=sound & np.isfinite(moved["Fy"]))


def wrench_bias(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Add a constant to a component of the plates' wrench."""
    return _added(trial, change, change.level)


def wrench_noise(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Add white noise, a sample a frame, to a component of the plates' wrench."""
    return _added(trial, change, change.level * change.rng().standard_normal(trial.table(WRENCH).length))


def _added(trial: Perturbed, change: Perturbation, error: float | FloatArray) -> Perturbed:
    """The trial with an error in a component, and with all that planarise would have read from it."""
    table = trial.table(WRENCH)
    table = table.having(**{change.target: table[change.target] + error})
    facts = dict(table.facts)
    if change.target == "Fy" and facts.get("mass_kg") is not None:
        gravity = getattr(trial.settings[LAST], "gravity")  # noqa: B009  the settings are a stage's own
        facts["mass_kg"] = float(facts["mass_kg"] + np.mean(error) / gravity)
    above = table["Fy"] > facts["cop_threshold_N"]
    cop = np.divide(table["tauz"], table["Fy"], out=np.full(table.length, np.nan), where=above)
    return trial.having(replace(table.having(cop_x=cop), facts=facts))
