"""What a perturbation did: every parameter's change, and what else of the result moved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.verdict import Level, overall
from mocap_id.workflows.sensitivity.subject import Perturbed

STATE_NAMES = ("theta", "dtheta", "ddtheta")
WRENCH_NAMES = ("Fx", "Fy", "tauz")
_CLOCK = 1e-5  # s: frames of the same time
_NAN = math.nan


@dataclass(frozen=True)
class Parameter:
    """A base parameter or, in a trial without forces too, a segment's length.

    Parameters
    ----------
    name, unit : str
    value, sd : float
        NaN where not known.
    size : float
        What changes are held against: as for the verdict on its standard deviation.
    verdict : str
        ``known``, ``weak`` or ``not identifiable``; empty for a length.
    """

    name: str
    unit: str
    value: float
    sd: float
    size: float
    verdict: str = ""


@dataclass(frozen=True)
class Result:
    """What is known of a trial, perturbed or not.

    Parameters
    ----------
    parameters : mapping of str to Parameter
        By name.
    condition, offset, cop_rms : float
        Condition number, clock offset (s), and rms error of the centre of pressure (m); NaN where not known.
    wrench_r2 : tuple of float
        Of Fx, Fy and tauz.
    samples : int
        Of the fit.
    level : {"ok", "caution", "refused"}
        Of the verdict.
    codes : frozenset of str
        Of the verdict's reasons; notes do not count.
    """

    parameters: Mapping[str, Parameter]
    condition: float
    offset: float
    cop_rms: float
    wrench_r2: tuple[float, ...]
    samples: int
    level: Level
    codes: frozenset[str]


@dataclass(frozen=True)
class Moved:
    """How far the series of a perturbed trial are from those of the unperturbed one, at common times.

    Parameters
    ----------
    state_r2 : (3, n) array
        r² of angle, velocity and acceleration against the unperturbed ones: 1 = the same.
    angle_rms : (n,) array
        rad.
    torque_rms : (n,) array
        N·m.
    torque_size : (n,) array
        rms of the unperturbed torques, N·m.
    """

    state_r2: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))
    angle_rms: FloatArray = field(default_factory=lambda: np.zeros(0))
    torque_rms: FloatArray = field(default_factory=lambda: np.zeros(0))
    torque_size: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def torque_share(self) -> float:
        """Largest change of a joint's torque, rms, as a share of the unperturbed one's; NaN where none is known."""
        known = np.isfinite(self.torque_rms) & (self.torque_size > 0)
        return float(np.max(self.torque_rms[known] / self.torque_size[known])) if known.any() else _NAN


def result(trial: Perturbed) -> Result:
    """What the artefacts of a trial say."""
    facts = trial.tree("dynamics.h5").facts
    wrench: Mapping[str, Any] = facts["wrench"] or {}
    reasons = [reason for artefact in trial.artefacts.values() for reason in artefact.reasons]
    return Result(
        parameters={one.name: one for one in (*_base(trial), *_lengths(trial))},
        condition=_number(facts["condition_number"]),
        offset=_number(facts["clock_offset_s"]),
        cop_rms=_number(facts["cop_rms_m"]),
        wrench_r2=tuple(_number((wrench.get(name) or {}).get("r2")) for name in WRENCH_NAMES),
        samples=int(facts["samples"] or 0),
        level=overall(reasons),
        codes=frozenset(reason.code for reason in reasons if reason.level != "ok"),
    )


def moved(own: Perturbed, changed: Perturbed) -> Moved:
    """How far the perturbed series are off the unperturbed ones."""
    before, now = common(_times(own), _times(changed))
    states = [(own.states(name)[before], changed.states(name)[now]) for name in STATE_NAMES]
    joints = range(1, len(own.joints) + 1)
    torques = [
        trial.table("dynamics.parquet").stack([f"tau_{j}" for j in joints])[rows]
        for trial, rows in ((own, before), (changed, now))
    ]
    return Moved(
        state_r2=np.array([_r2(*pair) for pair in states]),
        angle_rms=_rms(states[0][1] - states[0][0]),
        torque_rms=_rms(torques[1] - torques[0]),
        torque_size=_rms(torques[0]),
    )


def common(own: FloatArray, changed: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows of two rising time columns, s, that are of the same times."""
    nearest = np.clip(np.searchsorted(own, changed - _CLOCK), 0, len(own) - 1)
    same = np.abs(own[nearest] - changed) <= _CLOCK
    return nearest[same], np.flatnonzero(same)


