"""The joint protocol, the revolute joint and the ball joint.

A joint moves its link along constant twists ξ_k in the joint frame. The pose of the link in the joint frame is exp(Σ
ξ_k q_k) with the coordinates q. All standard joints (hinge, slider, screw, ball and so on) have this form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3

_SMALL = 0.05  # rad; the series are accurate to rounding below this angle, and the closed forms above it


class Joint(Protocol):
    """Protocol of a joint: the members that :class:`mocap_id.geometry.chain.Chain` uses."""

    @property
    def dimension(self) -> int:
        """Number of coordinates d."""

    @property
    def twists(self) -> FloatArray:
        """Twists ξ_k of the coordinates in the joint frame, (6, d)."""

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the matrix S(q), (..., 6, d); S(q) q̇ is the body velocity of the link in the joint frame."""

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the time derivative of :meth:`subspace`, (..., 6, d), from coordinates and rates (..., d)."""


@dataclass(frozen=True)
class Revolute:
    """Hinge: rotation about an axis through the origin of the joint frame.

    The axis (x, y, z) is scaled to unit length. A ValueError is raised if it is zero or not finite.
    """

    axis: tuple[float, float, float]

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.axis))
        if not 0 < length < np.inf:
            raise ValueError(f"the axis of a revolute joint is {self.axis}; expected a finite, non-zero vector")
        object.__setattr__(self, "axis", tuple(float(x) / length for x in self.axis))

    @property
    def dimension(self) -> int:
        return 1

    @property
    def twists(self) -> FloatArray:
        return np.concatenate([np.zeros(3), self.axis])[:, None]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the twist of the axis, (..., 6, 1), which does not depend on the angle (eq. 2.49)."""
        return np.broadcast_to(self.twists, (*q.shape[:-1], 6, 1))

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return zeros, because :meth:`subspace` is constant."""
        return np.zeros((*q.shape[:-1], 6, 1))


@dataclass(frozen=True)
class Ball:
    """Ball joint: any rotation about the origin of the joint frame. Its coordinates are a rotation vector, rad."""

    @property
    def dimension(self) -> int:
        return 3

    @property
    def twists(self) -> FloatArray:
        return np.eye(6)[:, 3:]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return the matrix S(q), (..., 6, 3): three rows of zeros above the right Jacobian 1 - a q̂ + b q̂².

        The factors a and b are those of :func:`_jacobian_coefficients`. The right Jacobian times q̇ is the angular
        velocity of the link in its own frame (Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol.
        2, 10.86).
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
    """Return matrices (..., 6, 3): three rows of zeros above the matrices ``rotation`` (..., 3, 3)."""
    return np.concatenate([np.zeros_like(rotation), rotation], axis=-2)


def _jacobian_coefficients(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a = (1 - cos θ)/θ², b = (θ - sin θ)/θ³, (da/dθ)/θ and (db/dθ)/θ at the angles θ."""
    sine, a = so3.exp_coefficients(angle)
    square = angle**2
    small = angle < _SMALL
    safe = np.where(small, 1.0, square)
    b = np.where(small, 1 / 6 - square / 120 + square**2 / 5040 - square**3 / 362880, (1 - sine) / safe)
    da = np.where(small, -1 / 12 + square / 180 - square**2 / 6720 + square**3 / 453600, (sine - 2 * a) / safe)
    db = np.where(small, -1 / 60 + square / 1260 - square**2 / 60480 + square**3 / 4989600, (a - 3 * b) / safe)
    return a, b, da, db
