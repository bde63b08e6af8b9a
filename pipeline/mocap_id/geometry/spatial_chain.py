"""Chains of rigid segments in space, joined by balls, two-axis joints and hinges.

Segment 0 is the base, which may move freely. Every other segment has one joint to its parent; the origin of its frame
is the centre of this joint. The pose of a segment in the frame of its parent is

    rotation  R = exp(a q1) O exp(b q2)        hinge: q2 = 0; ball: any rotation
    origin    c + u(R) g                       u(R) = (1 - cos elevation) / 2

with the axis a, the constant rotation O, the centre c and the glide g in the parent's frame, and the axis b in the
child's frame. The glide is the translation of the shoulder girdle; it is zero for most joints. The elevation is the
angle between the direction ``rest`` (parent's frame) and the ``long_axis`` (child's frame).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3

JointKind: TypeAlias = Literal["ball", "two-axis", "hinge"]
DIMENSION: dict[JointKind, int] = {"ball": 3, "two-axis": 2, "hinge": 1}
"""Number of coordinates of each kind."""

_Z = (0.0, 0.0, 1.0)


def _zeros() -> FloatArray:
    return np.zeros(3)


def _down() -> FloatArray:
    return np.array([0.0, 1.0, 0.0])


LEAST_TWIST = 0.1
"""Least 1 + cos of the swing with which the rate of a twist is computed; the cosine is -0.9 at 154°."""


@dataclass(frozen=True)
class SpatialJoint:
    """The joint between a segment and its parent.

    Parameters
    ----------
    kind : {"ball", "two-axis", "hinge"}
    parent : int
        Number of the parent segment; smaller than the child's.
    centre : (3,) array
        Centre in the parent's frame without glide, m.
    covariance : (3, 3) array
        Covariance of the centre, m²; NaN where it is unknown.
    first_axis : (3,) array
        Unit axis a in the parent's frame (hinge, two-axis).
    second_axis : (3,) array
        Unit axis b in the child's frame (two-axis).
    axes_covariance : (2, 3, 3) array
        Covariance of both unit axes; NaN where there is no axis.
    offset : (3, 3) array
        The constant rotation O (hinge, two-axis).
    glide : (3,) array
        Translation g of the centre in the parent's frame at an elevation of 180°, m.
    glide_covariance : (3, 3) array
    rest, long_axis : (3,) arrays
        Directions between which the elevation of the glide is measured: in the parent's and in the child's frame. The
        skin's twist is about the long axis.
    untwisted : (3, 3) array
        Rotation of the joint at which the skin of the child does not twist.
    known : bool
        False if the motion does not show the centre; then the centre has no meaning.
    slide_sd : float
        Standard deviation, along each axis, of the slide of whole marker clusters on the bones beside the joint, m; 0
        if only single markers slide.
    """

    kind: JointKind
    parent: int
    centre: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))
    first_axis: FloatArray = field(default_factory=lambda: np.array(_Z))
    second_axis: FloatArray = field(default_factory=lambda: np.array(_Z))
    axes_covariance: FloatArray = field(default_factory=lambda: np.full((2, 3, 3), np.nan))
    offset: FloatArray = field(default_factory=lambda: np.eye(3))
    glide: FloatArray = field(default_factory=_zeros)
    glide_covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    rest: FloatArray = field(default_factory=_down)
    long_axis: FloatArray = field(default_factory=_down)
    untwisted: FloatArray = field(default_factory=lambda: np.eye(3))
    known: bool = True
    slide_sd: float = 0.0

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return DIMENSION[self.kind]

    def rotation(self, q: FloatArray) -> FloatArray:
        """Return the child's rotation in the parent's frame (..., 3, 3) for coordinates (..., d), rad.

        The coordinates of a ball are a rotation vector.
        """
        if self.kind == "ball":
            return so3.exp(q)
        turned = so3.exp(q[..., :1] * self.first_axis) @ self.offset
        return turned if self.kind == "hinge" else turned @ so3.exp(q[..., 1:2] * self.second_axis)

    def twist(self, rotation: FloatArray) -> FloatArray:
        """Return the child's twist (...,) about its long axis, rad, in (-π, π], for its rotation (..., 3, 3)."""
        quaternion = so3.quaternion(self.untwisted.T @ rotation)
        angle = 2 * np.arctan2(quaternion[..., 1:] @ self.long_axis, quaternion[..., 0])
        return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)

    def twist_axis(self, rotation: FloatArray) -> FloatArray:
        """Return the vector (..., 3), in the child's axes, whose product with the joint's velocity is the twist's rate.

        With the long axis l and the direction l' that it has without swing, both in the child's axes, it is
        (l + l') / (1 + l · l'): the twist is that of the shortest swing, so a swing that turns also changes it. Where
        the segment points almost backwards, the rate has no limit; there it is reduced.
        """
        rest = np.swapaxes(rotation, -1, -2) @ (self.untwisted @ self.long_axis)
        size = np.maximum(1.0 + rest @ self.long_axis, LEAST_TWIST)
        return np.asarray((self.long_axis + rest) / size[..., None])

    def origin(self, rotation: FloatArray) -> FloatArray:
        """Return the child's origin in the parent's frame (..., 3), m, for its rotation (..., 3, 3)."""
        share = (1 - np.einsum("i,...ij,j->...", self.rest, rotation, self.long_axis)) / 2
        return np.asarray(self.centre + share[..., None] * self.glide)


@dataclass(frozen=True)
class SpatialChain:
    """A tree of segments, in most cases a chain, with its markers.

    Parameters
    ----------
    joints : tuple of SpatialJoint, length n
        Joint k - 1 leads to segment k.
    segment : (M,) int array
        Segment of each marker, 0 … n.
    local : (M, 3) array
        Marker coordinates in the frames of their segments, m.
    on_glide : (M,) bool array
        Markers of segment 0 that move with the glide of the first joint, such as AC on the shoulder girdle.
    skin, skin_sd : (M,) arrays
        Share of the twist of its segment that the skin under each marker misses, and its standard deviation; empty if
        all follow the bone.
    """

    joints: tuple[SpatialJoint, ...]
    segment: IntArray
    local: FloatArray
    on_glide: BoolArray
    skin: FloatArray = field(default_factory=lambda: np.zeros(0))
    skin_sd: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent of each moving segment."""
        return tuple(joint.parent for joint in self.joints)

    def place(self, origin: FloatArray, rotation: FloatArray, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the poses of all segments.

        Parameters
        ----------
        origin, rotation : (F, 3) and (F, 3, 3) arrays
            Pose of the base in the frame of the trial, m.
        joints : (F, n, 3, 3) array
            Rotation of every joint, child to parent.

        Returns
        -------
        origins : (F, n + 1, 3) array
            In the frame of the trial, m.
        rotations : (F, n + 1, 3, 3) array
            Segment to trial.
        """
        origins, rotations = [origin], [rotation]
        for k, joint in enumerate(self.joints):
            base = rotations[joint.parent]
            step = joint.origin(joints[:, k])
            origins.append(origins[joint.parent] + np.einsum("fij,fj->fi", base, step))
            rotations.append(base @ joints[:, k])
        return np.stack(origins, axis=1), np.stack(rotations, axis=1)