def _times(trial: Perturbed) -> FloatArray:
    return trial.table("states.parquet")["time"]


def _r2(own: FloatArray, changed: FloatArray) -> FloatArray:
    """r² of each column; NaN where one has no sample in common or does not move."""
    both = np.isfinite(own) & np.isfinite(changed)
    counted = np.maximum(both.sum(axis=0), 1)
    mean = np.where(both, own, 0.0).sum(axis=0) / counted
    total = np.where(both, (own - mean) ** 2, 0.0).sum(axis=0)
    off = np.where(both, (changed - own) ** 2, 0.0).sum(axis=0)
    return np.where(total > 0, 1.0 - off / np.where(total > 0, total, 1.0), np.nan)


def _rms(off: FloatArray) -> FloatArray:
    """Of each column, where it is known; NaN where it is nowhere."""
    known = np.isfinite(off)
    squares = np.where(known, off**2, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), np.sqrt(squares / np.maximum(known.sum(axis=0), 1)), np.nan)


def _base(trial: Perturbed) -> list[Parameter]:
    at = {name: trial.node("dynamics.h5", "base", name) for name in ("name", "unit", "value", "sd", "verdict")}
    relative = trial.node("dynamics.h5", "base", "relative_sd").astype(np.float64)
    rows = zip(at["name"], at["unit"], at["value"], at["sd"], relative, at["verdict"], strict=True)
    return [
        Parameter(str(name), str(unit), float(value), float(sd), _size(value, sd, share), str(verdict))
        for name, unit, value, sd, share, verdict in rows
    ]


def _size(value: float, sd: float, relative: float) -> float:
    """Size of a parameter: what its standard deviation was held against."""
    return float(sd / relative) if relative > 0 and math.isfinite(sd) else abs(float(value))


def _lengths(trial: Perturbed) -> list[Parameter]:
    """Lengths of the segments that have one."""
    names, length, sd = (trial.node("chain.h5", "segments", name) for name in ("name", "length", "length_sd"))
    return [
        Parameter(f"length of {name}", "m", float(value), float(spread), float(value))
        for name, value, spread in zip(names[1:], length, sd, strict=False)  # the last segment has none
        if math.isfinite(value)
    ]


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else _NAN


def ratio(parameter: Parameter, changed: Parameter | None, tolerance: float) -> float:
    """Change of a parameter over what is tolerated: a share of its size, or its standard deviation if that is more.

    NaN where the unperturbed parameter is not known; infinite where the perturbed one is not.
    """
    if not math.isfinite(parameter.value):
        return _NAN
    if changed is None or not math.isfinite(changed.value):
        return math.inf
    allowed = max(tolerance * parameter.size, parameter.sd if math.isfinite(parameter.sd) else 0.0)
    change = abs(changed.value - parameter.value)
    return change / allowed if allowed > 0 else (math.inf if change > 0 else 0.0)


def worst(own: Result, changed: Result | None, names: Sequence[str], tolerance: float) -> tuple[float, str]:
    """The largest ratio among some parameters, and whose it is; (NaN, "") where none is known."""
    found = [(ratio(own.parameters[n], changed.parameters.get(n) if changed else None, tolerance), n) for n in names]
    known = [pair for pair in found if not math.isnan(pair[0])]
    return max(known, key=lambda pair: pair[0]) if known else (_NAN, "")
