"""Errors of the geometry that repeat with the movement, and what they do to the parameters.

Skin slides over bone as the joints turn: the same error in every repetition. No resampling of the trial sees it, yet
it is the larger part of the parameters' error (in simulated sit-to-stands residuals alone give intervals that hold
the truth half of the time). So it is modelled: each marker's residual in the joint fit counts as a smooth function of
posture, its effect on the angles follows from the chain, and with the covariance of the joint centres it is
propagated through the least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.geometry import planar

_CURVED = 0.5  # rms of the part that is quadratic in a joint angle, of the linear one
_POSTURES = 50


@dataclass(frozen=True)
class KinematicError:
    """What is uncertain of the geometry.

    Parameters
    ----------
    angle : (n, n) array
        Covariance of the joint angles' errors that vary with posture, rad².
    centre : (n, 2, 2) array
        Covariance of each joint centre in the segment before, m².
    """

    angle: FloatArray
    centre: FloatArray


def from_markers(
    q: FloatArray,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    *,
    residual: FloatArray,
    centre_covariance: FloatArray,
) -> KinematicError:
    """Errors that the markers' residuals stand for.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad; NaN where unknown.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    segment : (M,) int array
    local : (M, 2) array
        Markers in their segment's frame, m.
    residual : (M,) array
        rms re-projection error of each marker in the joint fit, m.
    centre_covariance : (n, 2, 2) array
        m².
    """
    moving = segment > 0
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    postures = q[known[:: max(1, len(known) // _POSTURES)]]
    jacobian = planar.marker_jacobian(postures, centres, segment[moving], local[moving])
    stacked = jacobian.reshape(len(postures), -1, len(centres))  # (K, 2M, n)
    gain = np.linalg.pinv(stacked)  # from marker displacements to angles
    variance = np.repeat(residual[moving] ** 2 / 2, 2)
    return KinematicError(np.einsum("kim,m,kjm->ij", gain, variance, gain) / len(postures), centre_covariance)


def kinematic_covariance(prepared: Prepared, found: Fit, base: FloatArray, error: KinematicError) -> FloatArray:
    """Covariance of the fit's parameters that the geometry's errors cause.

    Parameters
    ----------
    prepared : Prepared
    found : Fit
    base : (b,) array
        Base parameters.
    error : KinematicError

    Returns
    -------
    (b + k + 1, b + k + 1) array
        In the order of ``found.covariance``.
    """
    recorded = prepared.recorded
    components = list(prepared.settings.components)

    def wrench(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        rows = planar_regressor(centres, q, dq, ddq, prepared.settings.gravity)
        return ((rows[:, :, prepared.base.kept] @ base)[:, components] * found.weights).reshape(-1)

    states = recorded.q[found.samples], recorded.dq[found.samples], recorded.ddq[found.samples]
    undisturbed = wrench(recorded.centres, *states)
    effects = [
        wrench(recorded.centres, *(state + part for state, part in zip(states, shift, strict=True))) - undisturbed
        for shift in _angle_errors(*states, error.angle)
    ]
    effects += [wrench(moved, *states) - undisturbed for moved in _moved_centres(recorded, error.centre)]
    rows = found.design.reshape(-1, found.design.shape[-1])
    response = np.linalg.lstsq(rows, np.stack(effects, axis=1), rcond=None)[0]
    return np.asarray(response @ response.T)


def _angle_errors(
    q: FloatArray, dq: FloatArray, ddq: FloatArray, covariance: FloatArray
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Independent error trajectories (R, n) of the angles with their derivatives, whose covariances add up to this.

    Along each axis of the covariance the error follows each joint's angle, linearly and quadratically.
    """
    joints = q.shape[1]
    values, vectors = np.linalg.eigh(covariance)
    axes = vectors * np.sqrt(np.maximum(values, 0.0) / (joints * (1 + _CURVED**2)))
    errors = []
    for joint in range(joints):
        size = max(float(q[:, joint].std()), 1e-12)
        u, du, ddu = ((x[:, joint] - m) / size for x, m in ((q, q[:, joint].mean()), (dq, 0.0), (ddq, 0.0)))
        square = u**2 - np.mean(u**2)
        curve = _CURVED / max(float(square.std()), 1e-12)
        shapes = ((u, du, ddu), (curve * square, curve * 2 * u * du, curve * 2 * (du**2 + u * ddu)))
        for shape in shapes:
            for axis in axes.T:
                first, second, third = (np.outer(part, axis) for part in shape)
                errors.append((first, second, third))
    return errors


def _moved_centres(recorded: Recorded, covariance: FloatArray) -> list[FloatArray]:
    """Joint centres (n, 2), each moved by one standard deviation along each axis of its covariance."""
    moved = []
    for joint, own in enumerate(covariance):
        values, vectors = np.linalg.eigh(own)
        for axis in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
            centres = recorded.centres.copy()
            centres[joint] += axis
            moved.append(centres)
    return moved
