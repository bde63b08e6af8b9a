"""Whether two trials support carrying a body from one to the other, by what is known without the other's forces.

Errors against the other trial's forces say afterwards whether a prediction was good. Whether it may be believed must be
known before, or a table of people serves as well. Three things speak against it: the model does not predict its own
trial's repetitions better than the table does; what it says of the other movement differs from what the table says by
less than it is uncertain; the two trials place a joint of the same person differently.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.carry import Registration, carry, carry_covariance
from mocap_id.dynamics.pressure import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.uncertainty import variance
from mocap_id.verdict import Reason
from mocap_id.workflows.finished import Finished
from mocap_id.workflows.moving_bodies import MovingBodies

SERIES = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
"""What is compared, with units."""
AT_HOME = ("Fy", "tauz", "cop_x")
"""What the model must predict better than the table on its own trial."""
TOLD_APART = ("tauz", "cop_x")
"""Where it must differ from the table; in Fy it differs by the mass, which any plate shows."""
_TIMES = 2.0  # standard deviations that the carried body's prediction is from the table's, at least
_JOINTS = 0.03  # m: joints that bend enough lie within a few millimetres, with skin within two centimetres
_ELSEWHERE = 1.4  # times the error at home: measured on twenty pairs of real trials
_NORMAL = 1.96  # standard deviations that hold 95 % of a normal distribution
_INSIDE = 0.8  # of the samples: with fewer in the 95 % intervals, these are too narrow


@dataclass(frozen=True)
class Carried:
    """A body of one trial on the bodies of another.

    Parameters
    ----------
    bodies : MovingBodies
        K bodies of the other trial, and their motion.
    registration : Registration
        Of the model's bodies in these.
    parameters : (4K,) array
    covariance : (4K, 4K) array
        Of these; NaN where unknown.
    """

    bodies: MovingBodies
    registration: Registration
    parameters: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, source: Finished, bodies: MovingBodies, registration: Registration) -> Carried:
        """The source's model on bodies that its own were registered to."""
        parameters = carry(source.parameters, registration)
        return cls(bodies, registration, parameters, carry_covariance(source.covariance, registration))


@dataclass(frozen=True)
class Support:
    """What speaks for a transfer before the other trial's forces are looked at.

    Parameters
    ----------
    apart : mapping
        rms difference of the carried body's prediction from the table's over the trial's states, N, N·m or m; of each
        of :data:`AT_HOME`.
    sd : mapping
        rms standard deviation of the carried body's prediction, from the covariance of its parameters.
    at_home : mapping
        Error on left-out repetitions of the model's own trial over the table's there; NaN where unknown.
    """

    apart: Mapping[str, float]
    sd: Mapping[str, float]
    at_home: Mapping[str, float]


def support(source: Finished, target: Finished, carried: Carried) -> Support | None:
    """Compare a carried body with the table's by the states of the other trial; its forces take no part.

    Parameters
    ----------
    source, target : Finished
    carried : Carried
        The source's body in the target.

    Returns
    -------
    Support or None
        None where there is no table's body to compare it with.
    """
    if not (np.isfinite(target.reference).all() and np.isfinite(source.covariance).all()):
        return None
    table = predicted(target, target.bodies, target.reference)
    apart = predicted(target, carried.bodies, carried.parameters) - table
    sd = _parameters_sd(target, carried)
    told, spread = (
        {name: _rms(each[:, k]) for k, name in enumerate(SERIES) if name in AT_HOME} for each in (apart, sd)
    )
    return Support(told, spread, _at_home(source.facts.get("held_out")))


def stated_sd(source: Finished, target: Finished, carried: Carried) -> FloatArray:
    """Standard deviation (T, 4) that is stated for the carried body's prediction of :data:`SERIES`, N, N·m, m.

    The variance that the parameters' covariance gives, and the mean square error at home on repetitions that were left
    out (of the fit, where none could be), times 1.4 for another movement.
    """
    residual = _residual(source.facts, banded=target.measured is not None)
    return np.asarray(_ELSEWHERE * np.hypot(_parameters_sd(target, carried), residual))


def inside(ours: FloatArray, measured: FloatArray, sd: FloatArray, samples: BoolArray) -> dict[str, float]:
    """Share of the samples whose measurement is inside the stated 95 % intervals, of each of :data:`SERIES`.

    Parameters
    ----------
    ours, measured, sd : (T, 4) arrays
    samples : (T,) bool array

    Returns
    -------
    dict of str to float
        NaN where nothing is known.
    """
    times = np.abs(ours - measured)[samples] / sd[samples]
    known = np.isfinite(times)
    count = known.sum(axis=0)
    share = np.sum(known & (np.nan_to_num(times) <= _NORMAL), axis=0) / np.where(count, count, np.nan)
    return dict(zip(SERIES, share.tolist(), strict=True))


