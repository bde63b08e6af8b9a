"""The frame of the plane of motion, and marker positions of a planar chain in it (eq. 3.18), with their Jacobian.

All quantities are in the plane frame, which is also the frame of the base (segment 0). Joint j (from 1) moves segment
j. Its centre in the frame of segment j - 1 is ``centres[j - 1]``, in m. The joint angles q, in rad, are right-handed
about z and relative to the previous segment.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import se3
from mocap_id.geometry.chain import Chain, Revolute


def rotate(angle: FloatArray, vector: FloatArray) -> FloatArray:
    """Rotate vectors (..., 2) in the plane by angles (...), rad (eq. 2.4)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    turned = np.empty((*np.broadcast_shapes(c.shape, x.shape), 2))
    turned[..., 0], turned[..., 1] = c * x - s * y, s * x + c * y
    return turned


def segment_poses(q: FloatArray, centres: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the angle (..., n + 1), rad, and the origin (..., n + 1, 2), m, of every segment frame, base first.

    The origin of segment j is the centre of joint j; angle and origin of the base are 0. The arguments q (..., n) and
    ``centres`` (..., n, 2) are described at the top of this module.
    """
    base = np.zeros((*q.shape[:-1], 1))
    angle = np.concatenate([base, np.cumsum(q, axis=-1)], axis=-1)
    steps = rotate(angle[..., :-1], centres)  # (..., n, 2) between consecutive origins
    origin = np.concatenate([np.zeros((*q.shape[:-1], 1, 2)), np.cumsum(steps, axis=-2)], axis=-2)
    return angle, origin


def marker_positions(q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return the positions of markers on the segments, (..., M, 2), m, in the plane frame (eq. 3.18).

    ``segment`` (M,) is the segment of each marker (0 is the base), and ``local`` (M, 2) are the marker's coordinates in
    the frame of this segment, m. The arguments q (..., n) and ``centres`` (n, 2) are described at the top of this
    module.
    """
    angle, origin = segment_poses(q, centres)
    return _place_markers(angle, origin, segment, local)


def marker_jacobian(q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return the derivatives of :func:`marker_positions` with respect to the joint angles, (..., M, 2, n), m/rad.

    Column j - 1 is z × (marker - joint j) for the markers beyond joint j, and zero for the others. This is the spatial
    Jacobian (eq. 2.47) applied to the markers. Parameters are as for :func:`marker_positions`.
    """
    angle, origin = segment_poses(q, centres)
    position = _place_markers(angle, origin, segment, local)
    jacobian = np.zeros((*position.shape, len(centres)))
    for j in range(len(centres)):
        moved = segment > j
        arm = position[..., moved, :] - origin[..., j + 1, None, :]
        jacobian[..., moved, 0, j], jacobian[..., moved, 1, j] = -arm[..., 1], arm[..., 0]
    return jacobian


def _place_markers(angle: FloatArray, origin: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return marker positions (..., M, 2) from segment poses; sine and cosine are computed once for each segment."""
    c, s = np.cos(angle)[..., segment], np.sin(angle)[..., segment]
    x, y = local[:, 0], local[:, 1]
    position = np.empty((*c.shape, 2))
    position[..., 0] = origin[..., segment, 0] + (c * x - s * y)
    position[..., 1] = origin[..., segment, 1] + (s * x + c * y)
    return position


def joint_twists(q: FloatArray, centres: FloatArray) -> FloatArray:
    """Return the unit twists of all joints, the rows v_x, v_y, ω_z of the spatial Jacobian, (..., 3, n) (eq. 2.47).

    Column j - 1 is the twist (p_y, -p_x, 1) of joint j in the plane frame, in which its position is p. The product of
    this column and a wrench (Fx, Fy, tauz) about the origin is the moment of the wrench about the joint. Parameters are
    as for :func:`segment_poses`.
    """
    _, origin = segment_poses(q, centres)
    x, y = origin[..., 1:, 0], origin[..., 1:, 1]
    return np.stack([y, -x, np.ones_like(x)], axis=-2)


def spatial_chain(centres: FloatArray) -> Chain:
    """Return a planar chain as a chain in SE(3), with hinges about z at the centres (n, 2), m."""
    placements = se3.pose(np.eye(3), np.column_stack([centres, np.zeros(len(centres))]))
    return Chain(tuple(Revolute((0.0, 0.0, 1.0)) for _ in centres), placements)


@dataclass(frozen=True)
class PlaneFrame:
    """Coordinate frame of a vertical plane in a lab whose Z axis points up.

    Examples
    --------
    >>> frame = PlaneFrame(np.pi / 2, np.array([1.0, 0.0, 0.0]))
    >>> frame.to_plane(np.array([1.0, 2.0, 3.0])).round(9) + 0.0
    array([2., 3., 0.])
    """

    yaw: float  # angle about the vertical from the lab's X axis to the plane's x axis, rad
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,) in the lab, m

    @property
    def axes(self) -> FloatArray:
        """Axes of the frame in the lab as rows, (3, 3)."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])

    def to_plane(self, points: FloatArray) -> FloatArray:
        """Transform points (..., 3), m, from the lab to the plane frame."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def from_plane(self, points: FloatArray) -> FloatArray:
        """Transform points (..., 3), m, from the plane frame to the lab; the inverse of :meth:`to_plane`."""
        return np.asarray(points @ self.axes + self.origin)

    def wrench_to_plane(self, force: FloatArray, moment: FloatArray) -> FloatArray:
        """Return the components Fx, Fy (N) and tauz (N·m) of a wrench in the plane, (..., 3).

        Force and moment (..., 3) are in lab axes, with the moment about the lab's origin. The moment tauz is about the
        origin of the plane frame.
        """
        about = moment - np.cross(self.origin, force)
        return np.concatenate([force @ self.axes[:2].T, (about @ self.axes[2])[..., None]], axis=-1)
