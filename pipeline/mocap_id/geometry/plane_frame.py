"""Coordinate frame of the plane of motion: x along the motion, y up, z = x × y out of the plane."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mocap_id.arrays import FloatArray


def _lab_origin() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class PlaneFrame:
    """Frame of a vertical plane in a lab whose Z axis points up.

    Parameters
    ----------
    yaw : float
        Angle about the vertical from the lab's X axis to the plane's x axis, rad.
    origin : (3,) array
        Origin of the frame in the lab, m.

    Examples
    --------
    >>> frame = PlaneFrame(np.pi / 2, np.array([1.0, 0.0, 0.0]))
    >>> frame.to_plane(np.array([1.0, 2.0, 3.0])).round(9) + 0.0
    array([2., 3., 0.])
    """

    yaw: float
    origin: FloatArray = field(default_factory=_lab_origin)

    @property
    def axes(self) -> FloatArray:
        """Axes in the lab as rows (3, 3): x = (cos yaw, sin yaw, 0), y = (0, 0, 1), z = (sin yaw, -cos yaw, 0)."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])

    def to_plane(self, points: FloatArray) -> FloatArray:
        """Transform lab points to the plane frame.

        Parameters
        ----------
        points : (..., 3) array
            Points in the lab, m.

        Returns
        -------
        (..., 3) array
            Coordinates along the motion, upwards and out of the plane, m.
        """
        return np.asarray((points - self.origin) @ self.axes.T)

    def from_plane(self, points: FloatArray) -> FloatArray:
        """Transform points (..., 3) in the plane frame to the lab, m; the inverse of :meth:`to_plane`."""
        return np.asarray(points @ self.axes + self.origin)

    def wrench_to_plane(self, force: FloatArray, moment: FloatArray) -> FloatArray:
        """Return the components of a wrench that act in the plane.

        Parameters
        ----------
        force : (..., 3) array
            Lab axes, N.
        moment : (..., 3) array
            Moment about the *lab* origin, lab axes, N·m.

        Returns
        -------
        (..., 3) array
            Fx and Fy in N, and tauz about the origin of the plane frame in N·m.
        """
        about = moment - np.cross(self.origin, force)
        return np.concatenate([force @ self.axes[:2].T, (about @ self.axes[2])[..., None]], axis=-1)
