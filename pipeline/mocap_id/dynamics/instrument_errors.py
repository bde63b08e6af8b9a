"""Errors that residuals hide or repeat: scale, accelerations, geometry, measured poses; their effect on the results.

A wrong gain of the plate, or a wrong scale or tilt of the cameras, is the same in every sample, so the residuals hardly
contain this error. The standard deviations of parameters and torques therefore contain the usual size of these errors.
The standard deviations of the predicted wrench and centre of pressure do not, because both are compared with the same
plate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.optimize import nnls

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_complete_rows
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.measured_motion import BodyPoses, filter_motion
from mocap_id.dynamics.preparation import LowPass, PreparedTrial, interpolate_samples
from mocap_id.dynamics.regressor import (
    PlanarMotion,
    composite_inertia,
    planar_regressor,
    planar_torque_regressor,
    torque_regressor,
    wrench_regressor,
)
from mocap_id.geometry import planar

_RATE = 10.0  # Hz: rate at which torques are evaluated; a movement's frequencies are below 3 Hz
_STEP = 1e-4  # relative, or rad: step of numerical derivatives
_SURE = 2.58  # standard deviations of a 99 % interval
MASS_APART = 0.05  # smallest relative difference of two masses that contradict each other
_WRONG_PLATES, _WRONG_GAIN = 0.05, 0.05  # fraction of plates with a wrong gain, and standard deviation of their gain


@dataclass(frozen=True)
class PlanarCalibration:
    """Standard deviations of the instruments' errors of scale."""

    gain: float  # relative error that is common to all components of the plate's wrench
    moments: float  # additional relative error of the plate's moments
    lengths: float  # relative error of all distances between markers
    tilt: float  # tilt between the cameras' axes and gravity, in the plane of motion, rad
    position: float  # error of the plate's position along the motion, m
    # mass of the person from a scale, kg, which limits the error of the gain; None if not weighed
    mass: float | None
    mass_sd: float  # standard deviation of this mass, kg

    def estimate_gain_error(self, mass: float, mass_sd: float) -> float:
        """Return the rms error of the gain, given the mass that the plates measure.

        ``mass_sd`` is the standard deviation of this mass without the error of the gain, kg. The ratio of this mass to
        the mass from a scale estimates the gain, but is not used to correct the forces. The difference between the
        masses therefore counts as an error of the gain. A large difference probably means that this is one of the few
        plates with a wrong gain, because an unusual error of a good plate is less probable.
        """
        if self.mass is None or self.gain == 0.0:
            return self.gain
        gain = np.array([self.gain, max(self.gain, _WRONG_GAIN)])
        apart = mass / self.mass - 1.0
        total = gain**2 + (self.mass_sd**2 + mass_sd**2) / mass**2
        unlikely = apart**2 / (2 * total)
        evidence = [1.0 - _WRONG_PLATES, _WRONG_PLATES] * np.exp(unlikely.min() - unlikely) / np.sqrt(total)
        share = gain**2 / total
        square = gain**2 * (1.0 - share) + (share * apart) ** 2
        return float(np.sqrt(evidence @ square / evidence.sum()))

    def mass_limit(self, mass: float) -> float:
        """Return the relative difference, at most 5 %, above which the plates' mass, kg, contradicts the scale."""
        return float(min(MASS_APART, _SURE * np.hypot(self.gain, self.mass_sd / mass)))


@dataclass(frozen=True)
class CalibrationEffect:
    """Effect of errors of scale, as modes of one standard deviation each."""

    parameters: FloatArray  # (b, S) change of the base parameters with each mode
    # inertia, lengths, tilt: standard deviations of the last three modes, which also change the motion: relative,
    # relative and rad
    inertia: float
    lengths: float
    tilt: float

    @property
    def covariance(self) -> FloatArray:
        """Covariance (b, b) of the base parameters."""
        return np.asarray(self.parameters @ self.parameters.T)


@dataclass(frozen=True)
class ScaleCause:
    """Estimate of one cause of a wrong scale, while the other causes are kept near zero."""

    # value, sd: estimate and its standard deviation: relative, or in N, m or rad, depending on the cause
    value: float
    sd: float
    explains: float  # decrease of the cost if this cause is not kept near zero
    limit: float  # magnitude above which the value is significant


