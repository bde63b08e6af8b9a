"""The response to a perturbation: changes of the parameters, of the other results, and of the time series."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.store.views import joint_columns
from mocap_id.verdict import Level, overall
from mocap_id.workflows.sensitivity.kinds import COMPONENTS
from mocap_id.workflows.sensitivity.trial_inputs import TrialInputs
from mocap_id.workflows.trial_outcome import number_or_nan

STATE_NAMES = ("theta", "dtheta", "ddtheta")
_SAME_TIME = 1e-5  # s: frames with a smaller difference have the same time


@dataclass(frozen=True)
class Parameter:
    """A base parameter, or the length of a segment."""

    name: str
    unit: str
    value: float  # NaN if unknown
    sd: float  # standard deviation; NaN if unknown
    size: float  # value by which changes are divided; the verdict on the standard deviation uses the same value
    verdict: str = ""  # ``known``, ``weak`` or ``not identifiable``; empty for a length


@dataclass(frozen=True)
class Estimates:
    """The estimates of a perturbed or unperturbed trial; a number is NaN if unknown."""

    parameters: Mapping[str, Parameter]  # by name
    condition: float  # condition number
    offset: float  # clock offset, s
    cop_rms: float  # rms error of the centre of pressure, m
    wrench_r2: tuple[float, ...]  # r² of Fx, Fy and tauz
    samples: int  # number of samples of the fit
    level: Level  # level of the verdict
    codes: frozenset[str]  # codes of the verdict's reasons, without notes


@dataclass(frozen=True)
class SeriesChanges:
    """Changes of the time series of n joints between the unperturbed and the perturbed trial, at common times."""

    # (3, n) r² of angle, velocity and acceleration relative to the unperturbed series; 1 = no change
    state_r2: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    angle_rms: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) rad
    torque_rms: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) N·m
    torque_size: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) rms of the unperturbed torques, N·m

    @property
    def torque_share(self) -> float:
        """Largest rms change of a joint torque, divided by the rms of the unperturbed torque; NaN if unknown."""
        known = np.isfinite(self.torque_rms) & (self.torque_size > 0)
        return float(np.max(self.torque_rms[known] / self.torque_size[known])) if known.any() else math.nan


def read_estimates(trial: TrialInputs) -> Estimates:
    """Return the estimates in a trial's artefacts."""
    facts = trial.tree("dynamics.h5").facts
    wrench: Mapping[str, Any] = facts["wrench"] or {}
    reasons = [reason for artefact in trial.artefacts.values() for reason in artefact.reasons]
    return Estimates(
        parameters={one.name: one for one in (*_read_base(trial), *_read_lengths(trial))},
        condition=number_or_nan(facts["condition_number"]),
        offset=number_or_nan(facts["clock_offset_s"]),
        cop_rms=number_or_nan(facts["cop_rms_m"]),
        wrench_r2=tuple(number_or_nan((wrench.get(name) or {}).get("r2")) for name in COMPONENTS),
        samples=int(facts["samples"] or 0),
        level=overall(reasons),
        codes=frozenset(reason.code for reason in reasons if reason.level != "ok"),
    )


def _read_base(trial: TrialInputs) -> list[Parameter]:
    tree = trial.tree("dynamics.h5")
    names = ("name", "unit", "value", "sd", "relative_sd", "verdict")
    rows = zip(*(tree.array(f"base/{name}") for name in names), strict=True)
    return [
        Parameter(str(name), str(unit), float(value), float(sd), _find_size(value, sd, float(share)), str(verdict))
        for name, unit, value, sd, share, verdict in rows
    ]


def _find_size(value: float, sd: float, relative: float) -> float:
    """Return the size of a parameter: its ``sd`` divided by its ``relative`` sd, or else its absolute value."""
    return float(sd / relative) if relative > 0 and math.isfinite(sd) else abs(float(value))


def _read_lengths(trial: TrialInputs) -> list[Parameter]:
    """Return the known segment lengths."""
    names, length, sd = (trial.tree("chain.h5").array(f"segments/{name}") for name in ("name", "length", "length_sd"))
    return [
        Parameter(f"length of {name}", "m", float(value), float(spread), float(value))
        for name, value, spread in zip(names[1:], length, sd, strict=False)  # the last segment has no length
        if math.isfinite(value)
    ]


def compare_series(own: TrialInputs, changed: TrialInputs) -> SeriesChanges:
    """Return the changes of the perturbed series relative to the unperturbed series."""
    before, now = _find_common_rows(own.time, changed.time)
    states = [(own.states(name)[before], changed.states(name)[now]) for name in STATE_NAMES]
    torques = [
        joint_columns(trial.table("dynamics.parquet"), "tau", len(own.joints))[rows]
        for trial, rows in ((own, before), (changed, now))
    ]
    return SeriesChanges(
        state_r2=np.array([_r2(*pair) for pair in states]),
        angle_rms=_rms(states[0][1] - states[0][0]),
        torque_rms=_rms(torques[1] - torques[0]),
        torque_size=_rms(torques[0]),
    )


def _find_common_rows(own: FloatArray, changed: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the rows (m,) of two increasing time columns, s, at which their m common times occur."""
    nearest = np.clip(np.searchsorted(own, changed - _SAME_TIME), 0, len(own) - 1)
    same = np.abs(own[nearest] - changed) <= _SAME_TIME
    return nearest[same], np.flatnonzero(same)


def _r2(own: FloatArray, changed: FloatArray) -> FloatArray:
    """Return r² of each column; NaN for a column that is constant or has no common samples."""
    both = np.isfinite(own) & np.isfinite(changed)
    counted = np.maximum(both.sum(axis=0), 1)
    mean = np.where(both, own, 0.0).sum(axis=0) / counted
    total = np.where(both, (own - mean) ** 2, 0.0).sum(axis=0)
    residual = np.where(both, (changed - own) ** 2, 0.0).sum(axis=0)
    return np.where(total > 0, 1.0 - residual / np.where(total > 0, total, 1.0), np.nan)


def _rms(values: FloatArray) -> FloatArray:
    """Return the root mean square of the known samples of each column; NaN for a column without known samples."""
    known = np.isfinite(values)
    squares = np.where(known, values**2, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), np.sqrt(squares / np.maximum(known.sum(axis=0), 1)), np.nan)


def tolerance_ratio(parameter: Parameter, changed: Parameter | None, tolerance: float) -> float:
    """Return the change of a parameter divided by the tolerated change.

    The tolerated change is ``tolerance`` times the parameter's size, or the standard deviation if that is larger. The
    ratio is NaN if the unperturbed parameter is unknown, and infinite if only the perturbed parameter is unknown.
    """
    if not math.isfinite(parameter.value):
        return math.nan
    if changed is None or not math.isfinite(changed.value):
        return math.inf
    allowed = max(tolerance * parameter.size, parameter.sd if math.isfinite(parameter.sd) else 0.0)
    change = abs(changed.value - parameter.value)
    return change / allowed if allowed > 0 else (math.inf if change > 0 else 0.0)


def largest_ratio(
    own: Estimates, changed: Estimates | None, names: Sequence[str], tolerance: float
) -> tuple[float, str]:
    """Return the largest tolerance ratio of the named parameters, and its parameter; (NaN, "") if none is known."""
    after = {} if changed is None else changed.parameters
    ratios = [(tolerance_ratio(own.parameters[name], after.get(name), tolerance), name) for name in names]
    known = [pair for pair in ratios if not math.isnan(pair[0])]
    return max(known, key=lambda pair: pair[0]) if known else (math.nan, "")
