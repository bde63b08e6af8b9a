"""Arms: chains with a tip, and the forward map of eq. 7.1, in the plane and in space."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import Chain, se3
from mocap_id.geometry.planar import rotate, segment_poses


@dataclass(frozen=True)
class PlanarArm:
    """A planar chain of n revolute joints with a point on its last segment: the tip."""

    centres: FloatArray  # (n, 2) centre of each joint in the coordinate frame of the previous segment, m
    tip: FloatArray  # (2,) position of the tip in the frame of the last segment, m
    centre_covariance: FloatArray  # (n, 2, 2) covariance of each centre, m²
    tip_covariance: FloatArray  # (2, 2) covariance of the tip, m²

    @classmethod
    def exact(cls, centres: FloatArray, tip: FloatArray) -> PlanarArm:
        """Return an arm with exact dimensions."""
        return cls(centres, tip, np.zeros((len(centres), 2, 2)), np.zeros((2, 2)))

    @property
    def joints(self) -> int:
        """Number of joint angles n."""
        return len(self.centres)

    @property
    def dimension(self) -> int:
        """Dimension of the space in which the tip moves."""
        return 2

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 2) of the tip, m, in postures (..., n), rad (eq. 3.18)."""
        angle, origin = segment_poses(q, self.centres)
        return np.asarray(origin[..., -1, :] + rotate(angle[..., -1], self.tip))

    def perturbed_pairs(self) -> list[tuple[PlanarArm, PlanarArm]]:
        """Return two arms for each uncertain dimension, which is one standard deviation larger or smaller in them.

        Centres and tip are displaced along the principal axes of their covariances. The first centre is not displaced,
        because it only moves the whole workspace.
        """
        pairs: list[tuple[PlanarArm, PlanarArm]] = []
        for j in range(1, len(self.centres)):
            for step in _principal_axes(self.centre_covariance[j]):
                moved = np.zeros_like(self.centres)
                moved[j] = step
                pairs.append((replace(self, centres=self.centres + moved), replace(self, centres=self.centres - moved)))
        tips = ((self.tip + step, self.tip - step) for step in _principal_axes(self.tip_covariance))
        pairs.extend((replace(self, tip=above), replace(self, tip=below)) for above, below in tips)
        return pairs


@dataclass(frozen=True)
class SpatialArm:
    """A chain in space with exact dimensions and a point on its last link: the tip."""

    chain: Chain
    tip: FloatArray  # (3,) position of the tip in the frame of the last link, m

    @property
    def joints(self) -> int:
        """Number of joint angles n."""
        return self.chain.dimension

    @property
    def dimension(self) -> int:
        """Dimension of the space in which the tip moves."""
        return 3

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 3) of the tip in the world frame, m, in postures (..., n), rad (eq. 2.37)."""
        point = np.broadcast_to(self.tip, (*q.shape[:-1], 3))
        relative = self.chain.relative_poses(q)
        for i in reversed(range(len(self.chain.joints))):
            point = se3.act(relative[..., i, :, :], point)
        return point

    def perturbed_pairs(self) -> list[tuple[SpatialArm, SpatialArm]]:
        """Return no arms, because the dimensions are exact."""
        return []


Arm: TypeAlias = PlanarArm | SpatialArm
"""A chain with a tip, in the plane or in space."""


def _principal_axes(covariance: FloatArray) -> FloatArray:
    """Return the principal axes (K, 2) with positive variance; the length of each is its standard deviation."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 0
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)
