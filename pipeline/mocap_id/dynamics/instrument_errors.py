"""Errors of scale of the instruments, and their effect on parameters and torques.

A wrong gain of the plate, or a wrong scale or tilt of the cameras, is the same in every sample, so the residuals hardly
contain this error. The standard deviations of parameters and torques therefore contain the usual size of these errors.
The standard deviations of the predicted wrench and centre of pressure do not, because both are compared with the same
plate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, find_complete_rows
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.lowpass import interpolate_samples
from mocap_id.dynamics.motion import PlanarMotion
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import torque_regressor, wrench_regressor

_RATE = 10.0  # Hz: rate at which torques are evaluated; a movement's frequencies are below 3 Hz
_STEP = 1e-4  # relative, or rad: step of numerical derivatives
_SURE, _MASS_APART = 2.58, 0.05  # standard deviations of a 99 % interval; relative difference of two masses
_WRONG_PLATES, _WRONG_GAIN = 0.05, 0.05  # fraction of plates with a wrong gain, and standard deviation of their gain


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of the instruments' errors of scale, with the defaults of the stage."""

    gain: float = 0.01  # relative error that is common to all components of the plate's wrench
    moments: float = 0.01  # additional relative error of the plate's moments
    lengths: float = 0.003  # relative error of all distances between markers
    tilt: float = 0.005  # tilt between the cameras' axes and gravity, in the plane of motion, rad
    position: float = 0.005  # error of the plate's position along the motion, m
    # mass of the person from a scale, kg, which limits the error of the gain; None if not weighed
    mass: float | None = None
    mass_sd: float = 1.0  # standard deviation of this mass, kg

    def estimate_gain_error(self, mass: float, mass_sd: float) -> float:
        """Return the rms error of the gain, given the mass that the plates measure.

        The ratio of this mass to the mass from a scale estimates the gain, but is not used to correct the forces. The
        difference between the masses therefore counts as an error of the gain. A large difference probably means that
        this is one of the few plates with a wrong gain, because an unusual error of a good plate is less probable.

        Parameters
        ----------
        mass, mass_sd : float
            Identified mass and its standard deviation without the error of the gain, kg.
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
        """Return the relative difference above which the mass that the plates measure, kg, contradicts the scale.

        It is 5 %, or the relative error of plate and scale that is not exceeded in 99 % of all cases, if this is less.
        """
        return float(min(_MASS_APART, _SURE * np.hypot(self.gain, self.mass_sd / mass)))


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


@dataclass(frozen=True)
class ScaleCheck:
    """Result of the check for a wrong scale."""

    causes: dict[str, ScaleCause]  # estimate of each cause
    # causes that explain a contradiction, the most likely first; empty without a contradiction. A single cause is
    # identified by the data.
    suspects: tuple[str, ...]


def propagate_calibration(
    prepared: PreparedTrial, result: Fit, base: FloatArray, sd: Mapping[str, float]
) -> CalibrationEffect:
    """Return the changes of the base parameters due to errors of the instruments, each of one standard deviation.

    Parameters
    ----------
    sd : mapping of str to float
        Standard deviations of the errors: ``gain``, ``moments``, ``vertical gain``, ``inertia`` and ``lengths``
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
