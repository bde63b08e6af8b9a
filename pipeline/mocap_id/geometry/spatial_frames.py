"""A chain in space, described in other segment frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint


def change_frames(chain: SpatialChain, rotations: FloatArray, origin: FloatArray) -> SpatialChain:
    """Return the same chain with other axes in every segment and another origin in the base.

    The origins of the moving segments stay the centres of their joints. The joints' coordinates q and the places of the
    markers in the frame of the trial do not change; the rotation of joint k becomes N_parentᵀ R N_child.

    Parameters
    ----------
    chain : SpatialChain
    rotations : (n + 1, 3, 3) array
        New axes N of each segment as columns, in its present frame.
    origin : (3,) array
        New origin of the base in its present frame, m.

    Examples
    --------
    >>> chain = SpatialChain(
    ...     (SpatialJoint("hinge", 0, np.array([0.1, 0, 0])),),
    ...     np.array([0, 1]),
    ...     np.array([[0.0, 0, 0], [0, 0.2, 0]]),
    ...     np.zeros(2, bool),
    ... )
    >>> moved = change_frames(chain, np.stack([np.eye(3)] * 2), np.array([0.1, 0, 0]))
    >>> moved.joints[0].centre.tolist(), moved.local[0].tolist()
    ([0.0, 0.0, 0.0], [-0.1, 0.0, 0.0])
    """
    origins = np.zeros((len(chain.joints) + 1, 3))
    origins[0] = origin
    local = np.einsum("mji,mj->mi", rotations[chain.segment], chain.local - origins[chain.segment])
    joints = tuple(
        _change_joint_frames(joint, rotations[joint.parent], rotations[k + 1], origins[joint.parent])
        for k, joint in enumerate(chain.joints)
    )
    return replace(chain, joints=joints, local=local)


def _change_joint_frames(
    joint: SpatialJoint, parent: FloatArray, child: FloatArray, origin: FloatArray
) -> SpatialJoint:
    """Return a joint in the new frames of its parent and its child."""
    first, second = joint.axes_covariance
    return replace(
        joint,
        centre=parent.T @ (joint.centre - origin),
        covariance=parent.T @ joint.covariance @ parent,
        first_axis=parent.T @ joint.first_axis,
        second_axis=child.T @ joint.second_axis,
        axes_covariance=np.stack([parent.T @ first @ parent, child.T @ second @ child]),
        offset=parent.T @ joint.offset @ child,
        glide=parent.T @ joint.glide,
        glide_covariance=parent.T @ joint.glide_covariance @ parent,
        rest=parent.T @ joint.rest,
        long_axis=child.T @ joint.long_axis,
        untwisted=parent.T @ joint.untwisted @ child,
    )
