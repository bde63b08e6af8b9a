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
from mocap_id.dynamics.regressor import planar_regressor

_SAMPLES = 600  # of the fit: what repeats with the movement needs no more
_MOMENT = 1.0 / 30.0  # s, over which errors of the posture are differentiated in time
_STEP = 1e-5  # rad, rad/s … of a numerical derivative


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
        before, now, after = (self.angle(q + side * _MOMENT * dq + side**2 * bend) for side in (-1, 0, 1))
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
    chosen = slice(None, None, max(1, len(found.samples) // _SAMPLES))
    samples, design = found.samples[chosen], found.design[chosen]
    columns = design.shape[-1]
    slopes = _slopes(prepared, samples, base) * found.weights[:, None]
    recorded = prepared.recorded
    states = error.states(recorded.q[samples], recorded.dq[samples], recorded.ddq[samples])
    geometry = error.centre.reshape(recorded.centres.size, states.shape[-1])
    effect = slopes[..., : states.shape[1]] @ states + slopes[..., states.shape[1] :] @ geometry  # (R, c, S)
    rows = design.reshape(-1, columns)
    factor = triangular_factor(rows)
    half = solve_triangular(factor, rows.T @ effect.reshape(len(rows), -1), trans="T")
    return -np.asarray(solve_triangular(factor, half))


def _slopes(prepared: Prepared, samples: IntArray, base: FloatArray) -> FloatArray:
    """(R, c, 5 n) derivatives of the fitted components by angles, velocities, accelerations and joint centres."""
    recorded, components = prepared.recorded, list(prepared.settings.components)
    states = np.concatenate([recorded.q[samples], recorded.dq[samples], recorded.ddq[samples]], axis=1)
    joints, centres = recorded.q.shape[1], recorded.centres

    def wrench(states: FloatArray, centres: FloatArray) -> FloatArray:
        q, dq, ddq = np.split(states, 3, axis=1)
        rows = planar_regressor(centres, q, dq, ddq, prepared.settings.gravity)
        return np.asarray((rows[:, components] @ _spread(prepared, base))[..., None])

    slopes = []
    for k in range(3 * joints):
        step = _STEP * (np.arange(3 * joints) == k)
        slopes.append((wrench(states + step, centres) - wrench(states - step, centres)) / (2 * _STEP))
    for k in range(2 * joints):
        moved = _STEP * (np.arange(2 * joints) == k).reshape(joints, 2)
        slopes.append((wrench(states, centres + moved) - wrench(states, centres - moved)) / (2 * _STEP))
    return np.concatenate(slopes, axis=-1)


def _spread(prepared: Prepared, base: FloatArray) -> FloatArray:
    """(4(n + 1),) full parameters that the base parameters stand for, zero where a column was regrouped."""
    full = np.zeros(4 * (len(prepared.recorded.centres) + 1))
    full[prepared.base.kept] = base
    return full
