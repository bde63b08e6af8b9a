"""The set that a cloud of points fills: an alpha shape on scipy's Delaunay triangulation (thesis 7.2.2).

The simplices of the triangulation whose circumscribed ball has at most a given radius make up the shape. The radius
comes from the samples themselves (:func:`covering_radius`): a simplex's circumscribed ball holds no sample within it,
so where its centre lies in the sampled set, it is no larger than the largest ball in that set without a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from mocap_id.arrays import BoolArray, FloatArray, IntArray

RADIUS_FACTOR = 2.0
"""Radius of the shape by the largest hole among the samples: gaps twice as wide as any of them are real."""


@dataclass(frozen=True)
class AlphaShape:
    """A union of simplices.

    Parameters
    ----------
    points : (N, d) array
        m; d is 2 or 3.
    triangulation : Delaunay
        Of the points.
    kept : (K,) bool array
        Which of its simplices make up the shape.
    radius : float
        Largest circumscribed radius of these, m.
    """

    points: FloatArray
    triangulation: Delaunay
    kept: BoolArray
    radius: float

    @property
    def measure(self) -> float:
        """Area, m², or volume, m³."""
        return float(np.abs(_signed(self.points[self.triangulation.simplices[self.kept]])).sum())

    def boundary(self) -> IntArray:
        """Facets between the shape and what is outside, (F, d) indices, outside to the right (d = 2) or out (d = 3).

        Turned so that the fan of all facets over any point has the shape's measure: :func:`enclosed`.
        """
        simplices, d = self.triangulation.simplices, self.points.shape[1]
        facets = []
        for corner in range(d + 1):
            neighbour = self.triangulation.neighbors[:, corner]
            edge = self.kept & ((neighbour < 0) | ~self.kept[neighbour])
            facet = np.delete(simplices[edge], corner, axis=1)
            inner = self.points[simplices[edge, corner]]
            inwards = _signed(np.concatenate([self.points[facet], inner[:, None]], axis=1)) > 0
            facet[~inwards, :2] = facet[~inwards, 1::-1]
            facets.append(facet)
        return np.concatenate(facets).astype(np.int64)

    def contains(self, points: FloatArray) -> BoolArray:
        """Whether points (M, d) lie in the shape."""
        found = self.triangulation.find_simplex(points)
        return np.asarray((found >= 0) & self.kept[found])


def alpha_shape(points: FloatArray, radius: float) -> AlphaShape:
    """The alpha shape of points (N, d), d = 2 or 3, for a radius, m.

    Raises
    ------
    ValueError
        The points fill no area (volume): fewer than d + 1 of them, or all on one line (plane).
    """
    spread = points - points.mean(axis=0)
    d = points.shape[1]
    if len(points) <= d or np.linalg.matrix_rank(spread, tol=1e-9 * max(np.abs(spread).max(), 1e-300)) < d:
        raise ValueError(f"{len(points)} points that fill no {'area' if d == 2 else 'volume'}")
    triangulation = Delaunay(points)
    kept = _circumradius(points[triangulation.simplices]) <= radius
    return AlphaShape(points, triangulation, kept, radius)


def covering_radius(points: FloatArray, others: FloatArray) -> float:
    """Radius of the largest ball about any of ``others`` (M, d) that holds none of the points (N, d), m."""
    return float(np.max(cKDTree(points).query(others)[0]))


def enclosed(corners: FloatArray) -> FloatArray:
    """Area or volume within a closed, turned boundary.

    Parameters
    ----------
    corners : (..., F, d, d) array
        Facets, their corners, the coordinates.

    Returns
    -------
    (...) array
        Divergence theorem: ⅟d! of the sum of the determinants of the facets' corners.
    """
    d = corners.shape[-1]
    sign = 1.0 if d == 2 else -1.0  # the apex comes last, behind d - 1 swaps
    return np.asarray(sign * np.linalg.det(corners).sum(axis=-1) / factorial(d))


def _signed(corners: FloatArray) -> FloatArray:
    """Signed measure (K,) of simplices (K, d + 1, d)."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.det(edges) / factorial(corners.shape[-1]))


def _circumradius(corners: FloatArray) -> FloatArray:
    """Radius (K,) of the ball through the corners (K, d + 1, d); infinite for a flat simplex."""
    edges = corners[:, 1:] - corners[:, :1]
    square = np.sum(edges**2, axis=-1)
    volume = np.abs(np.linalg.det(edges))
    flat = volume <= 1e-14 * np.prod(np.sqrt(square), axis=-1)
    edges[flat] = np.eye(corners.shape[-1])
    centre = np.linalg.solve(edges, 0.5 * square[..., None])[..., 0]
    return np.where(flat, np.inf, np.linalg.norm(centre, axis=-1))