def worse_than_stated(shares: Mapping[str, float]) -> Iterator[Reason]:
    """The reason to doubt the stated intervals, where they hold too few samples."""
    few = {name: share for name, share in shares.items() if share < _INSIDE}
    if few:
        told = ", ".join(f"{name} ({100 * share:.0f} % of the samples)" for name, share in few.items())
        yield Reason(
            "transfer-worse-than-stated",
            f"the errors of the carried body exceed what is stated: its 95 % intervals hold the measured {told}",
            value=min(few.values()),
            limit=_INSIDE,
        )


def series(target: Finished, ground: FloatArray) -> FloatArray:
    """(T, 4) of :data:`SERIES` for a wrench (T, 3) of the ground, in the band in which the trial is compared."""
    banded = np.column_stack([target.in_band(component) for component in ground.T])
    return np.column_stack([banded, centre_of_pressure(banded, target.cop_threshold)])


def predicted(target: Finished, bodies: MovingBodies, parameters: FloatArray) -> FloatArray:
    """(T, 4) of :data:`SERIES` that bodies (4K,) of a trial call for, less what others than the ground do."""
    columns = [f"{name}_external" for name in WRENCH_COMPONENTS]
    external = target.dynamics[columns].to_numpy(dtype=np.float64) if columns[0] in target.dynamics else 0.0
    return series(target, bodies.regressor @ parameters - external)


def _parameters_sd(target: Finished, carried: Carried) -> FloatArray:
    """(T, 4) standard deviation of the prediction from the covariance of the parameters."""
    rows = target.in_band(carried.bodies.regressor)
    pressure = centre_of_pressure_rows(rows, rows @ carried.parameters, target.cop_threshold)
    each = np.concatenate([rows, pressure[:, None]], axis=1)
    return np.sqrt(variance(each, carried.covariance))


def doubts(found: Support | None, registration: Registration, joints: Sequence[str]) -> Iterator[Reason]:
    """Reasons not to carry the body over.

    Parameters
    ----------
    found : Support or None
    registration : Registration
    joints : sequence of str
        What each joint lies between, for messages.
    """
    if found is not None:
        yield from _no_better_at_home(found)
        yield from _not_told_apart(found)
    apart = np.nan_to_num(registration.joint)
    if len(apart) and apart.max() > _JOINTS:
        worst = int(apart.argmax())
        yield Reason(
            "transfer-joints",
            f"the two trials place the joint {joints[worst]} {1e3 * registration.joint[worst]:.0f} mm apart among the "
            "same markers: one of them does not bend it enough, or its markers slid",
            value=float(registration.joint[worst]),
            limit=_JOINTS,
        )


def _no_better_at_home(found: Support) -> Iterator[Reason]:
    worse = {name: ratio for name, ratio in found.at_home.items() if ratio > 1.0}
    if worse:
        told = ", ".join(f"{name} ({ratio:.2f} times its error)" for name, ratio in worse.items())
        yield Reason(
            "transfer-not-at-home",
            f"on its own trial, repetitions left out, the model predicts no better than the table's body in {told}: of "
            "that there is nothing individual to carry over",
            value=max(worse.values()),
            limit=1.0,
        )


def _not_told_apart(found: Support) -> Iterator[Reason]:
    times = {name: found.apart[name] / found.sd[name] for name in TOLD_APART}
    near = {name: ratio for name, ratio in times.items() if not ratio >= _TIMES}
    if near:
        told = ", ".join(f"{name} ({ratio:.1f} standard deviations)" for name, ratio in near.items())
        yield Reason(
            "transfer-not-told-apart",
            f"on this movement the carried body's prediction cannot be told from the table's in {told}; at least "
            f"{_TIMES:g} are asked for. The model's trial knows too little of what this movement needs",
            value=min(near.values()),
            limit=_TIMES,
        )


def _residual(facts: Mapping[str, Any], banded: bool) -> FloatArray:
    """(4,) rms error of a model at home: on repetitions that were left out, or over the fit where none could be."""
    held_out = facts.get("held_out") or {}
    errors = (None if banded else held_out.get("unfiltered")) or held_out.get("model")
    if errors is None:
        cop = facts.get("cop_rms_m")
        errors = {**(facts.get("wrench") or {}), "cop_x": None if cop is None else {"bias": 0.0, "sd": cop}}
    return np.array([_error(errors, name) for name in SERIES])


def _at_home(held_out: Mapping[str, Any] | None) -> dict[str, float]:
    model, table = ((held_out or {}).get(body) for body in ("model", "reference"))
    return {name: _error(model, name) / _error(table, name) for name in AT_HOME}


def _error(errors: Mapping[str, Any] | None, name: str) -> float:
    """rms of one error of the facts; NaN where unknown."""
    one = None if errors is None else errors.get(name)
    return float("nan") if one is None else float(np.hypot(one["bias"], one["sd"]))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