ScaleCheck: TypeAlias = tuple[dict[str, ScaleCause], tuple[str, ...]]
"""Result of the check for a wrong scale: the estimate of each cause, and the suspects.

Suspects are the causes that explain a contradiction, the most likely first; none without a contradiction. A single
suspect is identified by the data.
"""


def propagate_calibration(
    prepared: PreparedTrial, result: Fit, base: FloatArray, sd: Mapping[str, float]
) -> CalibrationEffect:
    """Return the changes of the base parameters due to errors of the instruments, each of one standard deviation.

    ``sd`` are the standard deviations: ``gain``, ``moments``, ``vertical gain``, ``inertia`` and ``lengths``
    (relative), ``vertical force`` (N), ``position`` (m), ``tilt`` (rad). Errors that are not named are zero.
    """
    samples, components = result.samples, list(prepared.settings.components)
    gravity, kept = prepared.settings.gravity, prepared.base.kept
    plain, wrench = prepared.rows @ base, prepared.filtered[samples] @ base

    def filtered(motion: PlanarMotion, g: float = gravity) -> FloatArray:
        return prepared.lowpass(wrench_regressor(motion, g)[:, :, kept] @ base - plain)[samples]

    column = np.zeros((len(samples), 3, 7))
    column[:, 2, 0] = wrench[:, 2] * sd.get("moments", 0.0)
    column[:, 1, 1] = wrench[:, 1] * sd.get("vertical gain", 0.0)
    column[:, 1, 2] = sd.get("vertical force", 0.0)
    column[:, 2, 3] = wrench[:, 1] * sd.get("position", 0.0)
    if "inertia" in sd:
        column[:, :, 4] = (filtered(prepared.motion, 0.0) + wrench) * sd["inertia"]
    if "lengths" in sd:
        column[:, :, 5] = -filtered(prepared.motion.scale(1 + _STEP)) / _STEP * sd["lengths"]
    if "tilt" in sd:
        column[:, :, 6] = -filtered(prepared.motion.tilt(_STEP)) / _STEP * sd["tilt"]
    response = result.response(column[:, components] * result.weights[:, None])[: len(base)]
    gain = (sd.get("gain", 0.0) * base)[:, None]
    modes = np.concatenate([gain, response], axis=1)
    return CalibrationEffect(modes, sd.get("inertia", 0.0), sd.get("lengths", 0.0), sd.get("tilt", 0.0))


def compute_scale_variance(prepared: PreparedTrial, base: FloatArray, effect: CalibrationEffect) -> FloatArray:
    """Return the variance (T, n) of the joint torques from errors of scale, (N·m)²; NaN where missing."""
    time, joints = prepared.recorded.time, prepared.motion.joint.shape[1]
    valid = np.flatnonzero(find_complete_rows(prepared.regressor))
    steps = valid[:: max(1, round(prepared.recorded.rate / _RATE))]
    if not len(steps):
        return np.full((len(time), joints), np.nan)
    motion = prepared.motion.at(steps)

    def rows(moved: PlanarMotion, g: float = prepared.settings.gravity) -> FloatArray:
        return torque_regressor(moved, wrench_regressor(moved, g))[:, :, prepared.base.kept]

    own = rows(motion)
    changed = own @ effect.parameters
    if effect.inertia:
        changed[:, :, -3] -= rows(motion, 0.0) @ base * effect.inertia
    for mode, moved, size in ((-2, motion.scale(1 + _STEP), effect.lengths), (-1, motion.tilt(_STEP), effect.tilt)):
        changed[:, :, mode] += (rows(moved) - own) @ base / _STEP * size
    return interpolate_samples(time, valid, steps, np.sum(changed**2, axis=2))


_EXPONENT = -3.0 / 8.0
_LEAST = 1e-12  # fraction of the largest eigenvalue: avoids a division by zero for a joint without markers


