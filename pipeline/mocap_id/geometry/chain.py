"""Serial chains in SE(3): poses, product of exponentials and Jacobians (thesis 2.3.1, 2.3.2).

Link 0 is the base, and its frame is the world frame. Joint i (from 1) moves link i, and frame i is fixed to link i. The
coordinates q (..., N) are the coordinates of all joints in order from base to tip. Leading axes are optional.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import se3
from mocap_id.geometry.joints import Joint


@dataclass(frozen=True)
class Chain:
    """Serial chain of joints. The numbers of joints and placements must be equal (else a ValueError is raised)."""

    joints: tuple[Joint, ...]  # n joints from base to tip
    placements: FloatArray  # (n, 4, 4) pose g_{i-1,i} of each joint's frame in the previous link at q = 0

    def __post_init__(self) -> None:
        if self.placements.shape != (len(self.joints), 4, 4):
            raise ValueError(
                f"a chain of {len(self.joints)} joints needs placements of shape ({len(self.joints)}, 4, 4), "
                f"not {self.placements.shape}"
            )

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slice of q for each joint."""
        ends = np.cumsum([joint.dimension for joint in self.joints]).tolist()
        return tuple(slice(end - joint.dimension, end) for end, joint in zip(ends, self.joints, strict=True))

    @cached_property
    def dimension(self) -> int:
        """Number of coordinates N."""
        return sum(joint.dimension for joint in self.joints)

    @cached_property
    def home(self) -> FloatArray:
        """Poses g_{W,i} of all links at q = 0, (n, 4, 4)."""
        poses = [np.eye(4)]
        for placement in self.placements:
            poses.append(poses[-1] @ placement)
        return np.stack(poses[1:]) if self.joints else np.zeros((0, 4, 4))

    def relative_poses(self, q: FloatArray) -> FloatArray:
        """Return the pose g_{i-1,i}(q) of each link in the previous link, (..., n, 4, 4) (eq. 2.29, 2.41)."""
        moved = [
            placement @ se3.exp(q[..., part] @ joint.twists.T)
            for joint, placement, part in zip(self.joints, self.placements, self.slices, strict=True)
        ]
        return np.stack(moved, axis=-3)

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses g_{W,i}(q) of all links, including the base, (..., n + 1, 4, 4) (eq. 2.37)."""
        relative = self.relative_poses(q)
        poses = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
        for i in range(len(self.joints)):
            poses.append(poses[-1] @ relative[..., i, :, :])
        return np.stack(poses, axis=-3)

    def tool_pose(self, q: FloatArray, tool: FloatArray) -> FloatArray:
        """Return the world pose (..., 4, 4) of a tool from its pose ``tool`` (4, 4) in the frame of the last link."""
        return self.poses(q)[..., -1, :, :] @ tool


def spatial_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the world pose of a tool by the product of exponentials in spatial form, (..., 4, 4) (eq. 2.39, 2.40).

    The coordinates are q (..., N). ``tool`` (4, 4) is the pose of the tool frame in the frame of the last link.
    """
    g: FloatArray = np.eye(4)
    for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True):
        g = g @ se3.exp(q[..., part] @ (se3.Ad(home) @ joint.twists).T)
    at_home: FloatArray = chain.home[-1] @ tool
    return g @ at_home


def body_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the world pose of a tool by the product of exponentials in body form (eq. 2.42).

    The twists are in the tool frame at q = 0. Parameters and result are as for :func:`spatial_product`.
    """
    at_home: FloatArray = chain.home[-1] @ tool
    g = at_home
    for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True):
        to_tool = se3.Ad(se3.inverse(at_home) @ home)
        g = g @ se3.exp(q[..., part] @ (to_tool @ joint.twists).T)
    return g


def spatial_jacobian(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the spatial Jacobian of the last link, (..., 6, N), in the world frame (eq. 2.45, 2.47)."""
    poses = chain.poses(q)
    columns = [
        se3.Ad(poses[..., i, :, :]) @ joint.subspace(q[..., part])
        for i, (joint, part) in enumerate(zip(chain.joints, chain.slices, strict=True), start=1)
    ]
    return np.concatenate(columns, axis=-1)


def body_jacobian(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the body Jacobian of a tool on the last link, (..., 6, N), in the tool frame (eq. 2.46, 2.48)."""
    return se3.Ad(se3.inverse(chain.tool_pose(q, tool))) @ spatial_jacobian(chain, q)
