"""Alternative estimators of joint centres, to compare with the bundle adjustment. They provide no covariance.

``score``: the point that moves least in both segments, the symmetrical centre of rotation (Ehrig et al. 2006).
``sphere``: the common centre of spheres on which the child's markers move in the parent (Gamage and Lasenby 2002).
``helical``: the point nearest to the helical axes of finite rotations of the child in the parent (Woltring 1990).
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.chain_start import Clusters, fit_shared_point

CentreEstimator: TypeAlias = Literal["score", "sphere", "helical"]

_TURN = 0.25  # lag between the two poses of a finite rotation, as a fraction of the frames
_LEAST_TURN = 1e-3  # weight of the child's mean position, for directions that the motion does not determine


def _fit_sphere(turn: FloatArray, origin: FloatArray, local: FloatArray) -> FloatArray:
    """Return the common centre (3,) of the spheres on which markers (k, 3) of the child move in the parent, m."""
    places = origin[:, None] + np.einsum("fij,kj->fki", turn, local)
    middle = places.mean(axis=0)
    about = places - middle
    square = (about**2).sum(axis=2)
    rows = 2 * about.reshape(-1, 3)
    right = (square - square.mean(axis=0) + 2 * np.einsum("fki,ki->fk", about, middle)).reshape(-1)
    return _solve(rows, right, places.mean(axis=(0, 1)))


def _fit_helical_axes(turn: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the point (3,) nearest to the helical axes of the child in the parent, m."""
    lag = max(int(_TURN * len(turn)), 1)
    finite = turn[lag:] @ np.swapaxes(turn[:-lag], 1, 2)
    shift = origin[lag:] - np.einsum("fij,fj->fi", finite, origin[:-lag])
    return _solve((np.eye(3) - finite).reshape(-1, 3), shift.reshape(-1), origin.mean(axis=0))


def estimate_centre(
    estimator: CentreEstimator, clusters: Clusters, parent: int, child: int, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a joint centre (3,) in the frame of the parent's cluster and in that of the child's cluster, m.

    ``local`` (k, 3) are the markers of the child in the frame of its cluster, m.
    """
    if estimator == "score":
        return fit_shared_point(clusters, parent, child)
    turn, origin = _express_in_parent(clusters, parent, child)
    centre = _fit_sphere(turn, origin, local) if estimator == "sphere" else _fit_helical_axes(turn, origin)
    return centre, np.einsum("fji,fj->fi", turn, centre - origin).mean(axis=0)


def _express_in_parent(clusters: Clusters, parent: int, child: int) -> tuple[FloatArray, FloatArray]:
    """Return rotation (F, 3, 3) and origin (F, 3), m, of the child's cluster in the parent's cluster."""
    apart = clusters.origin[:, child] - clusters.origin[:, parent]
    return clusters.relative_rotation(parent, child), np.einsum("fji,fj->fi", clusters.rotation[:, parent], apart)


def _solve(rows: FloatArray, right: FloatArray, likely: FloatArray) -> FloatArray:
    """Return the least-squares solution with a weak pull to a likely value."""
    square = rows.T @ rows
    pull = _LEAST_TURN * np.linalg.eigvalsh(square)[-1] * np.eye(3)
    return np.asarray(np.linalg.solve(square + pull, rows.T @ right + pull @ likely))
