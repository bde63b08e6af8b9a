"""Errors of the geometry that repeat with the movement, and their effect on the parameters.

Skin slides over bone as the joints turn, with the same error in every repetition. Resampling the trial does not show
this error, yet it is the largest part of the parameters' error: in simulated sit-to-stands, intervals from the
residuals alone contain the truth only half of the time. It is therefore modelled. The slide of each marker is an error
mode, with its effect on the joint centres and on the angles in every posture, and each mode is propagated through the
least squares. One slide displaces a joint and turns a segment at the same time; as independent errors, the two would
make some deviations too large and others too small. See docs/concepts/sliding-skin.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray, IntArray, chunks
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor

_SAMPLES = 300  # number of the fit's samples used: enough for errors that repeat with the movement
_AT_ONCE = 300  # samples whose effect is computed at a time, to bound the memory
_MOMENT = 1.0 / 30.0  # s: time step for derivatives of the posture's errors
_RATE = 10.0  # Hz: rate at which torques are evaluated; a movement's frequencies are below 3 Hz
_STEP = 1e-6  # rad, rad/s …, m: step of numerical derivatives


@dataclass(frozen=True)
class KinematicError:
    """Uncertainty of the geometry as S independent modes of one standard deviation each.

    Parameters
    ----------
    angle : callable
        From joint angles (T, n), rad, to their errors in every mode (T, n, S), rad.
    centre : (n, 2, S) array
        Error of the joint centres in every mode, in the frame of the segment before the joint, m.
    """

    angle: Callable[[FloatArray], FloatArray]
    centre: FloatArray

    @classmethod
    def none(cls, joints: int) -> KinematicError:
        """Return the error of an exact geometry."""
        return cls(lambda q: np.zeros((*q.shape, 0)), np.zeros((joints, 2, 0)))

    def states(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return errors (T, 3 n, S) of angles, velocities and accelerations, by differences over three postures.

        Parameters
        ----------
        q, dq, ddq : (T, n) arrays
            rad and time derivatives.
        """
        bend = _MOMENT**2 / 2 * ddq
        moments = np.concatenate([q + side * _MOMENT * dq + side**2 * bend for side in (-1, 0, 1)])
        before, now, after = np.split(self.angle(moments), 3)
        velocity, acceleration = (after - before) / (2 * _MOMENT), (after - 2 * now + before) / _MOMENT**2
        return np.concatenate([now, velocity, acceleration], axis=1)


