"""Region of joint space that a recording visits, as joint limits that depend on each other.

The region is the convex hull of the visited postures: the smallest region that also contains all postures between two
visited ones. It needs no radius or resolution, and more samples of the same motion do not enlarge it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray

_FEWEST = 40  # smallest number of postures for a region
_MOST = 200  # approximate number of postures for a hull; four times as many change the volume by less than 1 %
_BLOCK = 8192  # postures computed at once, to limit the memory
_FLAT = 1e-9  # slope of a face that does not limit the plane


@dataclass(frozen=True)
class VisitedRegion:
    """Convex hull of postures x (plane, elevation, axial, flexion), rad.

    The postures x with ``normals`` (F, 4) x <= ``bounds`` (F,) are inside; ``limits`` (4, 2) is the box around them.
    """

    normals: FloatArray
    bounds: FloatArray
    limits: FloatArray

    def planes(self, elevation: FloatArray, axial: FloatArray, flexion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest plane (K,) for the three other angles (K,), rad.

        Outside the region, the lowest plane is above the highest one.
        """
        low, high = np.empty(len(elevation)), np.empty(len(elevation))
        slope = self.normals[:, 0]
        up, down = slope > _FLAT, slope < -_FLAT
        flat = ~up & ~down
        size = np.where(flat, 1.0, slope)  # faces as plane <= or >= bound - normals @ others
        normals, bounds = ((each.T / size).T.astype(np.float32) for each in (self.normals[:, 1:], self.bounds))
        for first in range(0, len(elevation), _BLOCK):
            part = slice(first, first + _BLOCK)
            others = np.stack([elevation[part], axial[part], flexion[part]]).astype(np.float32)
            high[part] = (bounds[up, None] - normals[up] @ others).min(axis=0)
            low[part] = (bounds[down, None] - normals[down] @ others).max(axis=0)
            if flat.any():
                outside = (bounds[flat, None] < normals[flat] @ others).any(axis=0)
                low[part] = np.where(outside, np.inf, low[part])
        return low, high


def find_visited_region(postures: FloatArray, limits: FloatArray) -> VisitedRegion | None:
    """Return the region of the visited postures; None if the postures are too few or if the hull has no volume.

    Parameters
    ----------
    postures : (T, 4) array
        Plane, elevation, axial rotation and flexion, rad.
    limits : (4, 2) array
        Robust ranges of these angles, rad; postures outside are moved to the limit.
    """
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  only a reach needs it

    size = limits[:, 1] - limits[:, 0]
    if len(postures) < _FEWEST or np.any(size <= 0):
        return None
    thinned = postures[:: max(len(postures) // _MOST, 1)]
    share = np.clip((thinned - limits[:, 0]) / size, 0.0, 1.0)
    try:
        hull = ConvexHull(share)
    except QhullError:
        return None
    faces = np.unique(np.round(hull.equations, 9), axis=0)
    normals = faces[:, :4] / size
    around = np.stack([share.min(axis=0), share.max(axis=0)], axis=1)
    return VisitedRegion(normals, normals @ limits[:, 0] - faces[:, 4], limits[:, :1] + around * size[:, None])
