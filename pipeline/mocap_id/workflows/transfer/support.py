"""Evidence that a body may be transferred from one trial to another, without the forces of the other trial.

The errors relative to the other trial's forces show only afterwards whether a prediction was good, but a prediction is
useful only if this is known before. There are three reasons against a transfer. The model does not predict repetitions
of its own trial better than the allometric body; its prediction of the other movement differs too little from that of
the allometric body; or a joint of the same person has different positions in the two trials.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.dynamics.comparison import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.parameter_transfer import Registration, transfer_covariance, transfer_parameters
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.uncertainty import variance
from mocap_id.verdict import Reason
from mocap_id.workflows.identified_trial import IdentifiedTrial
from mocap_id.workflows.moving_bodies import MovingBodies

SERIES = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
"""Units of the compared series by name."""
AT_HOME = ("Fy", "tauz", "cop_x")
"""Series that the model must predict better than the allometric body, on its own trial."""
_DISTINCT = ("tauz", "cop_x")
"""Series in which the model must differ from the allometric body; Fy differs mainly by the mass, known from a plate."""
_TIMES = 2.0  # least difference from the allometric body's prediction, in standard deviations
_JOINTS = 0.03  # m: positions of joints that bend enough agree within a few mm, with skin motion within two cm
_ELSEWHERE = 1.4  # error on another movement divided by the error on the own trial, from twenty pairs of real trials
_INSIDE = 0.8  # least fraction of the samples in the 95 % intervals


@dataclass(frozen=True)
class TransferredBody:
    """The identified body of one trial, transferred to the bodies of another trial."""

    bodies: MovingBodies  # K bodies of the other trial with their motion
    registration: Registration  # pose of the model's bodies in these K bodies
    parameters: FloatArray  # (4K,)
    covariance: FloatArray  # (4K, 4K) covariance of the parameters; NaN if unknown

    @classmethod
    def of(cls, source: IdentifiedTrial, bodies: MovingBodies, registration: Registration) -> TransferredBody:
        """Return the model of the source, transferred to ``bodies`` with the registration of its own bodies."""
        parameters = transfer_parameters(source.parameters, registration)
        return cls(bodies, registration, parameters, transfer_covariance(source.covariance, registration))


@dataclass(frozen=True)
class Support:
    """Evidence for a transfer that does not use the forces of the other trial."""

    # difference between the predictions of transferred and allometric body for each of :data:`AT_HOME`, rms over the
    # other trial's states, N, N·m or m
    apart: Mapping[str, float]
    # standard deviation of the transferred body's prediction from the covariance of its parameters, rms
    sd: Mapping[str, float]
    # error on left-out repetitions of the model's own trial, divided by the allometric body's error; NaN if unknown
    at_home: Mapping[str, float]


def find_support(source: IdentifiedTrial, target: IdentifiedTrial, transferred: TransferredBody) -> Support | None:
    """Return the comparison of the transferred and the allometric body on the target's states, without the forces.

    None if there is no allometric body to compare with, or if the covariance of the model is unknown.
    """
    if not (np.isfinite(target.reference).all() and np.isfinite(source.covariance).all()):
        return None
    table = predict(target, target.bodies, target.reference)
    difference = predict(target, transferred.bodies, transferred.parameters) - table
    apart, sd = (
        {name: root_mean_square(series[:, k]) for k, name in enumerate(SERIES) if name in AT_HOME}
        for series in (difference, _find_parameters_sd(target, transferred))
    )
    return Support(apart, sd, _compare_at_home(source.facts.get("held_out")))


def stated_sd(source: IdentifiedTrial, target: IdentifiedTrial, transferred: TransferredBody) -> FloatArray:
    """Return the stated standard deviations (T, 4) of the predicted :data:`SERIES`, N, N·m and m.

    They combine the covariance of the parameters with the rms error on left-out repetitions of the model's trial (or of
    the fit if no repetition could be left out). The factor 1.4 accounts for the different movement.
    """
    residual = _read_residual(source.facts, banded=target.measured is not None)
    return np.asarray(_ELSEWHERE * np.hypot(_find_parameters_sd(target, transferred), residual))


def share_inside(model: FloatArray, measured: FloatArray, sd: FloatArray, samples: BoolArray) -> dict[str, float]:
    """Return the fraction of samples whose measurement is within the stated 95 % interval, for each of :data:`SERIES`.

    The fraction is NaN if no sample is known.

    Parameters
    ----------
    model, measured, sd : (T, 4) arrays
        Prediction, measurement, and stated standard deviation of the prediction.
    samples : (T,) bool array
        Samples that are counted.
    """
    times = np.abs(model - measured)[samples] / sd[samples]
    known = np.isfinite(times)
    count = known.sum(axis=0)
    share = np.sum(known & (np.nan_to_num(times) <= NORMAL_95), axis=0) / np.where(count, count, np.nan)
    return dict(zip(SERIES, share.tolist(), strict=True))


def warn_if_worse_than_stated(shares: Mapping[str, float]) -> Iterator[Reason]:
    """Yield a reason if the stated intervals contain too few samples; ``shares`` is from :func:`share_inside`."""
    few = {name: share for name, share in shares.items() if share < _INSIDE}
    if few:
        listed = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in few.items())
        yield Reason(
            "transfer-worse-than-stated",
            f"the transferred body is less accurate than stated: its 95 % intervals contain too few samples of "
            f"{listed}",
            value=min(few.values()),
            limit=_INSIDE,
        )


def make_series(target: IdentifiedTrial, ground: FloatArray) -> FloatArray:
    """Return :data:`SERIES` (T, 4) from a ground wrench (T, 3), in the frequency band of :meth:`in_band`."""
    banded = np.column_stack([target.in_band(component) for component in ground.T])
    return np.column_stack([banded, centre_of_pressure(banded, target.cop_threshold)])


def predict(target: IdentifiedTrial, bodies: MovingBodies, parameters: FloatArray) -> FloatArray:
    """Return the :data:`SERIES` (T, 4) that K bodies with ``parameters`` (4K,) predict for the ground alone.

    The wrench of chair and sensors is subtracted.
    """
    columns = [f"{name}_external" for name in WRENCH_COMPONENTS]
    external = target.dynamics[columns].to_numpy(dtype=np.float64) if columns[0] in target.dynamics else 0.0
    return make_series(target, bodies.regressor @ parameters - external)


def _find_parameters_sd(target: IdentifiedTrial, transferred: TransferredBody) -> FloatArray:
    """Return the standard deviations (T, 4) of the prediction that follow from the covariance of the parameters."""
    rows = target.in_band(transferred.bodies.regressor)
    pressure = centre_of_pressure_rows(rows, rows @ transferred.parameters, target.cop_threshold)
    rows = np.concatenate([rows, pressure[:, None]], axis=1)
    return np.sqrt(variance(rows, transferred.covariance))


def list_doubts(support: Support | None, registration: Registration, joints: Sequence[str]) -> Iterator[Reason]:
    """Yield the reasons against the transfer of a body that do not use the target's forces.

    Parameters
    ----------
    support : Support or None
    registration : Registration
    joints : sequence of str
        Descriptions of the joints for messages.
    """
    if support is not None:
        yield from _check_home(support)
        yield from _check_difference(support)
    distances = np.nan_to_num(registration.joint)
    if len(distances) and distances.max() > _JOINTS:
        worst = int(distances.argmax())
        yield Reason(
            "transfer-joints",
            f"the positions of the joint {joints[worst]} in the two trials differ by "
            f"{1e3 * registration.joint[worst]:.0f} mm relative to the same markers: in one trial, the joint does not "
            "bend enough or the markers moved on the skin",
            value=float(registration.joint[worst]),
            limit=_JOINTS,
        )


def _check_home(support: Support) -> Iterator[Reason]:
    """Yield a reason if the model predicts its own trial no better than the allometric body."""
    worse = {name: ratio for name, ratio in support.at_home.items() if ratio > 1.0}
    if worse:
        listed = ", ".join(f"{name} (error ratio {ratio:.2f})" for name, ratio in worse.items())
        yield Reason(
            "transfer-not-at-home",
            f"on left-out repetitions of its own trial, the model predicts no better than the allometric body in "
            f"{listed}: there is no individual information to transfer",
            value=max(worse.values()),
            limit=1.0,
        )


def _check_difference(support: Support) -> Iterator[Reason]:
    """Yield a reason if the predictions of transferred and allometric body do not differ enough."""
    times = {name: support.apart[name] / support.sd[name] for name in _DISTINCT}
    near = {name: ratio for name, ratio in times.items() if not ratio >= _TIMES}
    if near:
        listed = ", ".join(f"{name} ({ratio:.1f} standard deviations)" for name, ratio in near.items())
        yield Reason(
            "transfer-not-told-apart",
            "on this movement the prediction of the transferred body does not differ enough from the prediction of the "
            f"allometric body in {listed}; at least {_TIMES:g} are needed. The model's trial determines too little for "
            "this movement",
            value=min(near.values()),
            limit=_TIMES,
        )


def _read_residual(facts: Mapping[str, Any], banded: bool) -> FloatArray:
    """Return the rms errors (4,) of a model on left-out repetitions of its trial, or else of the fit.

    Unless ``banded``, the errors on left-out repetitions are those of the unfiltered series, if known.
    """
    held_out = facts.get("held_out") or {}
    errors = (None if banded else held_out.get("unfiltered")) or held_out.get("model")
    if errors is None:
        cop = facts.get("cop_rms_m")
        errors = {**(facts.get("wrench") or {}), "cop_x": None if cop is None else {"bias": 0.0, "sd": cop}}
    return np.array([_read_error(errors, name) for name in SERIES])


def _compare_at_home(held_out: Mapping[str, Any] | None) -> dict[str, float]:
    model, table = ((held_out or {}).get(body) for body in ("model", "reference"))
    return {name: _read_error(model, name) / _read_error(table, name) for name in AT_HOME}


def _read_error(errors: Mapping[str, Any] | None, name: str) -> float:
    """Return the root mean square of an error in the facts; NaN if unknown."""
    one = None if errors is None else errors.get(name)
    return float("nan") if one is None else float(np.hypot(one["bias"], one["sd"]))


def root_mean_square(values: FloatArray) -> float:
    """Return the root mean square of the finite values; NaN if there are none."""
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
