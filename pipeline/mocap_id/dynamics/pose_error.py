"""Errors of measured poses that recur with the movement, and their effect on parameters and torques.

Skin slides over bone as the joints rotate, with the same error in every repetition. A slide d of one of the m markers
of a body changes the body's measured pose by

    (d / m, ρ × d / Σ|ρ|²),

where ρ is the marker's position relative to the centroid. Slides are proportional to the angle of the joint below or
above the body, as in :mod:`mocap_id.kinematics.skin_slides`. Together, the markers of a body give a (3, 3) covariance
of the pose's error in x, y and angle. The effect of its modes on the fit is computed. The errors of the joints'
positions are estimated separately.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.measured_motion import BodyPoses, filter_motion
from mocap_id.dynamics.motion import PlanarMotion
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import torque_regressor, wrench_regressor
from mocap_id.geometry import planar

_RATE = 50.0  # Hz: rate at which the effect is computed; movements are below 3 Hz
_STEP = 1e-4  # m, rad: step of numerical derivatives


@dataclass(frozen=True)
class SlidingBody:
    """Error of one body's pose due to sliding markers."""

    # (3, 3) covariance of the error in x, y (body's frame, m) and angle (rad), for one standard deviation of a joint
    # angle
    covariance: FloatArray
    joints: tuple[int, ...]  # joints, from 0, to whose angles the slides are proportional


@dataclass(frozen=True)
class PoseEffect:
    """Effect of the poses' errors, as modes of one standard deviation each."""

    # (b + k + 1, S) change of the fitted values with each mode, in the order of the fit's covariance
    parameters: FloatArray
    torque: FloatArray  # (T, n) variance of the joint torques for exact positions of the joints, (N·m)²


def propagate_slides(local: FloatArray, variance: FloatArray, joints: tuple[int, ...]) -> SlidingBody:
    """Return the error of a body's pose due to the slides of its markers.

    Parameters
    ----------
    local : (m, 2) array
        Markers in the body's frame, m.
    variance : (m,) array
        Variance of each marker's slide, per coordinate, m².
    joints : tuple of int
        Joints, from 0, to whose angles the slides are proportional.
    """
    arm = local - local.mean(axis=0)
    count, spread = len(local), float(np.sum(arm**2))
    gain = np.zeros((count, 3, 2))  # change of the pose by a slide along x, along y
    gain[:, 0, 0] = gain[:, 1, 1] = 1.0 / count
    gain[:, 2, 0], gain[:, 2, 1] = -arm[:, 1] / spread, arm[:, 0] / spread
    return SlidingBody(np.einsum("kid,kjd,k->ij", gain, gain, variance), joints)


@dataclass(frozen=True)
class PoseErrors:
    """Measured poses and their errors."""

    poses: BodyPoses  # poses from which the motion was computed
    sliding: tuple[SlidingBody, ...]  # error of each body
    bands: tuple[float, float, float]  # cut-offs of the poses, Hz


def propagate_pose_errors(prepared: PreparedTrial, result: Fit, full: FloatArray, errors: PoseErrors) -> PoseEffect:
    """Return the effect of the errors of all bodies' poses on the fit and on the torques.

    ``full`` (4K,) are the full parameters of the bodies.
    """
    recorded, gravity = prepared.recorded, prepared.settings.gravity
    step = max(1, int(recorded.rate / _RATE))
    every = errors.poses
    thin = replace(every, time=every.time[::step], position=every.position[::step], angle=every.angle[::step])
    motion = filter_motion(thin, errors.bands)
    trace = _ThinnedMotion(thin, errors.bands, motion, full, gravity, _compute_wrenches(motion, full, gravity))
    shapes = _standardise(recorded.q, result.in_fit)[::step]
    rows, torques = [np.zeros((result.design.shape[-1], 0))], [np.zeros((len(thin.time), recorded.q.shape[1], 0))]
    for body, own in enumerate(errors.sliding):
        root = _take_root(own.covariance / max(len(own.joints), 1))
        for joint in own.joints:
            wrench, torque = trace.effects(body, shapes[:, joint])
            known = np.isfinite(wrench).all(axis=(1, 2))
            wrench_errors = _interpolate(recorded.time[result.samples], thin.time[known], wrench[known] @ root)
            rows.append(
                -result.response(wrench_errors[:, list(prepared.settings.components)] * result.weights[:, None])
            )
            torques.append(torque @ root)
    parameters = np.concatenate(rows, axis=1)
    errors_of_torque = (
        np.concatenate(torques, axis=2)
        + torque_regressor(motion, wrench_regressor(motion, gravity)) @ parameters[: len(full)]
    )  # (t, n, S)
    variance = np.sum(errors_of_torque**2, axis=2)
    placed = np.isfinite(motion.joint).any(axis=(0, 2))
    known = np.isfinite(variance[:, placed]).all(axis=1)
    return PoseEffect(parameters, _interpolate(recorded.time, thin.time[known], variance[known]))


