"""Slides of whole marker clusters on the bones, seen as motion of the joint centres between the clusters.

A plate on the skin keeps its shape while it moves by centimetres on the bone. The markers' distances do not show this
motion, but the joints do: their centres, as both clusters show them, move apart. If they move farther than the errors
of single markers explain, the joint slides in the fit; otherwise the displacement would turn the clusters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.chain_start import Clusters, fit_shared_point

_BEYOND = 2.5  # times the displacement that single markers explain; simulated skin stays below 1.8
_LEAST = 0.001  # m
_USUAL = 0.95  # share of the frames that count; the rest may hold swapped markers


def find_joint_slides(clusters: Clusters, segment: IntArray, parents: Sequence[int]) -> FloatArray:
    """Return the displacement (F, n, 3) between both clusters at every joint that slides, m; 0 at the others.

    Parameters
    ----------
    clusters : Clusters
    segment : (M,) int array
        Segment of each marker.
    parents : sequence of int, length n
    """
    found = np.zeros((len(clusters.rotation), len(parents), 3))
    for j, parent in enumerate(parents):
        centre, own = fit_shared_point(clusters, parent, j + 1)
        ends = [
            clusters.origin[:, k] + clusters.rotation[:, k] @ place for k, place in ((parent, centre), (j + 1, own))
        ]
        apart = np.einsum("fji,fj->fi", clusters.rotation[:, parent], ends[1] - ends[0])
        square = np.sort(np.sum((apart - np.median(apart, axis=0)) ** 2, axis=1))
        size = float(np.sqrt(square[: max(int(_USUAL * len(square)), 1)].mean() / 3))
        explained = sum(_variance_at(clusters, segment, k, p) for k, p in ((parent, centre), (j + 1, own)))
        if size > max(_LEAST, _BEYOND * float(np.sqrt(explained))):
            found[:, j] = apart
    return found


def _variance_at(clusters: Clusters, segment: IntArray, k: int, point: FloatArray) -> float:
    """Return the variance per axis, m², of a point of a cluster by independent errors of its markers."""
    local = clusters.local[segment == k]
    local = local[np.isfinite(local).all(axis=1)]
    inertia = np.sum(local**2) * np.eye(3) - local.T @ local
    lever = so3.hat(point)
    turned = np.trace(lever @ np.linalg.solve(inertia, lever.T)) / 3
    return float(clusters.sd[k] ** 2 * (1 / len(local) + turned))
