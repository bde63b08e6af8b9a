"""Arms: chains with a tip, and the forward map of eq. 7.1, in the plane and in space."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import Chain, se3
from mocap_id.geometry.planar import rotate, segment_poses


class Arm(Protocol):
    """A chain with a tip, whose dimensions may be uncertain."""

    @property
    def joints(self) -> int:
        """Number of joint angles n."""
        ...

    @property
    def dimension(self) -> int:
        """Dimension of the space in which the tip moves: 2 or 3."""
        ...

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., d) of the tip, m, in postures (..., n), rad."""
        ...

    def deviations(self) -> list[tuple[Arm, Arm]]:
        """Return two arms for each uncertain dimension: one standard deviation larger, and smaller."""
        ...


@dataclass(frozen=True)
class PlanarArm:
    """A planar chain of revolute joints with a point on its last segment.

    Parameters
    ----------
    centres : (n, 2) array
        Centre of each joint in the frame of the segment before it, m.
    tip : (2,) array
        In the frame of the last segment, m.
    centre_covariance : (n, 2, 2) array
        Covariance of each centre, m².
    tip_covariance : (2, 2) array
        Covariance of the tip, m².
    """

    centres: FloatArray
    tip: FloatArray
    centre_covariance: FloatArray
    tip_covariance: FloatArray

    @classmethod
    def exact(cls, centres: FloatArray, tip: FloatArray) -> PlanarArm:
        """Return an arm with exact dimensions."""
        return cls(centres, tip, np.zeros((len(centres), 2, 2)), np.zeros((2, 2)))

    @property
    def joints(self) -> int:
        return len(self.centres)

    @property
    def dimension(self) -> int:
        return 2

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 2) of the tip in the plane frame, m (eq. 3.18)."""
        angle, origin = segment_poses(q, self.centres)
        return np.asarray(origin[..., -1, :] + rotate(angle[..., -1], self.tip))

    def deviations(self) -> list[tuple[Arm, Arm]]:
        """Return arms displaced along the principal axes of the covariances of the centres and the tip.

        The first centre is not displaced, because it only moves the whole workspace.
        """
        found: list[tuple[Arm, Arm]] = []
        for j in range(1, len(self.centres)):
            for step in _axes(self.centre_covariance[j]):
                moved = np.zeros_like(self.centres)
                moved[j] = step
                found.append((replace(self, centres=self.centres + moved), replace(self, centres=self.centres - moved)))
        tips = ((self.tip + step, self.tip - step) for step in _axes(self.tip_covariance))
        found.extend((replace(self, tip=above), replace(self, tip=below)) for above, below in tips)
        return found


@dataclass(frozen=True)
class SpatialArm:
    """A chain in space with a point on its last link and exact dimensions.

    Parameters
    ----------
    chain : Chain
    tip : (3,) array
        In the frame of the last link, m.
    """

    chain: Chain
    tip: FloatArray

    @property
    def joints(self) -> int:
        return self.chain.dimension

    @property
    def dimension(self) -> int:
        return 3

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 3) of the tip in the world frame, m (eq. 2.37)."""
        point = np.broadcast_to(self.tip, (*q.shape[:-1], 3))
        relative = self.chain.relative_poses(q)
        for i in reversed(range(len(self.chain.joints))):
            point = se3.act(relative[..., i, :, :], point)
        return point

    def deviations(self) -> list[tuple[Arm, Arm]]:
        return []


def _axes(covariance: FloatArray) -> FloatArray:
    """Return the principal axes (K, 2) with positive variance; the length of each is its standard deviation."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 0
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)
