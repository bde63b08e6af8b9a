"""Smooth functions of time: joint motions with exact derivatives, steps, sway and tremor, and rotations in space."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import betainc

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

STEP = 0.005  # s, between the samples of a motion's spline
DEGREE = 7  # six continuous derivatives: the snap of every joint is smooth
TREMOR = (1.0, 5.0)  # Hz
SWAY = (0.08, 0.6)  # Hz
_WAVES = 8  # sine waves of a tremor or sway


def smoothstep(phase: FloatArray, order: int = 6) -> FloatArray:
    """Return a step from 0 (phase ≤ 0) to 1 (phase ≥ 1); its first ``order - 1`` derivatives are continuous."""
    return np.asarray(betainc(order, order, np.clip(phase, 0.0, 1.0)))


def ramp_up(time: FloatArray, start: float) -> FloatArray:
    """Return a factor (T, 1) that rises smoothly from 0 at ``start`` to 1 one second later."""
    return smoothstep(time - start)[:, None]


def draw_tremor(rng: np.random.Generator, time: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return random angles (T, n), rad; ``acceleration`` (n,) is the rms value of their second derivatives, rad/s²."""
    frequency, phase = _draw_waves(rng, TREMOR, len(acceleration))
    omega = 2 * np.pi * frequency
    waves = np.sin(omega * time[:, None, None] + phase) / omega**2
    return np.asarray(acceleration * waves.sum(axis=1) * np.sqrt(2 / _WAVES))


def draw_sway(rng: np.random.Generator, time: FloatArray, size: FloatArray) -> FloatArray:
    """Return slow random motion (T, n) with standard deviations ``size`` (n,); slower waves have larger amplitudes."""
    frequency, phase = _draw_waves(rng, SWAY, len(size))
    weight = 1 / frequency
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase) * weight
    return np.asarray(size * waves.sum(axis=1) / np.sqrt((weight**2).sum(axis=0) / 2))


def _draw_waves(rng: np.random.Generator, band: tuple[float, float], count: int) -> tuple[FloatArray, FloatArray]:
    """Return random frequencies, Hz, and phases, rad, (waves, count) each."""
    return rng.uniform(*band, (_WAVES, count)), rng.uniform(0, 2 * np.pi, (_WAVES, count))


def draw_direction(rng: np.random.Generator) -> FloatArray:
    """Return a random unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


@dataclass(frozen=True)
class JointMotion:
    """Joint angles as a function of time.

    Parameters
    ----------
    spline : BSpline
        Joint angles (n,), rad, at a time, s. The spline extends beyond both ends of the trial.
    duration : float
        Duration of the trial, which starts at 0, s.
    """

    spline: BSpline
    duration: float

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return angle, velocity, acceleration and jerk, (T, n) each, at times (T,)."""
        q, dq, ddq, dddq = (np.asarray(self.spline(time, order), dtype=np.float64) for order in range(4))
        return q, dq, ddq, dddq


def motion_through(time: FloatArray, angles: FloatArray, duration: float) -> JointMotion:
    """Return the motion that interpolates ``angles`` (T, n), rad, at evenly spaced times (T,), s."""
    return JointMotion(make_interp_spline(time, angles, k=DEGREE), duration)


@dataclass(frozen=True)
class Swing:
    """Sinusoidal motion of a robot's joint."""

    frequency: float  # Hz
    amplitude: float  # rad
    centre: float  # mean angle, rad
    periods: int
    lead: float  # rest before and after the motion, s

    @property
    def duration(self) -> float:
        return self.periods / self.frequency + 2 * self.lead

    def repetitions(self) -> list[dict[str, Any]]:
        """Return start and end of each period, s."""
        starts = self.lead + np.arange(self.periods) / self.frequency
        return [{"start": float(start), "end": float(start + 1 / self.frequency)} for start in starts]

    def motion(self) -> JointMotion:
        """Return the motion from rest to rest: the amplitude grows in the first half period and fades in the last."""
        time = np.arange(-1.0, self.duration + 1.0, STEP)
        phase = (time - self.lead) * self.frequency
        envelope = smoothstep(2 * phase) * smoothstep(2 * (self.periods - phase))
        angle = self.centre + self.amplitude * envelope * np.sin(2 * np.pi * phase)
        return motion_through(time, angle[:, None], self.duration)


# --- rotations with exact angular velocity and acceleration, composed of rotations about given axes

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class AxisRotation:
    """A rotation about an axis that is fixed in the coordinate frame reached by the previous rotations."""

    axis: FloatArray  # (3,) unit vector
    angle: FloatArray  # (F,) rad
    rate: FloatArray  # (F,) rad/s
    acceleration: FloatArray  # (F,) rad/s²


@dataclass(frozen=True)
class Attitude:
    """Attitude of a coordinate frame relative to a reference over time."""

    rotation: FloatArray  # (F, 3, 3) from the frame to the reference
    omega: FloatArray  # (F, 3) angular velocity in the axes of the reference, rad/s
    alpha: FloatArray  # (F, 3) angular acceleration in the axes of the reference, rad/s²

    def rotate(self, rotations: Iterable[AxisRotation]) -> Attitude:
        """Return the attitude after the given rotations."""
        rotation, omega, alpha = self.rotation, self.omega, self.alpha
        for one in rotations:
            axis = rotation @ one.axis
            rate = one.rate[:, None]
            alpha = alpha + np.cross(omega, axis) * rate + axis * one.acceleration[:, None]
            omega = omega + axis * rate
            rotation = rotation @ so3.exp(one.angle[:, None] * one.axis)
        return Attitude(rotation, omega, alpha)


def constant_attitude(rotation: FloatArray, frames: int) -> Attitude:
    """Return a constant attitude, given by a ``rotation`` (3, 3), at ``frames`` frames."""
    zero = np.zeros((frames, 3))
    return Attitude(np.broadcast_to(rotation, (frames, 3, 3)), zero, zero)


def decompose_elbow(forearm: Attitude) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return flexion, carrying angle and pronation (F, 3), rad, with their rates and accelerations (F, 3) each.

    ``forearm`` is the attitude of the forearm in the upper arm: ``R_z(flexion) R_x(carrying) R_y(pronation)``.
    """
    rotation = forearm.rotation
    flexion = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    carrying = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    pronation = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    first = so3.exp(flexion[:, None] * Z)
    second = first @ so3.exp(carrying[:, None] * X)
    axes = np.stack([np.broadcast_to(Z, (len(flexion), 3)), first @ X, second @ Y], axis=-1)
    rates = np.linalg.solve(axes, forearm.omega[..., None])[..., 0]
    after_first = Z * rates[:, :1]
    after_second = after_first + axes[..., 1] * rates[:, 1:2]
    of_axes = np.cross(after_first, axes[..., 1]) * rates[:, 1:2] + np.cross(after_second, axes[..., 2]) * rates[:, 2:]
    accelerations = np.linalg.solve(axes, (forearm.alpha - of_axes)[..., None])[..., 0]
    angles: FloatArray = np.unwrap(np.stack([flexion, carrying, pronation], axis=1), axis=0)
    return angles, np.asarray(rates), np.asarray(accelerations)
