"""Backfill: states before a joint is found, extrapolated backwards from later frames.

A lost joint restarts in every frame until one determines it, and the smoother does not connect the states before and
after a restart. The process (eq. 3.17) run backwards carries the state into the frames before the last restart. Its
uncertainty grows as at the beginning of a gap.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.filter_problem import FilterProblem, Track
from mocap_id.estimation.process_model import noise_shape, transition


def backfill(problem: FilterProblem, track: Track, mean: FloatArray, sd: FloatArray) -> BoolArray:
    """Fill the frames before a joint is found while this is more certain than their present states; in place.

    With x = F⁻¹ (x' − w) and no other information, P = F⁻¹ (P' + Q) F⁻ᵀ.

    Parameters
    ----------
    problem : FilterProblem
    track : Track
        Smoothed track.
    mean, sd : (F, n, 4) array
        States of the track, by joint; changed.

    Returns
    -------
    (F, n) bool array
        True where the state is filled in.
    """
    back = np.linalg.inv(transition(problem.dt))
    filled = np.zeros(track.restarted.shape, dtype=np.bool_)
    for j, density in enumerate(problem.density):
        noise = density * noise_shape(problem.dt)
        own = np.arange(4) * problem.joints + j
        for k in np.flatnonzero(track.found[:, j]).tolist():
            x, p = mean[k, j], track.covariance[k][np.ix_(own, own)]
            for before in range(k - 1, -1, -1):
                x, p = back @ x, back @ (p + noise) @ back.T
                if p[0, 0] >= sd[before, j, 0] ** 2:
                    break
                mean[before, j], sd[before, j], filled[before, j] = x, np.sqrt(np.diagonal(p)), True
    return filled
