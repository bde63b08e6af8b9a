"""The plane of motion as a frame: x along the motion, y up, z = x × y out of the plane."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mocap_id.arrays import FloatArray


def _lab_origin() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class PlaneFrame:
    """A vertical plane in a lab whose Z axis points up.

    Parameters
    ----------
    yaw : float
        Angle of the plane's x about the vertical from the lab's X, rad.
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
        """(3, 3): rows x = (cos yaw, sin yaw, 0), y = (0, 0, 1), z = x × y = (sin yaw, -cos yaw, 0) in the lab."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])

    def to_plane(self, points: FloatArray) -> FloatArray:
        """Coordinates in the plane frame.

        Parameters
        ----------
        points : (..., 3) array
            Lab, m.

        Returns
        -------
        (..., 3) array
            Along the motion, upwards, out of the plane, m.
        """
        return np.asarray((points - self.origin) @ self.axes.T)

    def from_plane(self, points: FloatArray) -> FloatArray:
        """The inverse of :meth:`to_plane`: (..., 3) plane frame → lab, m."""
        return np.asarray(points @ self.axes + self.origin)

    def wrench_to_plane(self, force: FloatArray, moment: FloatArray) -> FloatArray:
        """The part of a wrench that acts in the plane.

        Parameters
        ----------
        force : (..., 3) array
            Lab axes, N.
        moment : (..., 3) array
            Lab axes, about the *lab* origin, N·m.

        Returns
        -------
        (..., 3) array
            Fx, Fy in N and tauz in N·m about the origin of the plane frame.
        """
        about = moment - np.cross(self.origin, force)
        return np.concatenate([force @ self.axes[:2].T, (about @ self.axes[2])[..., None]], axis=-1)
