"""Errors of the geometry that repeat with the movement, and what they do to the parameters.

Skin slides over bone as the joints turn: the same error in every repetition. No resampling of the trial sees it, yet
it is the larger part of the parameters' error (in simulated sit-to-stands residuals alone give intervals that hold
the truth half of the time). So it is modelled: each marker's slide, with what it did to the joint centres and does to
the angles in every posture, is an error mode of its own, and each mode is carried through the least squares. A slide
that misplaces a joint and one that turns a segment are one and the same here; taken as independent they would make
some parameters' deviations too large and others' too small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.base import triangular_factor
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor

_SAMPLES = 300  # of the fit: what repeats with the movement needs no more
_MOMENT = 1.0 / 30.0  # s, over which errors of the posture are differentiated in time
_RATE = 10.0  # Hz; postures a second at which torques are looked at, a movement's own frequencies being below 3 Hz
_STEP = 1e-6  # rad, rad/s …, m, of a numerical derivative


@dataclass(frozen=True)
class KinematicError:
    """What is uncertain of the geometry: independent modes of one standard deviation each.

    Parameters
    ----------
    angle : callable
        From joint angles (T, n), rad, to every mode's errors of them (T, n, S), rad.
    centre : (n, 2, S) array
        Every mode's error of the joint centres in the segment before, m.
    """

    angle: Callable[[FloatArray], FloatArray]
    centre: FloatArray

    @classmethod
    def none(cls, joints: int) -> KinematicError:
        """A geometry that is exact."""
        return cls(lambda q: np.zeros((*q.shape, 0)), np.zeros((joints, 2, 0)))

    def states(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """(T, 3 n, S) errors of angles, velocities, accelerations: the errors of the postures a moment ago, now, soon.

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


def kinematic_response(prepared: Prepared, found: Fit, base: FloatArray, error: KinematicError) -> FloatArray:
    """By how much every mode moves the fit's parameters.

    With q + e in the place of q the wrench of the true parameters changes by its derivatives times the error; least
    squares answers with minus what the columns explain of that.

    Parameters
    ----------
    prepared : Prepared
    found : Fit
    base : (b,) array
        Base parameters.
    error : KinematicError

    Returns
    -------
    (b + k + 1, S) array
        In the order of ``found.covariance``, which its outer product is to be added to.
    """
    if error.centre.shape[-1] == 0:
        return np.zeros((found.design.shape[-1], 0))
    chosen = slice(None, None, max(1, len(found.samples) // _SAMPLES))
    samples, design = found.samples[chosen], found.design[chosen]
    components = list(prepared.settings.components)

    def wrench(states: FloatArray, centres: FloatArray) -> FloatArray:
        return _regressor(prepared, states, centres)[:, components] @ _full(prepared, base)

    effect = _effect(wrench, prepared, samples, error) * found.weights[:, None]  # (R, c, S)
    rows = design.reshape(-1, design.shape[-1])
    factor = triangular_factor(rows)
    half = solve_triangular(factor, rows.T @ effect.reshape(len(rows), -1), trans="T")
    return -np.asarray(solve_triangular(factor, half))


def torque_variance(prepared: Prepared, base: FloatArray, error: KinematicError, response: FloatArray) -> FloatArray:
    """Variance (T, n) of the joint torques from all modes, (N·m)²; NaN where a state is unknown.

    What a mode does to the states and what the parameters answered with belong together: most of it cancels.

    Parameters
    ----------
    prepared : Prepared
    base : (b,) array
    error : KinematicError
    response : (b, S) array
        Of the base parameters to every mode.
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
        return planar_torque_regressor(centres, states[:, : len(centres)], regressor) @ _full(prepared, base)

    steps = known[:: max(1, round(recorded.rate / _RATE))]
    found = np.empty((len(steps), recorded.q.shape[1]))
    for part in np.array_split(np.arange(len(steps)), -(-len(steps) // _SAMPLES)):  # to bound the memory
        own = steps[part]
        rows = planar_torque_regressor(recorded.centres, recorded.q[own], prepared.regressor[own])[:, :, kept]
        found[part] = np.sum((_effect(torques, prepared, own, error) + rows @ response) ** 2, axis=2)
    for joint, column in enumerate(found.T):
        variance[known, joint] = np.interp(recorded.time[known], recorded.time[steps], column)
    return variance


def _effect(
    function: Callable[[FloatArray, FloatArray], FloatArray],
    prepared: Prepared,
    samples: IntArray,
    error: KinematicError,
) -> FloatArray:
    """(R, k, S) changes of a function of states (R, 3 n) and joint centres with every mode."""
    recorded = prepared.recorded
    errors = error.states(recorded.q[samples], recorded.dq[samples], recorded.ddq[samples])
    states = np.concatenate([recorded.q[samples], recorded.dq[samples], recorded.ddq[samples]], axis=1)
    centres = recorded.centres
    undisturbed = function(states, centres)

    units = np.eye(states.shape[1])[:, None]
    moved = function((states + _STEP * units).reshape(-1, states.shape[1]), centres).reshape(-1, *undisturbed.shape)
    by_centres = [function(states, centres + _STEP * unit.reshape(centres.shape)) for unit in np.eye(centres.size)]
    of_states, of_centres = ((np.stack(list(f), axis=-1) - undisturbed[..., None]) / _STEP for f in (moved, by_centres))
    return np.asarray(of_states @ errors + of_centres @ error.centre.reshape(centres.size, errors.shape[-1]))


def _regressor(prepared: Prepared, states: FloatArray, centres: FloatArray) -> FloatArray:
    """(R, 3, 4(n + 1)) of states (R, 3 n)."""
    q, dq, ddq = np.split(states, 3, axis=1)
    return planar_regressor(centres, q, dq, ddq, prepared.settings.gravity)


def _full(prepared: Prepared, base: FloatArray) -> FloatArray:
    """(4(n + 1),) full parameters that the base parameters stand for, zero where a column was regrouped."""
    full = np.zeros(4 * (len(prepared.recorded.centres) + 1))
    full[prepared.base.kept] = base
    return full
