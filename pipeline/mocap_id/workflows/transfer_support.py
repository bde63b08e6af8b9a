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

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.carry import Registration, carry, carry_covariance
from mocap_id.dynamics.pressure import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.uncertainty import variance
from mocap_id.verdict import Reason
from mocap_id.workflows.finished import Finished

AT_HOME = ("Fy", "tauz", "cop_x")
"""What the model must predict better than the table on its own trial."""
TOLD_APART = ("tauz", "cop_x")
"""Where it must differ from the table; in Fy it differs by the mass, which any plate shows."""
_TIMES = 2.0  # standard deviations that the carried body's prediction is from the table's, at least
_JOINTS = 0.03  # m: joints that bend enough lie within a few millimetres, with skin within two centimetres


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


def support(source: Finished, target: Finished, registration: Registration) -> Support | None:
    """Hold a carried body against the table's by the states of the other trial; its forces take no part.

    Parameters
    ----------
    source, target : Finished
    registration : Registration
        From the source's segments to the target's.

    Returns
    -------
    Support or None
        None where there is no table's body to hold it against.
    """
    if not (np.isfinite(target.reference).all() and np.isfinite(source.covariance).all()):
        return None
    regressor, threshold = target.regressor(), target.cop_threshold
    wrench, table = regressor @ carry(source.parameters, registration), regressor @ target.reference
    covariance = carry_covariance(source.covariance, registration)
    rows = centre_of_pressure_rows(regressor, wrench, threshold)
    pressure = centre_of_pressure(wrench, threshold) - centre_of_pressure(table, threshold)
    apart = dict(zip(AT_HOME, map(_rms, (*(wrench - table).T[1:], pressure)), strict=True))
    spread = (*np.sqrt(variance(regressor, covariance)).T[1:], np.sqrt(variance(rows, covariance)))
    return Support(apart, dict(zip(AT_HOME, map(_rms, spread), strict=True)), _at_home(source.facts.get("held_out")))


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
    worst = int(np.nanargmax(registration.joint))
    if registration.joint[worst] > _JOINTS:
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


def _at_home(held_out: Mapping[str, Any] | None) -> dict[str, float]:
    def error(body: str, name: str) -> float:
        of_body = (held_out or {}).get(body)
        one = None if of_body is None else of_body[name]
        return float("nan") if one is None else float(np.hypot(one["bias"], one["sd"]))

    return {name: error("model", name) / error("reference", name) for name in AT_HOME}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
