"""Markers without the slides of whole clusters on the bones, where the joints show them."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.estimation.space.slips import slow_part
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.skin_twist import cluster_poses


def without_cluster_slides(points: FloatArray, chain: SpatialChain, rate: float) -> FloatArray:
    """Return the markers (F, M, 3), m, with clusters shifted so that joints that slide stay together.

    The clusters keep their rotations. A joint shows only how far two clusters are displaced against each other; the
    displacements of all clusters are taken to have the mean zero.

    Parameters
    ----------
    points : (F, M, 3) array
        Markers, m; NaN where unseen.
    chain : SpatialChain
    rate : float
        Frames per second.
    """
    if not any(joint.slide_sd for joint in chain.joints):
        return points
    rotations, origins = cluster_poses(points, chain)
    shifts = np.zeros_like(origins)
    for k, joint in enumerate(chain.joints, start=1):
        shifts[:, k] = shifts[:, joint.parent]
        if joint.slide_sd:
            base = rotations[:, joint.parent]
            centre = joint.origin(np.swapaxes(base, 1, 2) @ rotations[:, k])
            apart = origins[:, k] - origins[:, joint.parent] - np.einsum("fij,fj->fi", base, centre)
            shifts[:, k] += slow_part(_filled(apart), rate)
    shifts -= shifts.mean(axis=1, keepdims=True)
    return np.asarray(points - shifts[:, chain.segment])


def _filled(series: FloatArray) -> FloatArray:
    """Return a series (F, 3) interpolated where it is unknown; 0 if it is nowhere known."""
    known = np.flatnonzero(np.isfinite(series).all(axis=1))
    if not len(known):
        return np.zeros_like(series)
    return np.stack([np.interp(np.arange(len(series)), known, column[known]) for column in series.T], axis=1)
