"""Errors of measured poses that repeat with the movement, and their effect on parameters and torques.

Skin slides over bone as the joints turn, with the same error in every repetition, which resampling the trial does not
show. A slide d of one of the m markers of a body changes the body's measured pose by

    (d / m, ρ × d / Σ|ρ|²),

where ρ is the marker's position relative to the centroid. Slides follow the angle of the joint below or above the body,
as in :mod:`mocap_id.kinematics.skin_slides`. The markers of a body together give a (3, 3) covariance of the pose's
error in x, y and angle, for one standard deviation of the joint's angle. Its modes are propagated through the fit. The
places of the joints in the torques have errors of their own, which contain the skin's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.measured_motion import BodyPoses, measured_motion
from mocap_id.dynamics.motion import PlanarMotion
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import wrench_regressor
from mocap_id.geometry import planar

_RATE = 50.0  # Hz; movements are below 3 Hz
_STEP = 1e-4  # m, rad: step of numerical derivatives


@dataclass(frozen=True)
class SlidingBody:
    """Error of one body's pose by sliding markers.

    Parameters
    ----------
    covariance : (3, 3) array
        Covariance of the error in x, y (body's frame, m) and angle (rad), for one standard deviation of a joint angle.
    joints : tuple of int
        Joints, from 0, whose angles the slides follow.
    """

    covariance: FloatArray
    joints: tuple[int, ...]


@dataclass(frozen=True)
class PoseEffect:
    """Effect of the poses' errors, as modes of one standard deviation each.

    Parameters
    ----------
    parameters : (b + k + 1, S) array
        Changes of the fitted values with each mode, in the order of the fit's covariance.
    torque : (T, n) array
        Variance of the joint torques at fixed places of the joints, (N·m)².
    """

    parameters: FloatArray
    torque: FloatArray


def sliding_body(local: FloatArray, variance: FloatArray, joints: tuple[int, ...]) -> SlidingBody:
    """Compute the covariance of a body's pose from the slides of its markers.

    Parameters
    ----------
    local : (m, 2) array
        Markers in the body's frame, m.
    variance : (m,) array
        Variance of each marker's slide, per coordinate, m².
    joints : tuple of int
        Joints whose angles the slides follow.
    """
    arm = local - local.mean(axis=0)
    count, spread = len(local), float(np.sum(arm**2))
    gain = np.zeros((count, 3, 2))  # pose from a slide along x, along y
    gain[:, 0, 0] = gain[:, 1, 1] = 1.0 / count
    gain[:, 2, 0], gain[:, 2, 1] = -arm[:, 1] / spread, arm[:, 0] / spread
    return SlidingBody(np.einsum("kid,kjd,k->ij", gain, gain, variance), joints)


@dataclass(frozen=True)
class PoseErrors:
    """Measured poses and their errors.

    Parameters
    ----------
    poses : BodyPoses
        The poses from which the motion was computed.
    sliding : tuple of SlidingBody
        One for each body.
    bands : (x, y, angle)
        Cut-offs of the poses, Hz.
    """

    poses: BodyPoses
    sliding: tuple[SlidingBody, ...]
    bands: tuple[float, float, float]


def pose_effect(prepared: PreparedTrial, found: Fit, full: FloatArray, errors: PoseErrors) -> PoseEffect:
    """Propagate the errors of every body's pose through the fit.

    Parameters
    ----------
    prepared : PreparedTrial
        Prepared with the bodies' measured motion.
    found : Fit
    full : (4K,) array
        Parameters of the bodies.
    errors : PoseErrors
    """
    recorded, gravity = prepared.recorded, prepared.settings.gravity
    step = max(1, int(recorded.rate / _RATE))
    every = errors.poses
    thin = replace(every, time=every.time[::step], position=every.position[::step], angle=every.angle[::step])
    motion = measured_motion(thin, errors.bands)
    trace = _Trace(thin, errors.bands, motion, full, gravity, _wrenches(motion, full, gravity))
    shapes = _shapes(recorded.q, found.in_fit)[::step]
    rows, torques = [np.zeros((found.design.shape[-1], 0))], [np.zeros((len(thin.time), recorded.q.shape[1], 0))]
    for body, own in enumerate(errors.sliding):
        root = _root(own.covariance / max(len(own.joints), 1))
        for joint in own.joints:
            wrench, torque = trace.effects(body, shapes[:, joint])
            known = np.isfinite(wrench).all(axis=(1, 2))
            wrench_errors = _at(recorded.time[found.samples], thin.time[known], wrench[known] @ root)
            rows.append(-found.response(wrench_errors[:, list(prepared.settings.components)] * found.weights[:, None]))
            torques.append(torque @ root)
    parameters = np.concatenate(rows, axis=1)
    felt = np.concatenate(torques, axis=2) + _torque_rows(motion, gravity) @ parameters[: len(full)]  # (t, n, S)
    variance = np.sum(felt**2, axis=2)
    placed = np.isfinite(motion.joint).any(axis=(0, 2))
    known = np.isfinite(variance[:, placed]).all(axis=1)
    return PoseEffect(parameters, _at(recorded.time, thin.time[known], variance[known]))


@dataclass(frozen=True)
class _Trace:
    """Thinned poses, their motion, and the wrench (t, K, 3) that each body requires."""

    poses: BodyPoses
    bands: tuple[float, float, float]
    motion: PlanarMotion
    full: FloatArray
    gravity: float
    wrenches: FloatArray

    def effects(self, body: int, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of wrench (t, 3, 3) and torques (t, n, 3) by one body's x, y and angle, at fixed joints.

        The errors are in the body's frame and vary over time as ``shape`` (t,).
        """
        poses, base, wrench, torque = self.poses.one(body), self.motion, [], []
        for axis in range(3):
            position, turned = poses.position.copy(), poses.angle.copy()
            if axis < 2:
                position[:, 0] += planar.rotate(poses.angle[:, 0], _STEP * np.eye(2)[axis]) * shape[:, None]
            else:
                turned[:, 0] += _STEP * shape
            moved = measured_motion(replace(poses, position=position, angle=turned), self.bands)
            change = np.zeros_like(self.wrenches)
            own = _wrenches(moved, self.full[4 * body : 4 * body + 4], self.gravity)[:, 0]
            change[:, body] = (own - self.wrenches[:, body]) / _STEP
            wrench.append(change[:, body])
            torque.append(_torques(base, change))
        return np.stack(wrench, axis=-1), np.stack(torque, axis=-1)


def _shapes(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Return joint angles (T, n) minus their mean over some samples, in standard deviations; 0 where unknown."""
    own = q[samples]
    spread = np.nanstd(own, axis=0)
    return np.asarray(np.nan_to_num((q - np.nanmean(own, axis=0)) / np.where(spread > 0, spread, 1.0)))


def _wrenches(motion: PlanarMotion, full: FloatArray, gravity: float) -> FloatArray:
    """Return the wrench (t, K, 3) that each body requires, about the plane frame's origin."""
    regressor = wrench_regressor(motion, gravity)
    blocks = regressor.reshape(len(regressor), 3, -1, 4)
    return np.asarray(np.einsum("tckp,kp->tkc", blocks, full.reshape(-1, 4)))


def _torques(motion: PlanarMotion, wrenches: FloatArray) -> FloatArray:
    """Return the moments (t, n) about the joints of the wrenches on the bodies beyond them."""
    distal_wrench = np.einsum("tkc,jk->tjc", wrenches, motion.beyond.astype(np.float64))
    return np.asarray(np.einsum("tcj,tjc->tj", motion.jacobian, distal_wrench))


def _torque_rows(motion: PlanarMotion, gravity: float) -> FloatArray:
    """Return the regressor (t, n, 4K) of the torques."""
    regressor = wrench_regressor(motion, gravity)
    distal = np.repeat(motion.beyond, 4, axis=1)
    return np.asarray((np.swapaxes(motion.jacobian, 1, 2) @ regressor) * distal)


def _root(covariance: FloatArray) -> FloatArray:
    """Return the square root (3, 3) of a covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _at(time: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (t, ...) at known times, interpolated linearly at other times."""
    flat = values.reshape(len(known), -1)
    out = np.stack([np.interp(time, known, column) for column in flat.T], axis=-1)
    return np.asarray(out.reshape(len(time), *values.shape[1:]))