def kinematic_response(prepared: PreparedTrial, found: Fit, base: FloatArray, error: KinematicError) -> FloatArray:
    """Return the change of the fitted parameters with every mode.

    If q has the error e, the modelled wrench changes by its derivatives times e. The least-squares parameters change by
    minus the part of this that the columns explain.

    Parameters
    ----------
    prepared : PreparedTrial
    found : Fit
    base : (b,) array
        Base parameters.
    error : KinematicError

    Returns
    -------
    (b + k + 1, S) array
        In the order of ``found.covariance``, to which its outer product is added.
    """
    if error.centre.shape[-1] == 0:
        return np.zeros((found.design.shape[-1], 0))
    chosen = slice(None, None, max(1, len(found.samples) // _SAMPLES))
    samples, design = found.samples[chosen], found.design[chosen]
    components = list(prepared.settings.components)
    effect = wrench_effect(prepared, base, error, samples)[:, components] * found.weights[:, None]  # (R, c, S)
    return -replace(found, design=design, prior=None).response(effect)


def wrench_effect(prepared: PreparedTrial, base: FloatArray, error: KinematicError, samples: IntArray) -> FloatArray:
    """Return the change (R, 3, S) of the modelled wrench with every mode at some samples (R,), N and N·m."""
    if error.centre.shape[-1] == 0:
        return np.zeros((len(samples), 3, 0))
    full = _full(prepared, base)

    def wrench(states: FloatArray, centres: FloatArray) -> FloatArray:
        return np.asarray(_regressor(prepared, states, centres) @ full)

    return np.concatenate([_effect(wrench, prepared, samples[s], error) for s in chunks(len(samples), _AT_ONCE)])


def torque_variance(
    prepared: PreparedTrial, base: FloatArray, error: KinematicError, response: FloatArray
) -> FloatArray:
    """Return the variance (T, n) of the joint torques from all modes, (N·m)²; NaN where a state is unknown.

    In each mode, the errors of the states and of the parameters are correlated; their effects largely cancel.

    Parameters
    ----------
    prepared : PreparedTrial
    base : (b,) array
    error : KinematicError
    response : (b, S) array
        Change of the base parameters with every mode.
    """
    recorded, kept = prepared.recorded, prepared.base.kept
    known = np.flatnonzero(np.isfinite(prepared.regressor).all(axis=(1, 2)))
    variance = np.full(recorded.q.shape, np.nan)
    if error.centre.shape[-1] == 0:
        variance[known] = 0.0
        return variance
    if not len(known):
        return variance

    def torques(states: FloatArray, centres: FloatArray) -> FloatArray:
        regressor = _regressor(prepared, states, centres)
        return planar_torque_regressor(centres, states[:, : recorded.q.shape[1]], regressor) @ _full(prepared, base)

    steps = known[:: max(1, round(recorded.rate / _RATE))]
    found = np.empty((len(steps), recorded.q.shape[1]))
    for part in chunks(len(steps), _AT_ONCE):
        own = steps[part]
        rows = planar_torque_regressor(recorded.centres, recorded.q[own], prepared.regressor[own])[:, :, kept]
        found[part] = np.sum((_effect(torques, prepared, own, error) + rows @ response) ** 2, axis=2)
    for joint, column in enumerate(found.T):
        variance[known, joint] = np.interp(recorded.time[known], recorded.time[steps], column)
    return variance


def _effect(
    function: Callable[[FloatArray, FloatArray], FloatArray],
    prepared: PreparedTrial,
    samples: IntArray,
    error: KinematicError,
) -> FloatArray:
    """Return the changes (R, k, S) of a function with every mode.

    The function takes states (R, 3 n) and joint centres (n, 2), or (R, n, 2) for centres of their own in every row.
    """
    recorded, centres = prepared.recorded, prepared.recorded.centres
    errors = error.states(recorded.q[samples], recorded.dq[samples], recorded.ddq[samples])
    states = np.concatenate([recorded.q[samples], recorded.dq[samples], recorded.ddq[samples]], axis=1)
    count = states.shape[1]
    steps = _STEP * np.eye(1 + count + centres.size, count + centres.size, k=-1)[:, None]  # the first row moves nothing
    moved = states + steps[..., :count]
    places = np.broadcast_to(
        centres + steps[..., count:].reshape(-1, 1, *centres.shape), (*moved.shape[:2], *centres.shape)
    )
    values = function(moved.reshape(-1, count), places.reshape(-1, *centres.shape)).reshape(*moved.shape[:2], -1)
    slopes = np.stack([*(values[1:] - values[0]) / _STEP], axis=-1)
    of_centres = slopes[..., count:] @ error.centre.reshape(centres.size, errors.shape[-1])
    return np.asarray(slopes[..., :count] @ errors + of_centres)


def _regressor(prepared: PreparedTrial, states: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the full regressor (R, 3, 4(n + 1)) of states (R, 3 n)."""
    q, dq, ddq = np.split(states, 3, axis=1)
    return planar_regressor(centres, q, dq, ddq, prepared.settings.gravity)


def _full(prepared: PreparedTrial, base: FloatArray) -> FloatArray:
    """Return the full parameters (4(n + 1),) with the base parameters in the kept columns and zeros elsewhere."""
    full = np.zeros(4 * (len(prepared.recorded.centres) + 1))
    full[prepared.base.kept] = base
    return full
