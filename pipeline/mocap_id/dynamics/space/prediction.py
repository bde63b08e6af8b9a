"""Predicted wrench and joint torques of a chain in space, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, find_complete_rows
from mocap_id.dynamics.lowpass import interpolate_samples
from mocap_id.dynamics.model_error import ModelError, estimate_model_error
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.identification import SpatialIdentification
from mocap_id.dynamics.space.motion import SpatialMotion, move_segments, segment_regressor
from mocap_id.dynamics.space.preparation import SpatialTrial
from mocap_id.dynamics.uncertainty import variance

_RATE = 10.0  # Hz: rate at which the effect of errors of the instruments on torques is evaluated


@dataclass(frozen=True)
class SpatialPrediction:
    """A model's wrench and joint torques in space."""

    # wrench, wrench_sd: (T, 6) force and moment of the ground about the origin of the trial's frame, N and N·m, with
    # standard deviations
    wrench: FloatArray
    wrench_sd: FloatArray
    # (T, 6) the plate's wrench, with the clock offset and the constant errors corrected, N and N·m
    measured: FloatArray
    # torque, torque_sd: (T, N) torque of each joint coordinate and its standard deviation, N·m
    torque: FloatArray
    torque_sd: FloatArray


def predict(trial: SpatialTrial, result: SpatialIdentification) -> SpatialPrediction:
    """Predict wrench and joint torques at every sample."""
    own, back = result.residual_covariance, trial.recorded.to_trial
    bias = np.zeros(6)
    bias[list(trial.constants)] = result.plate_bias
    measured = trial.measured(result.fit.offset) - bias
    local = trial.rows @ result.base
    torque_rows = _compute_torque_rows(trial, trial.recorded.motion)
    of_wrench, of_torque = _estimate_noise(trial, result, measured - local, torque_rows)
    rows = back @ trial.rows
    return SpatialPrediction(
        wrench=local @ back.T,
        wrench_sd=np.sqrt(variance(rows, own) + np.einsum("ij,tj->ti", back**2, of_wrench)),
        measured=measured @ back.T,
        torque=torque_rows @ result.base,
        torque_sd=np.sqrt(variance(torque_rows, own) + of_torque + _propagate_errors(trial, result)),
    )


def _compute_torque_rows(trial: SpatialTrial, motion: SpatialMotion) -> FloatArray:
    """Return the rows (T, N, b) of the joint torques."""
    moved = motion.in_frames(trial.structure.frames)
    regressor = segment_regressor(moved, trial.settings.gravity)
    return torque_regressor(moved, regressor)[:, :, trial.base.kept]


def _estimate_noise(
    trial: SpatialTrial, result: SpatialIdentification, residual: FloatArray, torque_rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the variances of the wrench (T, 6) and of the torques (T, N) due to errors of the accelerations.

    As in the plane, the standard deviations of the accelerations give the course of the variances over time, and the
    plate gives their size (:mod:`mocap_id.dynamics.model_error`). The variances of the torques are scaled like those of
    the moments.
    """
    wrench, torque = _propagate_accelerations(trial, result.base, torque_rows)
    samples = result.fit.in_fit & find_complete_rows(residual)
    estimates = (estimate_model_error(residual[:, k], wrench[:, k], samples, trial.recorded.rate) for k in range(6))
    errors = [each or ModelError(0.0, 1.0, 1.0) for each in estimates]
    size = np.nanmean(wrench[:, 3:], axis=0)
    overall = float(np.average([each.overall for each in errors[3:]], weights=np.maximum(size, 1e-300)))
    scaled = wrench * [each.scale for each in errors] + [each.steady for each in errors]
    return np.asarray(scaled), np.asarray(overall * torque)


def _propagate_accelerations(
    trial: SpatialTrial, base: FloatArray, torque_rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the variances of wrench (T, 6) and torques (T, N) due to the standard deviations of the accelerations.

    The wrench is linear in the accelerations, so a change of each acceleration by 1 rad/s² gives the derivative.
    """
    recorded = trial.recorded
    motion, gravity = recorded.motion, trial.settings.gravity
    wrench, torque = np.zeros((len(recorded.time), 6)), np.zeros(torque_rows.shape[:2])
    for j, beyond in enumerate(motion.beyond):
        alpha = recorded.alpha + beyond[1:, None] * motion.axis[:, j, None]
        moved = move_segments(recorded.chain, recorded.centred, recorded.rotation, recorded.omega, alpha)
        spread = recorded.alpha_sd[:, int(np.argmax(beyond)) - 1, None] ** 2
        wrench += spread * ((trial.build_rows(moved, gravity) - trial.rows) @ base) ** 2
        torque += spread * ((_compute_torque_rows(trial, moved) - torque_rows) @ base) ** 2
    return wrench, torque


def _propagate_errors(trial: SpatialTrial, result: SpatialIdentification) -> FloatArray:
    """Return the variance (T, N) of the torques due to errors of instruments and joint centres.

    The effects of an error through the parameters and through the motion are correlated and largely cancel.
    """
    recorded = trial.recorded
    valid = np.flatnonzero(find_complete_rows(trial.regressor))
    steps = valid[:: max(1, round(recorded.rate / _RATE))]
    if not len(steps):
        return np.full((len(recorded.time), recorded.motion.jacobian.shape[2]), np.nan)
    motion = recorded.motion.at(steps)
    rows = _compute_torque_rows(trial, motion)
    total = np.zeros(rows.shape[:2])
    for mode in result.modes:
        changed = rows @ mode.parameters[: len(result.base)]
        if mode.motion is not None:
            changed = changed + mode.size * ((_compute_torque_rows(trial, mode.motion.at(steps)) - rows) @ result.base)
        total += changed**2
    return interpolate_samples(recorded.time, valid, steps, total)
