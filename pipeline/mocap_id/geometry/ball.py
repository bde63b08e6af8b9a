"""The ball joint: any rotation about the origin of the joint frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

_SMALL = 0.05  # rad; below this angle the series are exact to rounding, above it the closed forms are


@dataclass(frozen=True)
class Ball:
    """Rotation about a point; its coordinates are a rotation vector, rad."""

    @property
    def dimension(self) -> int:
        return 3

    @property
    def twists(self) -> FloatArray:
        return np.eye(6)[:, 3:]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return S (..., 6, 3): zeros, and the right Jacobian 1 - a q̂ + b q̂² of the exponential.

        The angular velocity of the link in its own frame is the right Jacobian times q̇ (Chirikjian, Stochastic Models,
        Information Theory, and Lie Groups, vol. 2, 10.86).
        """
        a, b, _, _ = _jacobian_coefficients(np.linalg.norm(q, axis=-1)[..., None, None])
        cross = so3.hat(q)
        return _stack_below_zeros(np.eye(3) - a * cross + b * cross @ cross)

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the time derivative of :meth:`subspace`, (..., 6, 3)."""
        a, b, da, db = _jacobian_coefficients(np.linalg.norm(q, axis=-1)[..., None, None])
        cross, change = so3.hat(q), so3.hat(dq)
        along = np.sum(q * dq, axis=-1)[..., None, None]  # θ dθ/dt
        square = cross @ change + change @ cross
        return _stack_below_zeros(along * (db * cross @ cross - da * cross) - a * change + b * square)


def _stack_below_zeros(rotation: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros_like(rotation), rotation], axis=-2)


def _jacobian_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a = (1 - cos θ)/θ², b = (θ - sin θ)/θ³, and the derivatives of both by θ, divided by θ."""
    sine, a = so3.exp_coefficients(angle)
    square = angle**2
    small = angle < _SMALL
    safe = np.where(small, 1.0, square)
    b = np.where(small, 1 / 6 - square / 120 + square**2 / 5040 - square**3 / 362880, (1 - sine) / safe)
    da = np.where(small, -1 / 12 + square / 180 - square**2 / 6720 + square**3 / 453600, (sine - 2 * a) / safe)
    db = np.where(small, -1 / 60 + square / 1260 - square**2 / 60480 + square**3 / 4989600, (a - 3 * b) / safe)
    return a, b, da, db
