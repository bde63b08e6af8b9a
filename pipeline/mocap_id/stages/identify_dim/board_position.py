"""Place of a balance board along the motion, found with the model of the body."""

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
from mocap_id.stages.identify_dim.reference_bodies import reference_bodies
from mocap_id.stages.identify_dim.trial_data import read_kinematic_error
from mocap_id.verdict import Reason

_TAUZ = 2
_INERTIA = 3  # number of Izz among a segment's parameters
_ROUNDS = 2  # the first leaves an error of the response, which depends on the clock offset and the weights
_FOOT_SD = 0.001  # m: first moment of the feet divided by the body's mass, as for single-marker segments
_REPEATED_SD = 0.0025  # m: errors of the joints that are the same in every repetition, from simulated trials
_GIVEN_SD, _FEET_SD = 0.005, 0.03  # m: place from the configuration, and under the feet
_CLEARLY = 3.0  # a board of the right direction fits this much better than the opposite one; simulated ones 2 to 200
_FITTED = 0.9  # r² of tauz; simulated boards of the right direction have 0.98 or more, of the opposite one 0.6 or less
_OPPOSITE = {"forwards": "backwards", "backwards": "forwards", "left": "right", "right": "left"}


@dataclass(frozen=True)
class _Shift:
    """Shift of the board along the motion that fits the model best, its standard deviation, m, and the misfit."""

    value: float
    sd: float
    misfit: float


def settle_board(
    context: Context, prepared: PreparedTrial, movement: Movement
) -> tuple[PreparedTrial, dict[str, Any] | None]:
    """Move the board to where the model needs it, and return the fact ``board`` of dynamics.h5.

    A board that stands e away from its stated place measures a moment that is e·Fy too large.

    Parameters
    ----------
    context : Context
    prepared : PreparedTrial
        With the board under the feet, or where the configuration says.
    movement : Movement

    Returns
    -------
    PreparedTrial
        With the moment about the plane's origin, and the standard deviation of the place; unchanged without a board.
    dict or None
    """
    board = context.table("wrench.parquet").facts.get("board")
    if board is None:
        return prepared, None
    found = _shift(context, prepared, movement)
    mirrored = None if found is None else _shift(context, _with_moment(prepared, -1.0), movement)
    worse = None if found is None or mirrored is None else mirrored.misfit / found.misfit
    if board["centre_given"] or found is None:
        sd, by = (_GIVEN_SD, "configuration") if board["centre_given"] else (_FEET_SD, "feet")
        return _with_moment(prepared, sd=sd), {"shift_m": 0.0, "sd_m": sd, "by": by, "mirrored_misfit": worse}
    total = 0.0
    for _ in range(_ROUNDS):
        total, prepared = total + found.value, _with_moment(prepared, shift=found.value, sd=found.sd)
        found = _shift(context, prepared, movement) or found
    return prepared, {"shift_m": total, "sd_m": found.sd, "by": "model", "mirrored_misfit": worse}


def board_reasons(context: Context, facts: dict[str, Any]) -> tuple[Reason, ...]:
    """Return cautions about the board's direction and place, from the facts of dynamics.h5."""
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
                f"the balance board's top is taken to point {board['top']}, seen by the person, but this is not sure: "
                f"if it points {_OPPOSITE[board['top']]}, tauz and all parameters are wrong. Say where it points, or "
                "check what you said: `top:` beside `balance_board:`",
                value=worse,
                limit=_CLEARLY,
            )
        )
    if fact["by"] == "feet":
        reasons.append(
            Reason(
                "board-place-unknown",
                "the balance board's place along the motion is known to about 3 cm only, from the feet: the first "
                "moment of the base segment, the centre of pressure and the torques contain this error. Give "
                "`centre_m:` beside `balance_board:`",
                value=fact["sd_m"],
            )
        )
    return tuple(reasons)


def _with_moment(
    prepared: PreparedTrial, sign: float = 1.0, *, shift: float = 0.0, sd: float | None = None
) -> PreparedTrial:
    """Return the trial with another moment: ``sign`` times the measured one, for a board that is shifted."""
    wrench = prepared.recorded.wrench.copy()
    wrench[:, _TAUZ] = sign * wrench[:, _TAUZ] + shift * wrench[:, 1]
    return prepare(replace(prepared.recorded, wrench=wrench, position_sd=sd), prepared.settings)


def _shift(context: Context, prepared: PreparedTrial, movement: Movement) -> _Shift | None:
    """Return the board's shift along the motion that explains the first moments best; None if they do not show it.

    The fit, the shift and the reference body are combined by their covariances. The data determine trunk and thigh,
    whose angles change most; the reference determines the foot and the shank, whose first moments along the motion are
    small. Moments of inertia are left out: a person's accelerations hardly show those of single segments.
    """
    reference = reference_bodies(context, prepared.recorded, movement).chosen.parameters
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
    response, spread = _response(prepared, found)[used], spread[np.ix_(used, used)]
    away = (values - base @ reference)[used]
    precision = float(response @ np.linalg.solve(spread, response))
    excess = float(response @ np.linalg.solve(spread, away)) / precision
    rest = away - excess * response
    misfit = float(rest @ np.linalg.solve(spread, rest)) / max(len(used) - 1, 1)
    return _Shift(-excess, float(np.sqrt(_REPEATED_SD**2 + max(misfit, 1.0) / precision)), misfit)


def _response(prepared: PreparedTrial, found: Fit) -> FloatArray:
    """Return the change of the fitted base parameters (b,) for each metre that the board is away from its place."""
    row = prepared.settings.components.index(_TAUZ)
    stamped = prepared.recorded.time[found.samples] - found.offset
    moment = np.zeros((*found.target.shape, 1))
    moment[:, row, 0] = prepared.filtered_measured(found.samples, stamped)[:, 1] * found.weights[row]
    return found.response(moment)[: found.base, 0]
