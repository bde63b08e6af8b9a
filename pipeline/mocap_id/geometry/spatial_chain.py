"""Chains of rigid segments in space, connected by ball joints, two-axis joints and hinges.

Segment 0 is the base, which may move freely. Every other segment has one joint with its parent, and the centre of this
joint is the origin of the segment's frame. The pose of a segment in the frame of its parent is

    rotation  R = exp(a q1) O exp(b q2)        hinge: q2 = 0; ball: any rotation
    origin    c + u(R) g                       u(R) = (1 - cos elevation) / 2

The axis a, the constant rotation O, the centre c and the glide g are in the parent's frame, and the axis b is in the
child's frame. The glide is the translation of the shoulder girdle; it is zero for most joints. The elevation is the
angle between the direction ``rest`` (parent's frame) and the ``long_axis`` (child's frame).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3

JointKind: TypeAlias = Literal["ball", "two-axis", "hinge"]
DIMENSION: dict[JointKind, int] = {"ball": 3, "two-axis": 2, "hinge": 1}
"""Number of coordinates of each kind of joint."""
LEAST_TWIST = 0.1
"""Lower limit of 1 + cos(swing angle) in the rate of the axial rotation; a swing angle of 154° reaches this limit."""


def _new(values: FloatArray | list[float]) -> Callable[[], FloatArray]:
    """Return the default factory of a dataclass field: a function that returns a new array with these values."""
    return lambda: np.array(values)


@dataclass(frozen=True)
class SpatialJoint:
    """Joint between a segment and its parent. Covariances are NaN if unknown; axes and centre are 3-vectors."""

    kind: JointKind
    parent: int  # number of the parent segment, smaller than the number of the child
    centre: FloatArray  # centre without glide in the parent's frame, m
    covariance: FloatArray = field(default_factory=_new(np.full((3, 3), np.nan)))  # covariance of the centre, m²
    first_axis: FloatArray = field(default_factory=_new([0.0, 0.0, 1.0]))  # unit axis a in the parent's frame
    second_axis: FloatArray = field(default_factory=_new([0.0, 0.0, 1.0]))  # unit axis b in the child's frame
    axes_covariance: FloatArray = field(default_factory=_new(np.full((2, 3, 3), np.nan)))  # covariance of each axis
    offset: FloatArray = field(default_factory=_new(np.eye(3)))  # constant rotation O (hinge, two-axis)
    glide: FloatArray = field(default_factory=_new(np.zeros(3)))  # translation g at an elevation of 180°, m
    glide_covariance: FloatArray = field(default_factory=_new(np.zeros((3, 3))))  # m²
    rest: FloatArray = field(default_factory=_new([0.0, 1.0, 0.0]))  # direction of zero elevation in the parent's frame
    long_axis: FloatArray = field(default_factory=_new([0.0, 1.0, 0.0]))  # axis of axial rotation in the child's frame
    untwisted: FloatArray = field(default_factory=_new(np.eye(3)))  # rotation of the joint without axial rotation
    known: bool = True  # False if the motion does not determine the centre, which then has no meaning
    slide_sd: float = 0.0  # standard deviation of the slide of marker clusters at the joint along each axis, m

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return DIMENSION[self.kind]

    def rotation(self, q: FloatArray) -> FloatArray:
        """Return the child's rotation in the parent's frame (..., 3, 3) from the coordinates (..., d), rad.

        The coordinates of a ball joint are a rotation vector.
        """
        if self.kind == "ball":
            return so3.exp(q)
        turned = so3.exp(q[..., :1] * self.first_axis) @ self.offset
        return turned if self.kind == "hinge" else turned @ so3.exp(q[..., 1:2] * self.second_axis)

    def twist(self, rotation: FloatArray) -> FloatArray:
        """Return the axial rotation (...,) about the long axis, in (-π, π], rad, of a child's rotation (..., 3, 3)."""
        quaternion = so3.quaternion(self.untwisted.T @ rotation)
        angle = 2 * np.arctan2(quaternion[..., 1:] @ self.long_axis, quaternion[..., 0])
        return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)

    def twist_axis(self, rotation: FloatArray) -> FloatArray:
        """Return the vector (..., 3) whose dot product with the joint's angular velocity is the rate of axial rotation.

        All vectors are in the child's axes. With the long axis l, and the direction l' that this axis has in the pose
        ``untwisted``, the vector is (l + l') / (1 + l · l'). The axial rotation is measured from the shortest swing of
        the long axis, so a swing in a changing direction also changes it. The denominator is limited
        (:data:`LEAST_TWIST`), because the vector grows without bound where the segment points almost backwards.
        """
        rest = np.swapaxes(rotation, -1, -2) @ (self.untwisted @ self.long_axis)
        size = np.maximum(1.0 + rest @ self.long_axis, LEAST_TWIST)
        return np.asarray((self.long_axis + rest) / size[..., None])

    def origin(self, rotation: FloatArray) -> FloatArray:
        """Return the child's origin in the parent's frame (..., 3), m, from the child's rotation (..., 3, 3)."""
        share = (1 - np.einsum("i,...ij,j->...", self.rest, rotation, self.long_axis)) / 2
        return np.asarray(self.centre + share[..., None] * self.glide)