@dataclass(frozen=True)
class _ThinnedMotion:
    """Poses at t samples of the trial, their motion, and the wrench (t, K, 3) that each body requires."""

    poses: BodyPoses
    bands: tuple[float, float, float]
    motion: PlanarMotion
    full: FloatArray
    gravity: float
    wrenches: FloatArray

    def effects(self, body: int, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the change of wrench (t, 3, 3) and torques (t, n, 3) per unit error of one body's x, y and angle.

        The errors are in the body's frame and are multiplied by ``shape`` (t,). The joints are not displaced.
        """
        poses, base, wrench, torque = self.poses.select(body), self.motion, [], []
        for axis in range(3):
            position, angle = poses.position.copy(), poses.angle.copy()
            if axis < 2:
                position[:, 0] += planar.rotate(poses.angle[:, 0], _STEP * np.eye(2)[axis]) * shape[:, None]
            else:
                angle[:, 0] += _STEP * shape
            moved = filter_motion(replace(poses, position=position, angle=angle), self.bands)
            change = np.zeros_like(self.wrenches)
            own = _compute_wrenches(moved, self.full[4 * body : 4 * body + 4], self.gravity)[:, 0]
            change[:, body] = (own - self.wrenches[:, body]) / _STEP
            wrench.append(change[:, body])
            torque.append(_compute_torques(base, change))
        return np.stack(wrench, axis=-1), np.stack(torque, axis=-1)


def _standardise(q: FloatArray, samples: BoolArray) -> FloatArray:
    """Return joint angles (T, n) minus their mean over the marked samples, in standard deviations; 0 where missing."""
    own = q[samples]
    spread = np.nanstd(own, axis=0)
    return np.asarray(np.nan_to_num((q - np.nanmean(own, axis=0)) / np.where(spread > 0, spread, 1.0)))


def _compute_wrenches(motion: PlanarMotion, full: FloatArray, gravity: float) -> FloatArray:
    """Return the wrench (t, K, 3) that each body requires, about the plane frame's origin."""
    regressor = wrench_regressor(motion, gravity)
    blocks = regressor.reshape(len(regressor), 3, -1, 4)
    return np.asarray(np.einsum("tckp,kp->tkc", blocks, full.reshape(-1, 4)))


def _compute_torques(motion: PlanarMotion, wrenches: FloatArray) -> FloatArray:
    """Return the moments (t, n) about the joints of the wrenches on the bodies beyond them."""
    distal_wrench = np.einsum("tkc,jk->tjc", wrenches, motion.beyond.astype(np.float64))
    return np.asarray(np.einsum("tcj,tjc->tj", motion.jacobian, distal_wrench))


def _take_root(covariance: FloatArray) -> FloatArray:
    """Return a matrix L (3, 3) with L Lᵀ equal to a covariance (3, 3)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _interpolate(time: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate values (t, ...) at the times ``known`` (t,) linearly to other times (T,); return (T, ...)."""
    flat = values.reshape(len(known), -1)
    out = np.stack([np.interp(time, known, column) for column in flat.T], axis=-1)
    return np.asarray(out.reshape(len(time), *values.shape[1:]))