def correlate_errors(
    q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray, snap: FloatArray
) -> FloatArray:
    """Return the correlation (T, n, n) of the errors of the joint accelerations in every posture.

    ``segment`` (M,) and ``local`` (M, 2), m, locate the markers; ``snap`` (n,) are the relative standard deviations of
    the joints' process noise. Samples with a missing angle are NaN.
    """
    correlation = np.full((*q.shape, q.shape[1]), np.nan)
    known = np.isfinite(q).all(axis=1)
    scale = snap / np.max(snap)
    # Jᵀ J of the markers (eq. 2.47), (T, n, n), m²: the mass matrix of a chain with unit masses at the markers
    mass, mx, my, inertia = (
        np.bincount(segment, weights=each, minlength=len(centres) + 1).astype(np.float64)
        for each in (np.ones(len(local)), local[:, 0], local[:, 1], np.sum(local**2, axis=1))
    )
    information = composite_inertia(q[known], centres, mass, np.column_stack([mx, my]), inertia)[1]
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    values = np.maximum(values, _LEAST * values[:, -1:])
    covariance = (vectors * values[:, None, :] ** _EXPONENT) @ np.swapaxes(vectors, 1, 2)
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    # the outer factors Q^½ only scale the joints
    correlation[known] = covariance / (size[:, :, None] * size[:, None, :])
    return correlation


_SAMPLES = 300  # number of samples used: sufficient for errors that recur with the movement
_AT_ONCE = 300  # number of samples whose effect is computed at a time, to limit the memory
_MOMENT = 1.0 / 30.0  # s: time step for the derivatives of the angles' errors
_STATE_STEP = 1e-6  # rad, rad/s …, m: step of numerical derivatives


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
    full, parts = prepared.base.expand(base), chunks(len(samples), _AT_ONCE)
    changes = [_propagate_modes(lambda _, __, rows: rows @ full, prepared, samples[part], error) for part in parts]
    return np.concatenate(changes)


def propagate_to_torques(
    prepared: PreparedTrial, base: FloatArray, error: KinematicError, response: FloatArray
) -> FloatArray:
    """Return the variance (T, n) of the joint torques from all modes, (N·m)²; NaN where a state is missing.

    In a mode, the errors of the states and of the parameters, ``response`` (b, S), are correlated and largely cancel.
    """
    recorded, kept, full = prepared.recorded, prepared.base.kept, prepared.base.expand(base)
    valid = np.flatnonzero(find_complete_rows(prepared.regressor))
    if error.centre.shape[-1] == 0 or not len(valid):
        variance = np.full(recorded.q.shape, np.nan)
        variance[valid] = 0.0
        return variance

    def torques(q: FloatArray, centres: FloatArray, regressor: FloatArray) -> FloatArray:
        return planar_torque_regressor(centres, q, regressor) @ full

    steps = valid[:: max(1, round(recorded.rate / _RATE))]
    variance = np.empty((len(steps), recorded.q.shape[1]))
    for part in chunks(len(steps), _AT_ONCE):
        own = steps[part]
        rows = planar_torque_regressor(recorded.centres, recorded.q[own], prepared.regressor[own])[:, :, kept]
        variance[part] = np.sum((_propagate_modes(torques, prepared, own, error) + rows @ response) ** 2, axis=2)
    return interpolate_samples(recorded.time, valid, steps, variance)


def _propagate_modes(
    function: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    prepared: PreparedTrial,
    samples: IntArray,
    error: KinematicError,
) -> FloatArray:
    """Return the changes (R, m, S) of the m values of a function with every mode, for sample indices (R,).

    The arguments of the function are angles (R, n), joint centres (R, n, 2) and the full regressor (R, 3, 4(n + 1)).
    """
    recorded, centres = prepared.recorded, prepared.recorded.centres
    q, dq, ddq = recorded.q[samples], recorded.dq[samples], recorded.ddq[samples]
    states = np.concatenate([q, dq, ddq], axis=1)
    errors = error.states(q, dq, ddq)
    count = states.shape[1]
    # steps of every state and coordinate in turn; the first row is zero
    steps = _STATE_STEP * np.eye(1 + count + centres.size, count + centres.size, k=-1)[:, None]
    moved = states + steps[..., :count]
    places = centres + steps[..., count:].reshape(-1, 1, *centres.shape)
    places = np.broadcast_to(places, (*moved.shape[:2], *centres.shape))
    (q, dq, ddq), places = np.split(moved.reshape(-1, count), 3, axis=1), places.reshape(-1, *centres.shape)
    regressor = planar_regressor(places, q, dq, ddq, prepared.settings.gravity)
    values = function(q, places, regressor).reshape(*moved.shape[:2], -1)
    slopes = np.stack([*(values[1:] - values[0]) / _STATE_STEP], axis=-1)
    of_centres = slopes[..., count:] @ error.centre.reshape(centres.size, errors.shape[-1])
    return np.asarray(slopes[..., :count] @ errors + of_centres)


