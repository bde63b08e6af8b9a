"""The joint protocol and the revolute joint.

A joint moves its link along constant twists ξ_k in the joint frame. The pose of the link in the joint frame is
exp(Σ ξ_k q_k), with the exponential coordinates q. Every lower pair has this form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray


class Joint(Protocol):
    """Members that :class:`mocap_id.geometry.chain.Chain` needs of a joint."""

    @property
    def dimension(self) -> int:
        """Number of coordinates d."""
        ...

    @property
    def twists(self) -> FloatArray:
        """Twists ξ_k in the joint frame, (6, d)."""
        ...

    def subspace(self, q: FloatArray) -> FloatArray:
        """Return S (..., 6, d): the body velocity of the link relative to the joint frame is S(q) q̇."""
        ...

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return the time derivative of :meth:`subspace`, (..., 6, d)."""
        ...


@dataclass(frozen=True)
class Revolute:
    """Rotation about one axis through the origin of the joint frame.

    Parameters
    ----------
    axis : (x, y, z)
        Direction of the axis in the joint frame; it is scaled to unit length.

    Raises
    ------
    ValueError
        The axis is zero or not finite.
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
        """Return the constant twist, which commutes with its own exponential (eq. 2.49)."""
        return np.broadcast_to(self.twists, (*q.shape[:-1], 6, 1))

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Return zeros, as :meth:`subspace` is constant."""
        return np.zeros((*q.shape[:-1], 6, 1))
