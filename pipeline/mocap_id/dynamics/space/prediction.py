"""Predicted wrench and joint torques of a chain in space, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.lowpass import known
from mocap_id.dynamics.model_error import estimate_model_error
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.identification import SpatialIdentification
from mocap_id.dynamics.space.motion import SpatialMotion, segment_regressor
from mocap_id.dynamics.space.trial import SpatialTrial
from mocap_id.dynamics.uncertainty import variance

_RATE = 10.0  # Hz: rate at which the effect of errors of the instruments on torques is evaluated


@dataclass(frozen=True)
class SpatialPrediction:
    """A model's wrench and joint torques in space.

    Parameters
    ----------
    wrench, wrench_sd : (T, 6) arrays
        Force and moment of the ground about the origin of the trial's frame, N and N·m, with standard deviations.
    measured : (T, 6) array
        The plate's wrench, with the clock offset and the constant errors corrected.
    torque, torque_sd : (T, N) arrays
        Torque of each joint coordinate, N·m.
    """

    wrench: FloatArray
    wrench_sd: FloatArray
    measured: FloatArray
    torque: FloatArray
    torque_sd: FloatArray


def predict(trial: SpatialTrial, found: SpatialIdentification) -> SpatialPrediction:
    """Predict wrench and joint torques at every sample.

    The size of the errors that are not due to the parameters is estimated from the residuals, without the plate's white
    noise. A joint torque is a moment of the wrench on the segments beyond the joint; its error is that of the wrench.

    Parameters
    ----------
    trial : SpatialTrial
    found : SpatialIdentification
    """
    own, back = found.residual_covariance, trial.recorded.to_trial
    bias = np.zeros(6)
    bias[list(trial.constants)] = found.plate_bias
    measured = trial.measured(found.fit.offset) - bias
    local = trial.rows @ found.base
    noise = _wrench_noise(trial, found, measured - local)
    torque_rows = _torque_rows(trial, trial.recorded.motion)
    jacobian = trial.recorded.motion.jacobian
    of_noise = np.einsum("tcj,cd,tdj->tj", jacobian, noise, jacobian, optimize=True)
    of_errors = _of_errors(trial, found)
    rows = back @ trial.rows
    return SpatialPrediction(
        wrench=local @ back.T,
        wrench_sd=np.sqrt(variance(rows, own) + np.diag(back @ noise @ back.T)),
        measured=measured @ back.T,
        torque=torque_rows @ found.base,
        torque_sd=np.sqrt(variance(torque_rows, own) + of_noise + of_errors),
    )


def _torque_rows(trial: SpatialTrial, motion: SpatialMotion) -> FloatArray:
    """Return the rows (T, N, b) of the joint torques."""
    moved = motion.in_frames(trial.structure.frames)
    regressor = segment_regressor(moved, trial.settings.gravity)
    return torque_regressor(moved, regressor)[:, :, trial.base.kept]


def _wrench_noise(trial: SpatialTrial, found: SpatialIdentification, residual: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of the model's errors about the origin of the base."""
    samples = found.fit.in_fit & known(residual)
    errors = [
        estimate_model_error(residual[:, k], np.zeros(len(residual)), samples, trial.recorded.rate) for k in range(6)
    ]
    spread = [np.var(residual[samples, k]) if e is None else e.steady for k, e in enumerate(errors)]
    correlation = np.corrcoef(residual[samples].T)
    return np.asarray(correlation * np.sqrt(np.outer(spread, spread)))


def _of_errors(trial: SpatialTrial, found: SpatialIdentification) -> FloatArray:
    """Return the variance (T, N) of the torques from errors of instruments and centres; in each, effects cancel."""
    recorded = trial.recorded
    valid = np.flatnonzero(known(trial.regressor))
    out = np.full((len(recorded.time), recorded.motion.jacobian.shape[2]), np.nan)
    steps = valid[:: max(1, round(recorded.rate / _RATE))]
    if not len(steps):
        return out
    motion = recorded.motion.at(steps)
    rows = _torque_rows(trial, motion)
    total = np.zeros(rows.shape[:2])
    for mode in found.modes:
        changed = rows @ mode.parameters[: len(found.base)]
        if mode.motion is not None:
            changed = changed + mode.size * ((_torque_rows(trial, mode.motion.at(steps)) - rows) @ found.base)
        total += changed**2
    for j, column in enumerate(total.T):
        out[valid, j] = np.interp(recorded.time[valid], recorded.time[steps], column)
    return out
