"""Rotations with exact angular velocity and acceleration, composed of rotations about given axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

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


def constant_rotation(axis: FloatArray, angle: float, frames: int) -> AxisRotation:
    """Return a rotation by a constant angle, rad, at ``frames`` frames."""
    zero = np.zeros(frames)
    return AxisRotation(axis, np.full(frames, angle), zero, zero)


def elbow_angles(forearm: Attitude) -> tuple[FloatArray, FloatArray, FloatArray]:
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
