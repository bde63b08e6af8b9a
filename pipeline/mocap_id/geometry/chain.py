"""A serial chain in SE(3): poses, product of exponentials and Jacobians (thesis 2.3.1, 2.3.2).

Link 0 is the base and its frame is the world frame. Joint i (from 1) moves link i, and frame i moves with link i. The
coordinates q (..., N) concatenate those of the joints from base to tip. Any leading axes are allowed.
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
    """Serial chain: joints and their placements.

    Parameters
    ----------
    joints : tuple of Joint, length n
        From base to tip.
    placements : (n, 4, 4) array
        Pose of each joint's frame in the frame of the link before it: g_{i-1,i} at q = 0.

    Raises
    ------
    ValueError
        There are not as many placements as joints.
    """

    joints: tuple[Joint, ...]
    placements: FloatArray

    def __post_init__(self) -> None:
        if self.placements.shape != (len(self.joints), 4, 4):
            raise ValueError(
                f"a chain of {len(self.joints)} joints needs placements of shape ({len(self.joints)}, 4, 4), "
                f"not {self.placements.shape}"
            )

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slice of q with the coordinates of each joint."""
        ends = np.cumsum([joint.dimension for joint in self.joints]).tolist()
        return tuple(slice(end - joint.dimension, end) for end, joint in zip(ends, self.joints, strict=True))

    @cached_property
    def dimension(self) -> int:
        """Number of coordinates N."""
        return sum(joint.dimension for joint in self.joints)

    @cached_property
    def home(self) -> FloatArray:
        """Pose g_{W,i} of every link at q = 0, (n, 4, 4)."""
        poses = [np.eye(4)]
        for placement in self.placements:
            poses.append(poses[-1] @ placement)
        return np.stack(poses[1:]) if self.joints else np.zeros((0, 4, 4))

    def relative_poses(self, q: FloatArray) -> FloatArray:
        """Return the pose g_{i-1,i}(q) of every link in the previous frame, (..., n, 4, 4) (eq. 2.29, 2.41)."""
        moved = [
            placement @ se3.exp(q[..., part] @ joint.twists.T)
            for joint, placement, part in zip(self.joints, self.placements, self.slices, strict=True)
        ]
        return np.stack(moved, axis=-3)

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the pose g_{W,i}(q) of every link including the base, (..., n + 1, 4, 4) (eq. 2.37)."""
        relative = self.relative_poses(q)
        poses = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
        for i in range(len(self.joints)):
            poses.append(poses[-1] @ relative[..., i, :, :])
        return np.stack(poses, axis=-3)

    def tool_pose(self, q: FloatArray, tool: FloatArray) -> FloatArray:
        """Return the pose (..., 4, 4) of a tool whose pose in the last link's frame is ``tool`` (4, 4)."""
        return self.poses(q)[..., -1, :, :] @ tool


def spatial_exponentials(chain: Chain, q: FloatArray) -> FloatArray:
    """Return exp(ξ^W q_i) of every joint, with its twists in the world frame at q = 0, (..., n, 4, 4) (eq. 2.38)."""
    factors = [
        se3.exp(q[..., part] @ (se3.Ad(home) @ joint.twists).T)
        for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True)
    ]
    return np.stack(factors, axis=-3)


def spatial_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the pose of a tool by the product of exponentials in spatial form (eq. 2.39, 2.40).

    Parameters
    ----------
    chain : Chain
    q : (..., N) array
    tool : (4, 4) array
        Pose of the tool frame in the last link's frame.

    Returns
    -------
    (..., 4, 4) array
        g_{W,T}(q).
    """
    g: FloatArray = np.eye(4)
    factors = spatial_exponentials(chain, q)
    for i in range(len(chain.joints)):
        g = g @ factors[..., i, :, :]
    at_home: FloatArray = chain.home[-1] @ tool
    return g @ at_home


def body_product(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the pose of a tool by the product of exponentials in body form (eq. 2.42).

    The twists are in the tool frame at q = 0. Parameters and result are those of :func:`spatial_product`.
    """
    at_home: FloatArray = chain.home[-1] @ tool
    g = at_home
    for joint, home, part in zip(chain.joints, chain.home, chain.slices, strict=True):
        to_tool = se3.Ad(se3.inverse(at_home) @ home)
        g = g @ se3.exp(q[..., part] @ (to_tool @ joint.twists).T)
    return g


def spatial_jacobian(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the spatial Jacobian of the last link (eq. 2.45, 2.47).

    Returns
    -------
    (..., 6, N) array
        Spatial twist of the last link per unit of q̇, world frame.
    """
    poses = chain.poses(q)
    columns = [
        se3.Ad(poses[..., i, :, :]) @ joint.subspace(q[..., part])
        for i, (joint, part) in enumerate(zip(chain.joints, chain.slices, strict=True), start=1)
    ]
    return np.concatenate(columns, axis=-1)


def body_jacobian(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """Return the body Jacobian of a tool on the last link (eq. 2.46; 2.48 with the primed twists).

    Returns
    -------
    (..., 6, N) array
        Body twist of the tool per unit of q̇, tool frame.
    """
    return se3.Ad(se3.inverse(chain.tool_pose(q, tool))) @ spatial_jacobian(chain, q)
