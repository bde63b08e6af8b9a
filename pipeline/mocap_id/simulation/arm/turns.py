"""Rotations with exact angular velocity and acceleration, composed of turns about known axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Turn:
    """A turn about an axis of the frame that the turns before it reach.

    Parameters
    ----------
    axis : (3,) array
        Unit vector.
    angle, rate, acceleration : (F,) arrays
        rad, rad/s, rad/s².
    """

    axis: FloatArray
    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class Attitude:
    """Attitude of a frame over time.

    Parameters
    ----------
    rotation : (F, 3, 3) array
        Frame to reference.
    omega, alpha : (F, 3) arrays
        Angular velocity and acceleration in the axes of the reference, rad/s and rad/s².
    """

    rotation: FloatArray
    omega: FloatArray
    alpha: FloatArray

    def turned(self, turns: Iterable[Turn]) -> Attitude:
        """Return the attitude after the given turns."""
        rotation, omega, alpha = self.rotation, self.omega, self.alpha
        for turn in turns:
            axis = rotation @ turn.axis
            rate = turn.rate[:, None]
            alpha = alpha + np.cross(omega, axis) * rate + axis * turn.acceleration[:, None]
            omega = omega + axis * rate
            rotation = rotation @ so3.exp(turn.angle[:, None] * turn.axis)
        return Attitude(rotation, omega, alpha)


def still(rotation: FloatArray, frames: int) -> Attitude:
    """Return a constant attitude (3, 3) at ``frames`` frames."""
    zero = np.zeros((frames, 3))
    return Attitude(np.broadcast_to(rotation, (frames, 3, 3)), zero, zero)


def fixed(axis: FloatArray, angle: float, frames: int) -> Turn:
    """Return a turn by a constant angle, rad."""
    zero = np.zeros(frames)
    return Turn(axis, np.full(frames, angle), zero, zero)


def elbow_angles(relative: Attitude) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return flexion, carrying angle and pronation, their rates and their accelerations.

    Parameters
    ----------
    relative : Attitude
        Forearm in the upper arm: ``R_z(flexion) R_x(carrying) R_y(pronation)``.

    Returns
    -------
    angles, rates, accelerations : (F, 3) arrays
        rad, rad/s, rad/s².
    """
    rotation = relative.rotation
    flexion = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    carrying = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    pronation = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    first = so3.exp(flexion[:, None] * Z)
    second = first @ so3.exp(carrying[:, None] * X)
    axes = np.stack([np.broadcast_to(Z, (len(flexion), 3)), first @ X, second @ Y], axis=-1)
    rates = np.linalg.solve(axes, relative.omega[..., None])[..., 0]
    after_first = Z * rates[:, :1]
    after_second = after_first + axes[..., 1] * rates[:, 1:2]
    moving = np.cross(after_first, axes[..., 1]) * rates[:, 1:2] + np.cross(after_second, axes[..., 2]) * rates[:, 2:]
    accelerations = np.linalg.solve(axes, (relative.alpha - moving)[..., None])[..., 0]
    angles: FloatArray = np.unwrap(np.stack([flexion, carrying, pronation], axis=1), axis=0)
    return angles, np.asarray(rates), np.asarray(accelerations)
