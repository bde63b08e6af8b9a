"""Other estimators of joint centres, to compare with the bundle. They give no covariance.

``score``: the point that moves least in both segments, the symmetrical centre of rotation (Ehrig et al. 2006).
``sphere``: the common centre of spheres on which the markers of the child move in the parent (Gamage and Lasenby 2002).
``helical``: the point nearest to the helical axes of finite turns of the child in the parent (Woltring 1990).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.chain_start import Clusters, fit_shared_point

CentreEstimator: TypeAlias = Literal["score", "sphere", "helical"]

_TURN = 0.25  # of the frames between two poses of a finite turn
_LEAST_TURN = 1e-3  # pull to the mean place of the child, which decides what the motion does not show


def sphere_centre(clusters: Clusters, parent: int, child: int, local: FloatArray) -> FloatArray:
    """Return the common centre (3,), m, of the spheres of markers (k, 3), given in the child, in the parent's frame."""
    turn, origin = _express_in_parent(clusters, parent, child)
    places = origin[:, None] + np.einsum("fij,kj->fki", turn, local)
    middle = places.mean(axis=0)
    about = places - middle
    square = (about**2).sum(axis=2)
    rows = 2 * about.reshape(-1, 3)
    right = (square - square.mean(axis=0) + 2 * np.einsum("fki,ki->fk", about, middle)).reshape(-1)
    return _solve(rows, right, places.mean(axis=(0, 1)))


def helical_centre(clusters: Clusters, parent: int, child: int) -> FloatArray:
    """Return the point (3,), m, nearest to the helical axes of the child in the parent's frame."""
    turn, origin = _express_in_parent(clusters, parent, child)
    lag = max(int(_TURN * len(turn)), 1)
    finite = turn[lag:] @ np.swapaxes(turn[:-lag], 1, 2)
    shift = origin[lag:] - np.einsum("fij,fj->fi", finite, origin[:-lag])
    return _solve((np.eye(3) - finite).reshape(-1, 3), shift.reshape(-1), origin.mean(axis=0))


def estimate_centre(
    estimator: CentreEstimator, clusters: Clusters, parent: int, child: int, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a joint centre in the frames of the clusters of parent and child, m.

    Parameters
    ----------
    estimator : {"score", "sphere", "helical"}
    clusters : Clusters
    parent, child : int
        Numbers of the segments.
    local : (k, 3) array
        Markers of the child in the frame of its cluster, m.
    """
    if estimator == "score":
        return fit_shared_point(clusters, parent, child)
    makers: dict[str, Callable[[], FloatArray]] = {
        "sphere": lambda: sphere_centre(clusters, parent, child, local),
        "helical": lambda: helical_centre(clusters, parent, child),
    }
    centre = makers[estimator]()
    turn, origin = _express_in_parent(clusters, parent, child)
    return centre, np.einsum("fji,fj->fi", turn, centre - origin).mean(axis=0)


def _express_in_parent(clusters: Clusters, parent: int, child: int) -> tuple[FloatArray, FloatArray]:
    """Return rotation (F, 3, 3) and origin (F, 3), m, of the child's cluster in the frame of the parent's."""
    apart = clusters.origin[:, child] - clusters.origin[:, parent]
    return clusters.relative_rotation(parent, child), np.einsum("fji,fj->fi", clusters.rotation[:, parent], apart)


def _solve(rows: FloatArray, right: FloatArray, likely: FloatArray) -> FloatArray:
    """Return the least-squares solution with a weak pull to a likely value."""
    square = rows.T @ rows
    pull = _LEAST_TURN * np.linalg.eigvalsh(square)[-1] * np.eye(3)
    return np.asarray(np.linalg.solve(square + pull, rows.T @ right + pull @ likely))