_POSE_RATE = 50.0  # Hz: rate at which the effect is computed; movements are below 3 Hz
_POSE_STEP = 1e-4  # m, rad: step of numerical derivatives


def propagate_slides(local: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of the error of a body's pose in x, y (body's frame, m) and angle (rad).

    ``variance`` (m,) are those of each marker's slide, per coordinate, m², for one standard deviation of the joint
    angle to which the slides are proportional.
    """
    arm = local - local.mean(axis=0)
    count, spread = len(local), float(np.sum(arm**2))
    gain = np.zeros((count, 3, 2))  # change of the pose by a slide along x, along y
    gain[:, 0, 0] = gain[:, 1, 1] = 1.0 / count
    gain[:, 2, 0], gain[:, 2, 1] = -arm[:, 1] / spread, arm[:, 0] / spread
    return np.asarray(np.einsum("kid,kjd,k->ij", gain, gain, variance))


def propagate_pose_errors(
    prepared: PreparedTrial,
    result: Fit,
    full: FloatArray,
    poses: BodyPoses,
    *,
    sliding: Sequence[tuple[FloatArray, tuple[int, ...]]],
    bands: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return the effect of the errors of the poses of bodies with the parameters ``full`` (4K,) on fit and torques.

    It is the change (b + k + 1, S) of the fitted values with each of S modes of one standard deviation, in the order of
    the fit's covariance, and the variance (T, n) of the joint torques for exact positions of the joints, (N·m)².

    ``sliding`` are the covariance (3, 3) of the error of each body's pose (:func:`propagate_slides`) and the joints,
    from 0, to whose angles it is proportional. ``bands`` are the cut-offs with which ``poses`` were filtered, Hz.
    """
    recorded, gravity, components = prepared.recorded, prepared.settings.gravity, list(prepared.settings.components)
    step = max(1, int(recorded.rate / _POSE_RATE))
    thin = replace(poses, time=poses.time[::step], position=poses.position[::step], angle=poses.angle[::step])
    motion = filter_motion(thin, bands)
    jacobian, beyond = motion.jacobian, motion.beyond.astype(np.float64)
    wrenches = _compute_wrenches(motion, full, gravity)
    # joint angles minus their mean, in standard deviations; 0 where missing
    own_q = recorded.q[result.in_fit]
    spread = np.nanstd(own_q, axis=0)
    shapes = np.nan_to_num((recorded.q - np.nanmean(own_q, axis=0)) / np.where(spread > 0, spread, 1.0))[::step]

    rows, torques = [np.zeros((result.design.shape[-1], 0))], [np.zeros((len(thin.time), recorded.q.shape[1], 0))]
    for body, (covariance, joints) in enumerate(sliding):
        values, vectors = np.linalg.eigh(covariance / max(len(joints), 1))
        root = vectors * np.sqrt(np.maximum(values, 0.0))  # (3, 3), so that root rootᵀ is the covariance
        for joint in joints:
            # Change of wrench (t, 3, 3) and torques (t, n, 3) per unit error of the body's x, y and angle, in the
            # body's frame and proportional to the joint angle. The joints are not displaced.
            shape, alone, wrench, torque = shapes[:, joint], thin.select(body), [], []
            for axis in range(3):
                position, angle = alone.position.copy(), alone.angle.copy()
                if axis < 2:
                    along = planar.rotate(alone.angle[:, 0], _POSE_STEP * np.eye(2)[axis])
                    position[:, 0] += along * shape[:, None]
                else:
                    angle[:, 0] += _POSE_STEP * shape
                moved = filter_motion(replace(alone, position=position, angle=angle), bands)
                changed = _compute_wrenches(moved, full[4 * body : 4 * body + 4], gravity)[:, 0]
                change = np.zeros_like(wrenches)
                change[:, body] = (changed - wrenches[:, body]) / _POSE_STEP
                wrench.append(change[:, body])
                distal = np.einsum("tkc,jk->tjc", change, beyond)  # wrench on the bodies beyond each joint
                torque.append(np.einsum("tcj,tjc->tj", jacobian, distal))
            effect = np.stack(wrench, axis=-1)
            known = np.isfinite(effect).all(axis=(1, 2))
            wrench_errors = _interpolate(recorded.time[result.samples], thin.time[known], effect[known] @ root)
            rows.append(-result.response(wrench_errors[:, components] * result.weights[:, None]))
            torques.append(np.stack(torque, axis=-1) @ root)
    parameters = np.concatenate(rows, axis=1)
    torque_rows = torque_regressor(motion, wrench_regressor(motion, gravity))
    errors_of_torque = np.concatenate(torques, axis=2) + torque_rows @ parameters[: len(full)]  # (t, n, S)
    variance = np.sum(errors_of_torque**2, axis=2)
    placed = np.isfinite(motion.joint).any(axis=(0, 2))
    known = np.isfinite(variance[:, placed]).all(axis=1)
    return parameters, _interpolate(recorded.time, thin.time[known], variance[known])


