"""What a joint is: a small protocol, and the revolute joint.

A joint moves its link along constant twists, expressed in the joint's own frame and with exponential coordinates q:
the pose of the link in the joint frame is exp(Σ ξ_k q_k). Every lower pair fits, each in a file of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray


class Joint(Protocol):
    """What :class:`mocap_id.geometry.chain.Chain` asks of a joint."""

    @property
    def dimension(self) -> int:
        """Number of coordinates d."""
        ...

    @property
    def twists(self) -> FloatArray:
        """(6, d) array: the twists ξ_k, in the joint frame."""
        ...

    def subspace(self, q: FloatArray) -> FloatArray:
        """(..., 6, d) array S: the link's body velocity relative to the joint frame is S(q) q̇."""
        ...

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """(..., 6, d) array: the time derivative of :meth:`subspace`."""
        ...


@dataclass(frozen=True)
class Revolute:
    """Rotation about one axis through the origin of the joint frame.

    Parameters
    ----------
    axis : (x, y, z)
        Direction of the axis in the joint frame; scaled to unit length.

    Raises
    ------
    ValueError
        The axis is zero or not finite.
    """

    axis: tuple[float, float, float]

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.axis))
        if not 0 < length < np.inf:
            raise ValueError(f"the axis of a revolute joint is {self.axis}; expected a finite vector that is not zero")
        object.__setattr__(self, "axis", tuple(float(x) / length for x in self.axis))

    @property
    def dimension(self) -> int:
        return 1

    @property
    def twists(self) -> FloatArray:
        return np.concatenate([np.zeros(3), self.axis])[:, None]

    def subspace(self, q: FloatArray) -> FloatArray:
        """Constant: a single twist commutes with its own exponential (eq. 2.49)."""
        return np.broadcast_to(self.twists, (*q.shape[:-1], 6, 1))

    def subspace_rate(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Zero, see :meth:`subspace`."""
        return np.zeros((*q.shape[:-1], 6, 1))
