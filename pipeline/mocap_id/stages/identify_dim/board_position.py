"""Position of a balance board along the motion, estimated with the model of the body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.kinematic_error import propagate_to_parameters
from mocap_id.dynamics.preparation import PreparedTrial, prepare
from mocap_id.dynamics.reference_prior import compute_foot_sd, compute_reference_sd
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.reference_bodies import build_reference_bodies
from mocap_id.stages.identify_dim.trial_data import read_kinematic_error
from mocap_id.verdict import Reason

_TAUZ = 2
_INERTIA = 3  # index of Izz among the four parameters of a segment
_ROUNDS = 2  # the response depends on the clock offset and the weights, so the shift is estimated twice
_FOOT_SD = 0.001  # m: standard deviation of the foot's first moment divided by the body's mass
_REPEATED_SD = 0.0025  # m: joint errors that are the same in all repetitions, from simulated trials
_GIVEN_SD, _FEET_SD = 0.005, 0.03  # m: standard deviation of a position from the configuration, and from the feet
_CLEARLY = 3.0  # smallest ratio of misfits of opposite and assumed direction for certainty; 2 to 200 simulated
_FITTED = 0.9  # smallest r² of tauz; in simulations at least 0.98 for the right direction, at most 0.6 for the opposite
_OPPOSITE = {"forwards": "backwards", "backwards": "forwards", "left": "right", "right": "left"}


@dataclass(frozen=True)
class _Shift:
    """Shift of the board along the motion for which the model fits best and its standard deviation, m.

    ``misfit`` is the remaining sum of squares divided by the degrees of freedom.
    """

    value: float
    sd: float
    misfit: float


def locate_board(
    context: Context, prepared: PreparedTrial, movement: Movement
) -> tuple[PreparedTrial, dict[str, Any] | None]:
    """Return the trial with the board at its estimated position, and the fact ``board`` of dynamics.h5.

    If the board is e away from its assumed position (from the configuration, or under the feet), the moment is e·Fy too
    large. Without a board, the trial is unchanged and the fact is None.
    """
    board = context.table("wrench.parquet").facts.get("board")
    if board is None:
        return prepared, None
    shift = _estimate_shift(context, prepared, movement)
    mirrored = None if shift is None else _estimate_shift(context, _change_moment(prepared, -1.0), movement)
    worse = None if shift is None or mirrored is None else mirrored.misfit / shift.misfit
    if board["centre_given"] or shift is None:
        sd, by = (_GIVEN_SD, "configuration") if board["centre_given"] else (_FEET_SD, "feet")
        return _change_moment(prepared, sd=sd), {"shift_m": 0.0, "sd_m": sd, "by": by, "mirrored_misfit": worse}
    total = 0.0
    for _ in range(_ROUNDS):
        total, prepared = total + shift.value, _change_moment(prepared, shift=shift.value, sd=shift.sd)
        shift = _estimate_shift(context, prepared, movement) or shift
    return prepared, {"shift_m": total, "sd_m": shift.sd, "by": "model", "mirrored_misfit": worse}


def explain_board(context: Context, facts: dict[str, Any]) -> tuple[Reason, ...]:
    """Return cautions about the board's direction and position, from the facts of dynamics.h5."""
    fact = facts.get("board")
    if fact is None:
        return ()
    board, reasons = context.table("wrench.parquet").facts["board"], []
    worse, fitted = fact["mirrored_misfit"], facts["wrench"]["tauz"]
    poor = fitted is None or fitted["r2"] < _FITTED
    if worse < 1.0 or (worse < _CLEARLY and poor) if worse is not None else not board["top_sure"]:
        reasons.append(
            Reason(
                "board-direction-unsure",
                f"the top of the balance board is assumed to point {board['top']}, as seen by the person, but this is "
                f"not certain: if it points {_OPPOSITE[board['top']]}, tauz and all parameters are wrong. Give or "
                "check `top:` beside `balance_board:`",
                value=worse,
                limit=_CLEARLY,
            )
        )
    if fact["by"] == "feet":
        reasons.append(
            Reason(
                "board-place-unknown",
                "the position of the balance board along the motion is known only to about 3 cm, from the feet: the "
                "first moment of the base segment, the centre of pressure and the torques contain this error. Give "
                "`centre_m:` beside `balance_board:`",
                value=fact["sd_m"],
            )
        )
    return tuple(reasons)


def _change_moment(
    prepared: PreparedTrial, sign: float = 1.0, *, shift: float = 0.0, sd: float | None = None
) -> PreparedTrial:
    """Return the trial as if its board were rotated by 180° (``sign`` -1) or shifted by ``shift`` ± ``sd``, m."""
    wrench = prepared.recorded.wrench.copy()
    wrench[:, _TAUZ] = sign * wrench[:, _TAUZ] + shift * wrench[:, 1]
    return prepare(replace(prepared.recorded, wrench=wrench, position_sd=sd), prepared.settings)


def _estimate_shift(context: Context, prepared: PreparedTrial, movement: Movement) -> _Shift | None:
    """Return the board's shift for which the fitted first moments agree best with the reference body; None if unknown.

    Fit and reference body are weighted by their covariances. The data determine trunk and thigh, whose angles change
    most; the reference body determines foot and shank, whose first moments along the motion are small. Moments of
    inertia are left out, because a person's accelerations hardly determine them for single segments.
    """
    reference = build_reference_bodies(context, prepared.recorded, movement).chosen.parameters
    if _TAUZ not in prepared.settings.components or not np.isfinite(reference).all():
        return None
    found, base = fit(prepared, movement.free), prepared.base.regrouping
    values, relative = found.problem.free_solution()[: found.base], context.settings.reference_sd
    deviations = compute_reference_sd(reference, relative)
    deviations[:2] = compute_foot_sd(reference, _FOOT_SD * float(reference[::4].sum()), relative)[:2]
    skin = propagate_to_parameters(prepared, found, values, read_kinematic_error(context))[: found.base]
    spread = base @ np.diag(deviations**2) @ base.T + found.covariance[: found.base, : found.base] + skin @ skin.T
    kept = np.asarray(prepared.base.kept)
    spread[kept == 1, kept == 1] += (prepared.settings.plate_zero[1] / prepared.settings.gravity) ** 2
    used = np.flatnonzero(kept % 4 != _INERTIA)
    response, spread = _compute_response(prepared, found)[used], spread[np.ix_(used, used)]
    away = (values - base @ reference)[used]
    precision = float(response @ np.linalg.solve(spread, response))
    excess = float(response @ np.linalg.solve(spread, away)) / precision
    rest = away - excess * response
    misfit = float(rest @ np.linalg.solve(spread, rest)) / max(len(used) - 1, 1)
    return _Shift(-excess, float(np.sqrt(_REPEATED_SD**2 + max(misfit, 1.0) / precision)), misfit)


def _compute_response(prepared: PreparedTrial, found: Fit) -> FloatArray:
    """Return the change of the fitted base parameters (b,) for a board that is one metre away from its position."""
    row = prepared.settings.components.index(_TAUZ)
    stamped = prepared.recorded.time[found.samples] - found.offset
    moment = np.zeros((*found.target.shape, 1))
    moment[:, row, 0] = prepared.filtered_measured(found.samples, stamped)[:, 1] * found.weights[row]
    return found.response(moment)[: found.base, 0]