@dataclass(frozen=True)
class SpatialChain:
    """Tree of segments (in most cases a chain) with its markers."""

    joints: tuple[SpatialJoint, ...]  # joint k - 1 connects segment k with its parent
    segment: IntArray  # (M,) segment of each marker, 0 … n
    local: FloatArray  # (M, 3) marker coordinates in the frames of their segments, m
    on_glide: BoolArray  # (M,) markers of segment 0 that move with the glide of the first joint, such as AC
    # (M,) fraction of the segment's axial rotation that the skin under each marker does not follow; empty if always 0
    skin: FloatArray = field(default_factory=lambda: np.zeros(0))
    skin_sd: FloatArray = field(default_factory=lambda: np.zeros(0))  # (M,) standard deviation of this fraction

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent of each moving segment."""
        return tuple(joint.parent for joint in self.joints)

    def place(self, origin: FloatArray, rotation: FloatArray, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return origins (F, n + 1, 3), m, and rotations (F, n + 1, 3, 3) of all segments in the trial.

        The pose of the base in the trial is given by ``origin`` (F, 3), m, and ``rotation`` (F, 3, 3). ``joints`` (F,
        n, 3, 3) are the rotations of all joints, child to parent.
        """
        origins, rotations = [origin], [rotation]
        for k, joint in enumerate(self.joints):
            base = rotations[joint.parent]
            step = joint.origin(joints[:, k])
            origins.append(origins[joint.parent] + np.einsum("fij,fj->fi", base, step))
            rotations.append(base @ joints[:, k])
        return np.stack(origins, axis=1), np.stack(rotations, axis=1)


def change_frames(chain: SpatialChain, rotations: FloatArray, origin: FloatArray) -> SpatialChain:
    """Return the same chain with other axes of every segment frame and another origin of the base frame.

    The origins of the moving segments stay the centres of their joints. The joint coordinates and the marker positions
    in the trial do not change. The rotation R of a joint becomes N_parentᵀ R N_child, where N are the matrices
    ``rotations`` (n + 1, 3, 3): the new axes of each segment frame as columns in its present frame. ``origin`` (3,) is
    the new origin of the base frame in its present frame, m.

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
    joints = []
    for k, joint in enumerate(chain.joints, 1):
        parent, child = rotations[joint.parent], rotations[k]
        first, second = joint.axes_covariance
        moved = replace(
            joint,
            centre=parent.T @ (joint.centre - origins[joint.parent]),
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
        joints.append(moved)
    local = np.einsum("mji,mj->mi", rotations[chain.segment], chain.local - origins[chain.segment])
    return replace(chain, joints=tuple(joints), local=local)
