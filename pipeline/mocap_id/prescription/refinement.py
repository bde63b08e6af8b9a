"""Local refinement of a spring near the global optimum: the thesis's optimisation (eq. 7.10), corrected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import Bounds, minimize

from mocap_id.arrays import FloatArray
from mocap_id.prescription.one_joint import OneJoint

_MARGIN = 1e-7  # share of the weight: larger than the solver's violation of its constraints


def refine_spring(  # noqa: PLR0917
    joint: OneJoint,
    start: tuple[float, float, float, float],
    required: Sequence[float],
    rest: tuple[float, float],
    stiffest: float,
    penalty: float,
) -> tuple[float, float]:
    """Return stiffness, N·m/rad, and rest angle, rad, with the widest range, by sequential quadratic programming.

    The torques at both ends, at the turning points between them (eq. 7.9) and at required angles (eq. 7.11) are
    constrained to the person's limits. The number of turning points stays as at the start. The result is the start if
    the solver fails, so the caller must check whether the range is wider.

    Parameters
    ----------
    joint : OneJoint
    start : (low, high, stiffness, rest)
        Held range, rad, stiffness, N·m/rad, and rest angle, rad, of the spring to refine.
    required : sequence of float
        Required angles, rad.
    rest : (low, high)
        Allowed rest angles, rad.
    stiffest : float
        Largest stiffness, N·m/rad.
    penalty : float
        Penalty per stiffness over the weight, rad.
    """
    low, high, stiffness, at = start
    weight = joint.weight
    first = np.array([low, high, stiffness / weight, stiffness * at / weight])
    bounds = Bounds(
        np.array([joint.lower, joint.lower, 0.0, -np.inf]),
        np.array([joint.upper, joint.upper, stiffest / weight, np.inf]),
    )
    constraint: Any = {"type": "ineq", "fun": _constraint_margins(joint, start, required, rest)}
    options: Any = {"ftol": 1e-12, "maxiter": 100}

    def cost(x: FloatArray) -> float:
        return float(x[0] - x[1] + penalty * x[2])

    result = minimize(cost, first, method="SLSQP", bounds=bounds, constraints=constraint, options=options)
    if not np.isfinite(result.x).all() or result.x[2] <= 0:
        return stiffness, at
    return float(result.x[2] * weight), float(np.clip(result.x[3] / result.x[2], *rest))


def _constraint_margins(
    joint: OneJoint, start: tuple[float, float, float, float], required: Sequence[float], rest: tuple[float, float]
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of both ends, stiffness / weight and shift / weight that gives the margins to each limit."""
    low, high, stiffness, _ = start
    weight, phase = joint.weight, float(np.arctan2(joint.cosine, joint.sine))
    inside = joint.turning_points(stiffness)
    inside = inside[(inside > low) & (inside < high)]
    half = np.arccos(np.clip(-stiffness / weight, -1, 1))
    sign = np.sign(np.sin(inside + phase))
    base = inside + phase - sign * half  # multiples of a full rotation
    least, most = joint.torque_low / weight + _MARGIN, joint.torque_high / weight - _MARGIN

    def torques(x: FloatArray) -> FloatArray:
        turning = base - phase + sign * np.arccos(np.clip(-x[2], -1, 1))
        angles = np.concatenate([x[:2], turning, required])
        return np.asarray(np.sin(angles + phase) + x[2] * angles - x[3])

    def margins(x: FloatArray) -> FloatArray:
        value = torques(x)
        return np.concatenate([value - least, most - value, [x[3] - x[2] * rest[0], x[2] * rest[1] - x[3]]])

    return margins