def _compute_wrenches(motion: PlanarMotion, full: FloatArray, gravity: float) -> FloatArray:
    """Return the wrench (t, K, 3) that each body requires, about the plane frame's origin."""
    regressor = wrench_regressor(motion, gravity)
    blocks = regressor.reshape(len(regressor), 3, -1, 4)
    return np.asarray(np.einsum("tckp,kp->tkc", blocks, full.reshape(-1, 4)))


def _interpolate(time: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate values (t, ...) at the times ``known`` (t,) linearly to other times (T,); return (T, ...)."""
    flat = values.reshape(len(known), -1)
    out = np.stack([np.interp(time, known, column) for column in flat.T], axis=-1)
    return np.asarray(out.reshape(len(time), *values.shape[1:]))


_BAND = 25.0  # Hz: smoothed accelerations of people and robots have no power above this frequency
_SHARE = 0.25  # largest band as a fraction of the rate: the noise is measured above it
_HIDDEN = 0.1  # fraction of the variance in the band: a smaller error cannot be separated from the plate's noise


def estimate_model_error(
    residual: FloatArray, noise: FloatArray, samples: BoolArray, rate: float
) -> tuple[float, float, float] | None:
    """Estimate the variance of the model's error in one component of the wrench; None if no interval is long enough.

    It is ``steady + scale · (variance from the accelerations)``. The variance ``steady``, N² or (N·m)², the factor
    ``scale``, and the mean variance of the error, divided by the mean variance that follows from the states, are
    returned.

    A constant and the variance that follows from the accelerations, ``noise`` (T,), are fitted, with non-negative
    coefficients, to the squared ``residual`` (T,) below 25 Hz, in the samples (T,) in which only the ground touches the
    body. White noise with the density measured above this frequency is subtracted. Plate noise that is not white counts
    as an error of the model, which is then overestimated.
    """
    lowpass = LowPass(min(_BAND, _SHARE * rate), rate)
    low = lowpass(np.where(samples, residual, np.nan))
    valid = np.isfinite(low) & np.isfinite(noise)
    if valid.sum() < 2:
        return None
    mean, squares = float(np.mean(noise[valid])), (low[valid] - low[valid].mean()) ** 2
    # the fractions of the variance of white noise that the filter passes and stops give the plate's noise
    impulse = np.zeros(20 * lowpass.reach_samples + 1)
    impulse[len(impulse) // 2] = 1.0
    response = lowpass(impulse)
    passed, stopped = float(np.sum(response**2)), float(np.sum((impulse - response) ** 2))
    plate = passed * float(np.var((residual - low)[valid])) / stopped
    size = max(float(squares.mean()) - plate, _HIDDEN * float(squares.mean()))
    if mean <= 0.0:
        return size, 0.0, 1.0
    (steady, moving), _ = nnls(np.column_stack([np.ones(valid.sum()), noise[valid] / mean]), squares)
    steady = max(steady - plate, 0.0)  # the plate's noise may exceed the constant part
    if steady + moving == 0.0:
        return size, 0.0, size / mean
    share = size / (steady + moving)
    return share * steady, share * moving / mean, size / mean
