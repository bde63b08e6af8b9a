"""Coordinate frame of the plane of motion: x along the motion, y up, z = x × y normal to the plane."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mocap_id.arrays import FloatArray


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
