"""Errors of the geometry that recur with the movement, and their effect on the parameters.

Skin slides over bone as the joints rotate, with the same error in every repetition. Resampling the trial does not
reveal this error, although it is the largest part of the parameters' error. It is therefore modelled: the slide of each
marker is an error mode, which changes the joint centres and the angles in every posture. The effect of each mode on the
least-squares solution is computed. See docs/concepts/sliding-skin.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, chunks, find_complete_rows
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.lowpass import interpolate_samples
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor

_SAMPLES = 300  # number of samples used: sufficient for errors that recur with the movement
_AT_ONCE = 300  # number of samples whose effect is computed at a time, to limit the memory
_MOMENT = 1.0 / 30.0  # s: time step for the derivatives of the angles' errors
_RATE = 10.0  # Hz: rate at which torques are evaluated; a movement's frequencies are below 3 Hz
_STEP = 1e-6  # rad, rad/s …, m: step of numerical derivatives


@dataclass(frozen=True)
class KinematicError:
    """Uncertainty of the geometry as S independent modes of one standard deviation each."""

    # function from joint angles (T, n), rad, to their errors in every mode (T, n, S), rad
    angle: Callable[[FloatArray], FloatArray]
    # (n, 2, S) error of the joint centres in every mode, in the frame of the segment before the joint, m
    centre: FloatArray

    @classmethod
    def none(cls, joints: int) -> KinematicError:
        """Return the uncertainty of an exact geometry, which has no modes (S = 0)."""
        return cls(lambda q: np.zeros((*q.shape, 0)), np.zeros((joints, 2, 0)))

    def states(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the errors (T, 3 n, S) of angles, velocities and accelerations, from differences of three postures."""
        bend = _MOMENT**2 / 2 * ddq
        moments = np.concatenate([q + side * _MOMENT * dq + side**2 * bend for side in (-1, 0, 1)])
        before, now, after = np.split(self.angle(moments), 3)
        velocity, acceleration = (after - before) / (2 * _MOMENT), (after - 2 * now + before) / _MOMENT**2
        return np.concatenate([now, velocity, acceleration], axis=1)


def propagate_to_parameters(
    prepared: PreparedTrial, result: Fit, base: FloatArray, error: KinematicError
) -> FloatArray:
    """Return the change (b + k + 1, S) of the fitted parameters with every mode, in the order of ``result.covariance``.

    If q has the error e, the modelled wrench changes by its derivatives times e. The parameters change by minus the
    least-squares solution for this change of the wrench.
    """
    if error.centre.shape[-1] == 0:
        return np.zeros((result.design.shape[-1], 0))
    chosen = slice(None, None, max(1, len(result.samples) // _SAMPLES))
    samples, design = result.samples[chosen], result.design[chosen]
    components = list(prepared.settings.components)
    effect = propagate_to_wrench(prepared, base, error, samples)[:, components] * result.weights[:, None]  # (R, c, S)
    return -replace(result, design=design, prior=None).response(effect)


def propagate_to_wrench(
    prepared: PreparedTrial, base: FloatArray, error: KinematicError, samples: IntArray
) -> FloatArray:
    """Return the change (R, 3, S) of the modelled wrench with every mode, for sample indices (R,), N and N·m."""
    if error.centre.shape[-1] == 0:
        return np.zeros((len(samples), 3, 0))
    full = prepared.base.expand(base)

    def wrench(states: FloatArray, centres: FloatArray) -> FloatArray:
        return np.asarray(_build_regressor(prepared, states, centres) @ full)

    return np.concatenate(
        [_propagate_modes(wrench, prepared, samples[s], error) for s in chunks(len(samples), _AT_ONCE)]
    )


def propagate_to_torques(
    prepared: PreparedTrial, base: FloatArray, error: KinematicError, response: FloatArray
) -> FloatArray:
    """Return the variance (T, n) of the joint torques from all modes, (N·m)²; NaN where a state is missing.

    In each mode, the errors of the states and of the parameters are correlated, and their effects largely cancel.
    ``response`` (b, S) is the change of the base parameters with every mode.
    """
    recorded, kept = prepared.recorded, prepared.base.kept
    valid = np.flatnonzero(find_complete_rows(prepared.regressor))
    if error.centre.shape[-1] == 0 or not len(valid):
        variance = np.full(recorded.q.shape, np.nan)
        variance[valid] = 0.0
        return variance

    def torques(states: FloatArray, centres: FloatArray) -> FloatArray:
        regressor = _build_regressor(prepared, states, centres)
        return planar_torque_regressor(centres, states[:, : recorded.q.shape[1]], regressor) @ prepared.base.expand(
            base
        )

    steps = valid[:: max(1, round(recorded.rate / _RATE))]
    variance = np.empty((len(steps), recorded.q.shape[1]))
    for part in chunks(len(steps), _AT_ONCE):
        own = steps[part]
        rows = planar_torque_regressor(recorded.centres, recorded.q[own], prepared.regressor[own])[:, :, kept]
        variance[part] = np.sum((_propagate_modes(torques, prepared, own, error) + rows @ response) ** 2, axis=2)
    return interpolate_samples(recorded.time, valid, steps, variance)


def _propagate_modes(
    function: Callable[[FloatArray, FloatArray], FloatArray],
    prepared: PreparedTrial,
    samples: IntArray,
    error: KinematicError,
) -> FloatArray:
    """Return the changes (R, m, S) of the m values of a function with every mode, for sample indices (R,).

    Arguments of the function are states (R, 3 n) and joint centres (n, 2), or (R, n, 2) for different centres in every
    row.
    """
    recorded, centres = prepared.recorded, prepared.recorded.centres
    errors = error.states(recorded.q[samples], recorded.dq[samples], recorded.ddq[samples])
    states = np.concatenate([recorded.q[samples], recorded.dq[samples], recorded.ddq[samples]], axis=1)
    count = states.shape[1]
    steps = _STEP * np.eye(1 + count + centres.size, count + centres.size, k=-1)[:, None]  # the first row is zero
    moved = states + steps[..., :count]
    places = np.broadcast_to(
        centres + steps[..., count:].reshape(-1, 1, *centres.shape), (*moved.shape[:2], *centres.shape)
    )
    values = function(moved.reshape(-1, count), places.reshape(-1, *centres.shape)).reshape(*moved.shape[:2], -1)
    slopes = np.stack([*(values[1:] - values[0]) / _STEP], axis=-1)
    of_centres = slopes[..., count:] @ error.centre.reshape(centres.size, errors.shape[-1])
    return np.asarray(slopes[..., :count] @ errors + of_centres)


def _build_regressor(prepared: PreparedTrial, states: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the full regressor (R, 3, 4(n + 1)) of states (R, 3 n)."""
    q, dq, ddq = np.split(states, 3, axis=1)
    return planar_regressor(centres, q, dq, ddq, prepared.settings.gravity)
