"""Alpha shape of a point cloud, on scipy's Delaunay triangulation (thesis 7.2.2).

The shape consists of the simplices whose circumscribed ball has at most a given radius. The radius follows from the
samples (:func:`covering_radius`). A circumscribed ball contains no sample; if its centre is in the sampled set, it is
therefore at most as large as the largest ball in that set without a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from mocap_id.arrays import BoolArray, FloatArray, IntArray

RADIUS_FACTOR = 2.0
"""Radius of the alpha shape, relative to the largest hole among the samples; holes up to this size are filled."""


@dataclass(frozen=True)
class AlphaShape:
    """A union of simplices."""

    points: FloatArray  # (N, d) m; d is 2 or 3
    triangulation: Delaunay  # triangulation of the points
    kept: BoolArray  # (K,) whether each simplex of the triangulation belongs to the shape
    radius: float  # largest allowed circumscribed radius, m

    @property
    def measure(self) -> float:
        """Area, m², or volume, m³."""
        return float(np.abs(_signed_measure(self.points[self.triangulation.simplices[self.kept]])).sum())

    def with_radius(self, radius: float) -> AlphaShape:
        """Return the alpha shape of the same points for another radius, m."""
        return AlphaShape(self.points, self.triangulation, _is_kept(self.points, self.triangulation, radius), radius)

    def boundary(self) -> IntArray:
        """Return the facets of the shape's boundary, (F, d) indices.

        The facets are oriented as :func:`compute_measure` requires: outside to the right (d = 2), or outwards (d = 3).
        """
        simplices, d = self.triangulation.simplices, self.points.shape[1]
        facets = []
        for corner in range(d + 1):
            neighbour = self.triangulation.neighbors[:, corner]
            edge = self.kept & ((neighbour < 0) | ~self.kept[neighbour])
            facet = np.delete(simplices[edge], corner, axis=1)
            inner = self.points[simplices[edge, corner]]
            inwards = _signed_measure(np.concatenate([self.points[facet], inner[:, None]], axis=1)) > 0
            facet[~inwards, :2] = facet[~inwards, 1::-1]
            facets.append(facet)
        return np.concatenate(facets).astype(np.int64)

    def contains(self, points: FloatArray) -> BoolArray:
        """Return whether each of the points (M, d) is in the shape."""
        simplex = self.triangulation.find_simplex(points)
        return np.asarray((simplex >= 0) & self.kept[simplex])


def compute_alpha_shape(points: FloatArray, radius: float) -> AlphaShape:
    """Return the alpha shape of points (N, d), d = 2 or 3, for a radius, m.

    ValueError is raised if there are fewer than d + 1 points, or all of them are on one line (or in one plane).
    """
    spread = points - points.mean(axis=0)
    d = points.shape[1]
    if len(points) <= d or np.linalg.matrix_rank(spread, tol=1e-9 * max(np.abs(spread).max(), 1e-300)) < d:
        raise ValueError(f"the {len(points)} points have no {'area' if d == 2 else 'volume'}")
    triangulation = Delaunay(points)
    return AlphaShape(points, triangulation, _is_kept(points, triangulation, radius), radius)


def covering_radius(points: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of any of ``others`` (M, d) from the nearest of ``points`` (N, d), m."""
    return float(np.max(cKDTree(points).query(others)[0]))


def compute_measure(corners: FloatArray) -> FloatArray:
    """Return the area or volume (...) within a closed, oriented boundary, by the divergence theorem.

    ``corners`` (..., F, d, d) are the coordinates of the corners of all facets. The measure is the sum of their
    determinants, divided by d!, with the opposite sign in space.
    """
    d = corners.shape[-1]
    sign = 1.0 if d == 2 else -1.0  # the apex comes last, behind d - 1 swaps
    return np.asarray(sign * np.linalg.det(corners).sum(axis=-1) / factorial(d))


def _signed_measure(corners: FloatArray) -> FloatArray:
    """Return the signed area or volume (K,) of simplices (K, d + 1, d)."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.det(edges) / factorial(corners.shape[-1]))


def _is_kept(points: FloatArray, triangulation: Delaunay, radius: float) -> BoolArray:
    """Return whether the circumscribed ball of each simplex has at most the radius, m."""
    return np.asarray(_circumradius(points[triangulation.simplices]) <= radius)


def _circumradius(corners: FloatArray) -> FloatArray:
    """Return the radius (K,) of the ball through the corners (K, d + 1, d); infinite for a degenerate simplex."""
    edges = corners[:, 1:] - corners[:, :1]
    square = np.sum(edges**2, axis=-1)
    volume = np.abs(np.linalg.det(edges))
    flat = volume <= 1e-14 * np.prod(np.sqrt(square), axis=-1)
    edges[flat] = np.eye(corners.shape[-1])
    centre = np.linalg.solve(edges, 0.5 * square[..., None])[..., 0]
    return np.where(flat, np.inf, np.linalg.norm(centre, axis=-1))
